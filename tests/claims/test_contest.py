"""The kept contest of surrogates, and a short one on runs of a formula."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from core.archive import Archive, Input, Mesh, Run
from core.design import maximin_lhs
from core.surrogate.contest import trial
from core.surrogate.contest.boosters import SEVEN, installed
from core.surrogate.contest.features import SETS
from core.surrogate.contest.regressors import MEAN, PLAIN, UNSCALED
from core.surrogate.contest.score import rank_of
from core.surrogate.contest.table import ALONE, PAPER
from service.cli import app
from tests.claims.words import WORDS

Array = NDArray[np.float64]
Json = dict[str, Any]
FOLDER = Path(__file__).with_name("results") / "contest"
KEPT: Json = json.loads((FOLDER / "result.json").read_text())
CONTROLS = (MEAN, PLAIN, UNSCALED, ALONE)
TIME_H = np.array([0.0, 10.0, 100.0, 1000.0, 4000.0, 12_000.0, 30_000.0, 50_000.0])
LOW, HIGH = np.array([0.8, -3.0]), np.array([1.0, 3.0])
TRAIN, TEST, FEATURES = 24, 8, 6


def row_of(found: Json, name: str, which: str) -> Json:
    (row,) = (r for r in found["rows"] if (r["name"], r["targets"]) == (name, which))
    return dict(row)


def test_the_kept_contest_has_all_seven_on_both_sets_of_targets_and_the_controls() -> None:
    names = {(row["name"], row["targets"]) for row in KEPT["rows"]}
    assert names == {(n, w) for n in (*(one.name for one in SEVEN), *CONTROLS) for w in SETS}
    assert len(KEPT["rows"]) == len(names)
    assert KEPT["not_installed"] == []
    assert KEPT["commit"]
    assert (KEPT["archive"]["training"], KEPT["archive"]["independent"]) == (66, 34)
    assert (KEPT["plan"]["folds"], KEPT["paper"]) == (10, PAPER)
    for row in KEPT["rows"]:
        if row["name"] in {one.name for one in SEVEN}:
            assert row["tried"] == KEPT["plan"]["configurations"] == 6
            assert sum(one["folds"] for one in row["settings_of_folds"]) == 10


def test_the_best_is_the_one_that_the_rule_picks_from_the_kept_errors() -> None:
    own = [row for row in KEPT["rows"] if row["name"] not in CONTROLS]
    first = min(own, key=lambda row: rank_of(row["cross_validation"]))
    assert KEPT["best"] == {"name": first["name"], "targets": first["targets"]}
    assert KEPT["best"] == {"name": "gaussian process", "targets": "transformed"}
    for row in KEPT["rows"]:
        assert row["rank"] == pytest.approx(rank_of(row["cross_validation"]), rel=1e-3)
    ranks = [row["rank"] for row in own]
    assert ranks == sorted(ranks)


def test_the_chosen_one_is_as_good_as_asked_on_runs_it_never_saw() -> None:
    told = row_of(KEPT, **_best())["independent"]
    assert told["tip_median_percent"] <= 0.5
    assert told["tip_p95_percent"] <= 2.0
    assert told["ceeq_median_percent"] <= 1.0
    assert told["ceeq_p95_percent"] <= 4.0
    assert told["field_rmse_mm"] <= 0.01


def test_the_published_choice_does_not_win_here_and_an_unscaled_process_loses_to_it() -> None:
    """Negative control of "the process wins": on inputs in their own units, one length for all."""
    for which in SETS:
        trees, best, untuned = (
            row_of(KEPT, name, which)["cross_validation"]["rmse_by_variance"]
            for name in (PAPER["first"], "gaussian process", UNSCALED)
        )
        assert best < trees < untuned


def test_nothing_beats_the_reduction_and_nothing_but_it_is_free_of_error() -> None:
    for which in SETS:
        floor = row_of(KEPT, ALONE, which)["cross_validation"]
        for name in (*(one.name for one in SEVEN), MEAN):
            told = row_of(KEPT, name, which)["cross_validation"]
            assert told["field_rmse_mm"] > floor["field_rmse_mm"]
            assert told["rmse_by_variance"] > floor["rmse_by_variance"] == 0.0


def test_the_kept_files_tell_no_folder_and_are_named_in_the_readme() -> None:
    for name in ("result.json", "table.md"):
        text = (FOLDER / name).read_text()
        assert "/work" not in text
        assert "/tmp" not in text
        assert "--archive rotor-blade-archive" in text
    assert "tests/claims/results/contest" in WORDS
    assert {"tip.png", "errors.png"} <= {file.name for file in FOLDER.iterdir()}


def _best() -> dict[str, str]:
    return {"name": KEPT["best"]["name"], "which": KEPT["best"]["targets"]}


def formula(x: Array) -> Run:
    """Creep along twelve nodes with a rate exponential in the inputs."""
    rate, steady = x
    span = np.linspace(0.0, 1.0, 12)
    speed = np.exp(9.0 * (rate - 0.9) + 0.25 * steady - 0.6 * span * (1 + 2.0 * (rate - 0.9)))
    ceeq = 1e-5 * TIME_H[:, None] ** 0.6 * speed
    moved = np.zeros((len(TIME_H), 12, 3))
    moved[:, :, 2] = 0.4 * span * rate + np.cumsum(ceeq, axis=1) * 15.0
    values = {
        "ceeq": ceeq,
        "creep_damage": 0.02 * ceeq,
        "mises": 150.0 * (1.0 + 0.1 * span) * (1.0 - 20.0 * ceeq) * (1.0 + 0.02 * steady),
        "displacement": moved,
        "elongation": moved[:, -1, 2] - moved[0, -1, 2],
    }
    return Run({"t1t_rate": float(rate), "creep_steady": float(steady)}, values)


def archive_of(folder: Path, shuffled: bool) -> Path:
    """Runs of the formula; shuffled: every run under the inputs of another one."""
    points = np.arange(36.0).reshape(12, 3)
    mesh = Mesh("bar", points, np.arange(8)[None], points, {"tip": 11})
    made = Archive.create(
        folder,
        inputs=[Input("t1t_rate", 0.8, 1.0), Input("creep_steady", -3.0, 3.0)],
        time_h=TIME_H,
        mesh=mesh,
        seed=1,
        command="a formula",
    )
    x = np.vstack([maximin_lhs(TRAIN, LOW, HIGH, 1), maximin_lhs(TEST, LOW, HIGH, 2)])
    order = np.random.default_rng(3).permutation(len(x)) if shuffled else np.arange(len(x))
    for index, (own, other) in enumerate(zip(x, x[order], strict=True)):
        run = formula(other)
        names = ("t1t_rate", "creep_steady")
        made.write(index, Run(dict(zip(names, map(float, own), strict=True)), run.values))
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of the formula, each under its own inputs."""
    return archive_of(tmp_path_factory.mktemp("runs") / "bar", shuffled=False)


