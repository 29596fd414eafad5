"""The study of adaptive designs on a closed form: what it counts, and a short run of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.archive import Archive
from core.surrogate import Surrogate, refine, train
from core.validation import adaptive
from core.validation import adaptive_truth as truth
from core.validation.adaptive import Study, run_formula
from core.validation.adaptive_counts import Point, ratios, runs_needed, summary


def curve(*pairs: tuple[int, float]) -> list[Point]:
    return [Point(n, e, 2 * e) for n, e in pairs]


def test_runs_are_counted_from_where_the_error_stays_below() -> None:
    dips = curve((16, 0.04), (20, 0.009), (24, 0.02), (28, 0.005))
    needed, known = runs_needed(dips, 0.01)
    share = np.log(0.02 / 0.01) / np.log(0.02 / 0.005)
    assert known
    assert needed == pytest.approx(24 * (28 / 24) ** share), "the dip at 20 does not count"
    needed, known = runs_needed(dips, 0.004)
    assert not known
    assert needed == pytest.approx(28 * 28 / 24)
    assert runs_needed(dips, 0.05) == (16.0, True)


def test_a_ratio_is_against_the_best_one_shot_design_of_up_to_that_size() -> None:
    shots = curve((16, 0.04), (26, 0.01), (40, 0.02))
    found = ratios(curve((16, 0.04), (20, 0.01)), shots)
    assert [one["error"] for one in found["by_size"]] == [0.01, 0.01]
    assert [one["ratio"] for one in found["by_size"]] == pytest.approx([20 / 26, 20 / 40])
    assert found["ratio"] == pytest.approx(np.sqrt(20 / 26 * 20 / 40))
    worse = ratios(curve((16, 0.04), (20, 0.03)), shots)
    assert not worse["reached"]
    assert worse["by_size"][0]["ratio"] == pytest.approx(25 / 26)
    rows = [{"ratios": one, "uniform_ratios": worse} for one in (found, worse)]
    told = summary(rows, limit=0.7)
    assert told["ratios"]["reached"] == 1
    assert told["seeds_met"] == 1
    assert told["ratios"]["at_size"]["26"] == pytest.approx(np.sqrt(20 / 26 * 25 / 26))


def test_kept_runs_are_those_of_the_inputs_and_never_made_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def counted(*point: float) -> truth.Array:
        asked.append(point)
        return truth.formula(np.array([point]))[0]

    monkeypatch.setattr(truth, "run_blade", counted)
    x = np.array([[0.9, 0.85, 1.0, -2.0], [1.1, 0.95, 0.0, 2.0]])
    told: list[tuple[int, int]] = []
    again = truth.finite_elements(tmp_path, progress=lambda a, b: told.append((a, b)))
    np.testing.assert_array_equal(again(x), truth.formula(x))
    np.testing.assert_array_equal(truth.finite_elements(tmp_path)(x[::-1]), truth.formula(x[::-1]))
    assert len(asked) == 2
    assert told == [(1, 2), (2, 2)]
    truth.finite_elements(tmp_path)(x + np.array([1e-15, 0, 0, 0]))
    assert len(asked) == 4, "another input to the last bit is another run"
    monkeypatch.setattr(truth, "MESH", "fine")
    assert not truth.place(tmp_path).exists(), "runs of another mesh lie elsewhere"


def once(made_by: Callable[..., Surrogate], key: Callable[..., Any]) -> Callable[..., Surrogate]:
    """Each surrogate is made once: rotors share their first designs and all of the control's."""
    known: dict[Any, Surrogate] = {}

    def made(*given: Any, **named: Any) -> Surrogate:
        name = key(*given, **named)
        if name not in known:
            known[name] = made_by(*given, **named)
        return known[name]

    return made


def runs_of(archive: Archive, indices: Sequence[int], seed: int, **_: Any) -> tuple[bytes, int]:
    return archive.inputs(indices).tobytes(), seed


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    small = Study(
        seeds=2, sizes=(16, 28), most=28, batch=6, pool=60, designs=1, particles=500, seed=4
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(adaptive, "learn", once(adaptive.learn, lambda x, *_: x.tobytes()))
        patch.setattr(refine, "train", once(train, runs_of))
        patch.setattr(Study, "one_shot", cache(Study.one_shot))
        return run_formula(small)


def test_a_short_study_compares_three_designs_that_begin_alike(rows: list[dict[str, Any]]) -> None:
    """Two rotors; single ones differ, the claim is in tests/claims/results/adaptive."""
    assert len(rows) == 2
    for row in rows:
        assert row["region"]["of"] == "posterior of 20 blades, 60 readings"
        assert row["region"]["sd"][1] < 0.03, "one gas temperature; 0.058 before"
        assert row["region"]["sd"][0] > 0.15, "coatings of all blades"
        assert [one["n"] for one in row["adaptive"]] == [16, 22, 28]
        first = [row[kind][0]["rms"] for kind in ("one_shot", "adaptive", "uniform")]
        assert first == pytest.approx([first[0]] * 3, rel=1e-2), "all begin with the same runs"

    def mean(kind: str, which: int) -> float:
        """Geometric, over rotors."""
        return float(np.exp(np.mean([np.log(row[kind][which]["rms"]) for row in rows])))

    assert mean("adaptive", -1) < 0.5 * mean("adaptive", 0)
    assert mean("adaptive", -1) < mean("uniform", -1), "the control knows no rotor"
