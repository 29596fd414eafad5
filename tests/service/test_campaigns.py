"""`bladetwin model runs` and `bladetwin study reduction`, with formulas for the finite elements."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import core.builtin.rotor_blade as built
from core.archive import Archive
from core.archive.shared import SharedRuns
from core.blade import BOUNDS, build_mesh, output_times
from core.builtin import plans
from service.cli import app
from service.studies.reduction import split

NODES = len(build_mesh("coarse").points)


def formula(inputs: Mapping[str, float]) -> SimpleNamespace:
    """Creep by t^0.6 with a rate exponential in the inputs."""
    time, span = output_times(), build_mesh("coarse").parametric[:, 2]
    tbc, rate, alpha, gamma = inputs.values()
    ceeq = 1e-5 * np.outer(time**0.6, np.exp(9 * (rate - 0.9) - tbc * (1 + span) + 0.3 * gamma))
    displacement = np.stack([ceeq, 2 * ceeq * span, 0.4 * span * rate + 90 * ceeq], axis=-1)
    return SimpleNamespace(
        inputs=dict(inputs),
        ceeq=ceeq,
        creep_damage=0.01 * ceeq * np.exp(0.2 * alpha * span),
        mises=150.0 * (1 + 0.1 * alpha * span - 20 * ceeq),
        displacement=displacement,
        elongation=displacement[:, 7, 2] - displacement[0, 7, 2],
    )


def campaign(
    inputs: Sequence[Mapping[str, float]],
    sink: Callable[[int, Any], object],
    *,
    todo: SharedRuns,
    **options: Any,
) -> SimpleNamespace:
    done = []
    while (index := todo.take()) is not None:
        sink(index, formula(inputs[index]))
        done.append(index)
    return SimpleNamespace(failures=(), completed=tuple(done), seconds=1.25, **options)


def told(*words: str | Path) -> dict[str, Any]:
    done = CliRunner().invoke(app, [str(w) for w in words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.fixture
def archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(built, "run_campaign", campaign)
    plan = plans.Plan("rotor-blade", BOUNDS, output_times(), 8, 4)
    monkeypatch.setitem(plans.PLANS, "rotor-blade", plan)
    return tmp_path / "runs"


def test_runs_are_those_of_the_plan_and_the_command_goes_on(archive: Path) -> None:
    words = ("model", "runs", "--archive", archive, "--mesh", "coarse", "--json")
    first = told(*words, "--part", "training")
    assert (first["runs"], first["computed"]) == (8, list(range(8)))
    second = told(*words)
    assert (second["runs"], second["computed"]) == (12, [8, 9, 10, 11])
    store = Archive.open(archive)
    plan = plans.PLANS["rotor-blade"]
    assert store.inputs() == pytest.approx(plans.design(plan=plan), rel=1e-12)
    assert store.declaration.code == built.blade_digest()


def test_a_model_that_is_none_is_refused_with_those_there_are(archive: Path) -> None:
    done = CliRunner().invoke(app, ["model", "runs", "blade", "--archive", str(archive)])
    assert done.exit_code == 2
    assert "rotor-blade or" in done.output


def test_a_reduction_leaves_a_result_a_table_and_a_plot(archive: Path, tmp_path: Path) -> None:
    told("model", "runs", "--archive", archive, "--mesh", "coarse", "--json")
    out = tmp_path / "out"
    said = told(
        "study", "reduction", "--archive", archive, "--training", "8", "--rank", "6", "--out", out
    )
    assert json.loads((out / "result.json").read_text()) == said
    assert said["runs"] == {"training": 8, "held_out": 4}
    assert said["numbers_of_a_run"] == 6 * 54 * NODES
    names = ["ceeq", "creep_damage", "mises", "displacement_x", "displacement_y", "displacement_z"]
    assert (
        said["quantities"]
        == names
        == list(said["single"])
        == list(said["joint"]["held_out"]["error"])
    )
    for one in (said["joint"], *said["single"].values()):
        assert one["ranks"] == [1, 2, 3, 4, 5, 6]
        assert one["variance_left"] == sorted(one["variance_left"], reverse=True)
        assert 0 <= one["variance_left"][-1] < 0.01
        assert np.all(np.diff(one["training"]["overall"][:4]) < 0)
    joint = said["joint"]
    assert joint["held_out"]["overall"][-1] > joint["training"]["overall"][-1]
    table = (out / "table.md").read_text()
    assert "| features for 99 % of the variance | " in table
    assert table.count("| its own |") == 6
    assert (out / "rank-sweep.png").read_bytes().startswith(b"\x89PNG")


def test_without_runs_behind_the_training_every_sixth_is_held_out() -> None:
    kept, held = split(range(66), 66)
    assert (len(kept), held[:3]) == (55, [5, 11, 17])
    assert split(range(100), 66) == (list(range(66)), list(range(66, 100)))