@pytest.mark.parametrize("shuffled", [False, True], ids=["runs", "shuffled"])
def test_a_short_contest_learns_a_formula_and_loses_to_the_mean_on_shuffled_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runs: Path, shuffled: bool
) -> None:
    """The quick one, of fewer features: LightGBM fits each by itself."""
    short = replace(trial.QUICK, features=FEATURES, timed=200)
    monkeypatch.setattr(trial, "QUICK", short)
    folder = archive_of(tmp_path / "bar", shuffled) if shuffled else runs
    words = ["study", "contest", "--archive", str(folder), "--quick", "--training", str(TRAIN)]
    places = ["--work", str(tmp_path / "work"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, [*words, *places])
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "result.json").read_text())
    taking_part = [one.name for one in SEVEN if installed(one)]
    assert found["not_installed"] == [o.name for o in SEVEN if o.name not in taking_part]
    for name in taking_part:
        for which in SETS:
            told = row_of(found, name, which)["cross_validation"]
            if shuffled:
                assert told["r2_by_variance"] <= 1e-9
            else:
                assert told["r2_by_variance"] > 0.35
    if not shuffled:
        process = row_of(found, "gaussian process", "transformed")["independent"]
        assert process["tip_p95_percent"] < 1.0
    assert {"result.json", "table.md", "tip.png", "errors.png"} == {
        file.name for file in (tmp_path / "out").iterdir()
    }
    text = (tmp_path / "out" / "result.json").read_text()
    assert str(tmp_path) not in text
    assert str(folder.parent) not in text


def test_a_folder_without_runs_and_one_that_is_no_archive_are_refused(
    tmp_path: Path, runs: Path
) -> None:
    told = CliRunner().invoke(app, ["study", "contest", "--archive", str(tmp_path)])
    assert told.exit_code != 0
    assert "is no archive" in str(told.exception)
    words = ["study", "contest", "--archive", str(runs), "--quick", "--training", "31"]
    told = CliRunner().invoke(app, [*words, "--work", str(tmp_path / "work")])
    assert "leaves 1 of 32 runs" in str(told.exception)
