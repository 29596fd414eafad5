"""Building the rotor blade with a formula in place of the finite elements."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import core.builtin.rotor_blade as built
from core.archive import Archive
from core.archive.shared import SharedRuns
from core.blade import BOUNDS, DORMANT, MESHES, build_mesh, output_times
from core.builtin import plans
from core.errors import ModelError
from core.surrogate import load
from core.surrogate.contest import curve

Array = NDArray[np.float64]
Campaign = Callable[..., SimpleNamespace]


class Cut(Exception):
    """The machine was switched off."""


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> str:
    """A mesh of few nodes, for the formula."""
    monkeypatch.setitem(MESHES, "few", (16, 1, 2))
    return "few"


def formula(inputs: Mapping[str, float], mesh: str) -> SimpleNamespace:
    """Creep by t^0.6 with a rate exponential in the inputs, on a mesh."""
    time, span = output_times(), build_mesh(mesh).parametric[:, 2]
    tbc, rate, alpha, gamma = inputs.values()
    speed = np.exp(9 * (rate - 0.9) - tbc + 0.2 * alpha + 0.3 * gamma)
    ceeq = 1e-5 * np.outer(time**0.6, speed * (1.1 - span))
    displacement = np.zeros((len(time), len(span), 3))
    displacement[:, :, 2] = 0.4 * span * rate + 90 * ceeq.mean(axis=1)[:, None] * span**2
    tip = build_mesh(mesh).named["tip"]
    return SimpleNamespace(
        inputs=dict(inputs),
        ceeq=ceeq,
        creep_damage=0.01 * ceeq,
        mises=np.full_like(ceeq, 150.0) * (1 + 0.1 * alpha - 20 * ceeq),
        displacement=displacement,
        elongation=displacement[:, tip, 2] - displacement[0, tip, 2],
    )


def campaign(
    calls: list[int], cut_after: int | None = None, failing: int | None = None
) -> Campaign:
    """A stand-in for `run_campaign` that notes the indices it computes."""

    def run(
        inputs: Sequence[Mapping[str, float]],
        sink: Callable[[int, Any], None],
        *,
        mesh: str,
        todo: SharedRuns,
        progress: Callable[[int, int, float], None] | None,
        **options: Any,
    ) -> SimpleNamespace:
        failures = []
        while (index := todo.take()) is not None:
            point = inputs[index]
            if len(calls) == cut_after:
                raise Cut
            calls.append(index)
            if index == failing:
                failures.append(SimpleNamespace(index=index, inputs=point, reason="exploded"))
                todo.failed(index, "exploded")
                continue
            sink(index, formula(point, mesh))
            if progress is not None:
                progress(index + 1, len(inputs), 0.0)
        done = tuple(k for k in calls if k != failing)
        return SimpleNamespace(failures=tuple(failures), completed=done, seconds=0.0)

    return run


def test_the_design_is_two_hypercubes_inside_the_bounds() -> None:
    low, high = np.array(list(BOUNDS.values())).T
    points = (plans.design() - low) / (high - low)
    for part in (points[:66], points[66:]):
        cells = part * len(part) - 0.5
        np.testing.assert_allclose(np.sort(cells, axis=0)[:, 0], np.arange(len(part)), atol=1e-9)
        np.testing.assert_allclose(np.sort(cells, axis=0)[:, 3], np.arange(len(part)), atol=1e-9)
    nearest = np.linalg.norm(points[:66, None] - points[None, 66:], axis=2).min()
    assert nearest > 0.02


def test_a_build_that_was_cut_goes_on_where_it_was_and_ends_with_a_measured_artefact(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, few: str
) -> None:
    calls: list[int] = []
    build = partial(built.build, tmp_path, few, 5, training=24, test=4, commit="abc")
    monkeypatch.setattr(curve, "TREES", 5)  # of the contest, which has a test of its own
    monkeypatch.setattr(built, "run_campaign", campaign(calls, cut_after=9))
    with pytest.raises(Cut):
        build()
    assert Archive.open(tmp_path / "archive").done() == tuple(range(9))
    seen: list[tuple[str, int, int]] = []
    monkeypatch.setattr(built, "run_campaign", campaign(calls))
    model = build(progress=lambda *report: seen.append(report[:3]))
    assert calls == list(range(28))
    assert seen[0] == ("runs", 10, 28)
    manifest = load(tmp_path).manifest
    assert manifest["digest"] == model.digest
    assert manifest["command"] == "bladetwin model build rotor-blade"
    nodes = len(build_mesh(few).points)
    assert (manifest["seed"], manifest["mesh"], manifest["nodes"]) == (5, few, nodes)
    assert manifest["runs"] == {"training": 24, "test": 4}
    assert manifest["finite_elements"] == {"digest": built.blade_digest(), "commit": "abc"}
    assert manifest["errors"]["elongation"]["from_1000_h"]["median_percent"] < 0.5
    assert manifest["polynomials"]["elongation"]["p95_percent"] < 0.1
    x = np.array([[0.9, 0.93, 1.0, -0.5]])
    exact = formula(dict(zip(BOUNDS, x[0], strict=True)), few).elongation[-1]
    assert model.predict(x, "elongation", [50_000.0])[0][0, 0] == pytest.approx(exact, rel=0.01)


def test_a_failed_run_stops_the_build_and_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, few: str
) -> None:
    monkeypatch.setattr(built, "run_campaign", campaign([], failing=3))
    with pytest.raises(ModelError, match=r"1 of 24 runs failed; run 3 at .*: exploded"):
        built.build(tmp_path, mesh=few, training=20, test=4)


def test_an_archive_of_another_seed_or_another_code_is_not_mixed_in(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    built.open_archive(tmp_path, "coarse", seed=1)
    monkeypatch.setattr(built, "run_campaign", campaign([]))
    monkeypatch.setattr(built, "blade_digest", lambda: "changed")
    with pytest.raises(ModelError, match=r"another archive \(seed, code\)"):
        built.build(tmp_path / "x", mesh="coarse", seed=2, archive_dir=tmp_path)


def test_the_code_digest_changes_with_the_code(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "__init__.py").write_text("a = 1\n")
    monkeypatch.setattr("core.blade.__file__", str(tmp_path / "__init__.py"))
    first = built.blade_digest()
    (tmp_path / "spread.py").write_text("where runs are computed")
    assert built.blade_digest() == first
    (tmp_path / "__init__.py").write_text("a = 2\n")
    second = built.blade_digest()
    assert second != first
    (tmp_path / "creep.py").write_text("")
    assert built.blade_digest() not in (first, second)


@pytest.fixture(scope="module")
def wide() -> plans.Plan:
    """The wide plan with fewer runs to train on; a design takes time by the square of theirs."""
    return replace(plans.WIDE, training=80)


@pytest.fixture(scope="module")
def points(wide: plans.Plan) -> Array:
    return plans.design(plan=wide)


def test_three_fifths_of_the_wide_plan_stand_where_blades_live(
    wide: plans.Plan, points: Array
) -> None:
    """In the inner box, two dormant inputs awake at most; the others fill the whole."""
    plan = wide
    assert plan.near is not None
    low, high = np.array(list(plan.bounds.values())).T
    for first, last in ((0, plan.training), (plan.training, plan.training + plan.test)):
        count = round(0.6 * (last - first))
        far, close = points[first : last - count], points[last - count : last]
        assert len({*np.floor(len(far) * (far[:, 4] - low[4]) / (high[4] - low[4]))}) == len(far)
        awake = np.array([close[:, 4 + j] != x for j, x in enumerate(plan.near.asleep.values())])
        assert awake.sum(axis=0).max() == 2
        assert np.all(awake.mean(axis=1) > 0.1)
        assert awake[1].mean() == pytest.approx(3 / 8, abs=0.03), "accelerating creep counts most"
        for j, (bottom, top) in enumerate(plan.near.bounds.values()):
            assert bottom < close[:, j].min() < close[:, j].max() < top
    assert not np.isin(points[: plan.training], points[plan.training :]).all(axis=1).any()


def test_runs_of_the_wide_plan_go_through_the_finite_elements(
    tmp_path: Path, wide: plans.Plan, points: Array
) -> None:
    """Two of its runs, on the coarse mesh: dormant inputs, wider boxes, 150,000 h."""
    plan = wide
    assert points.shape == (plan.training + plan.test, 8)
    low, high = np.array(list(plan.bounds.values())).T
    assert np.all((points >= low) & (points <= high))
    cool = points[np.argsort(points[:, 1])[:2]]  # a cool blade is soon done
    archive = built.open_archive(tmp_path, "coarse", plan=plan)
    built.simulate(archive, cool, plan=plan, workers=1)
    assert archive.done() == (0, 1)
    assert [i.name for i in archive.declaration.inputs] == [*BOUNDS, *DORMANT]
    assert archive.inputs([0, 1]) == pytest.approx(cool)
    assert archive.declaration.time_h[-1] == 150_000.0
    assert "rotor-blade-wide" in archive.declaration.command
    elongation = archive.stack("elongation", [0, 1])
    assert elongation.shape[1] == len(plan.time_h)
    assert np.all(np.diff(elongation[:, 20:], axis=1) > 0)
