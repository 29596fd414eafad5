"""The study commands write what they say."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from core.validation import adaptive, schedule_study
from service.cli import app


def invoke(*words: str | Path) -> str:
    done = CliRunner().invoke(app, [str(w) for w in words], catch_exceptions=False)
    assert done.exit_code == 0
    return done.stdout


def test_a_coverage_study_leaves_a_result_and_two_plots(tmp_path: Path) -> None:
    small = ("--rotors", "2", "--blades", "2", "--particles", "500", "--work", tmp_path / "work")
    said = invoke("study", "coverage", "rotor-20", *small, "--out", tmp_path / "out")
    kept = json.loads((tmp_path / "out/result.json").read_text())
    assert json.loads(said) == kept
    assert kept["command"].startswith("bladetwin")
    assert {"commit", "model", "seed", "seconds", "table", "passed"} <= kept.keys()
    assert kept["table"]["creep_steady"]["truths"] == 4
    for plot in ("ranks.png", "coverage.png"):
        assert (tmp_path / "out" / plot).read_bytes().startswith(b"\x89PNG")
    assert len((tmp_path / "out/ranks.png").read_bytes()) > 20_000


def test_a_study_of_lives_leaves_a_result_and_a_plot(tmp_path: Path) -> None:
    small = ("--rotors", "2", "--blades", "2", "--particles", "500", "--work", tmp_path / "work")
    said = invoke("study", "lives", "rotor-20", *small, "--out", tmp_path / "out")
    kept = json.loads((tmp_path / "out/result.json").read_text())
    assert json.loads(said) == kept
    assert (kept["rotors"], kept["next_outage_h"], kept["passed"]) == (2, 32_000.0, False)
    assert kept["table"]["1 x"]["pit"]["truths"] == 4
    assert sum(row["blades"] for row in kept["reliability"]["twin"]) == 12
    assert (tmp_path / "out/lives.png").read_bytes().startswith(b"\x89PNG")


def test_a_seed_study_says_the_spread_of_every_mean(tmp_path: Path) -> None:
    small = ("--seeds", "2", "--rotors", "1", "--blades", "2", "--particles", "500")
    kept = json.loads(invoke("study", "seeds", "rotor-20", *small))
    assert kept["seeds"] == 2
    assert kept["table"]["ceeq at 32000 h"]["means"] == 2


def test_a_stored_reference_is_compared_without_numpyro() -> None:
    kept = json.loads(invoke("study", "reference", "thin-coating", "--seeds", "1"))["rotors"][
        "thin-coating"
    ]
    assert kept["blades"] == 10
    assert len(kept["log_evidence"]) == len(kept["worst"]) == 1
    assert set(kept["worst"][0]["beyond"]) == {"mean", "ratio", "correlation"}


def test_a_schedule_study_compares_arms_with_the_joint_posterior(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(schedule_study, "PLAIN", schedule_study.PLAIN[:2])
    small = ("--rotors", "1", "--disturbed", "0", "--blades", "4", "--particles", "200")
    kept = json.loads(invoke("study", "schedule", *small, "--no-shipped"))
    assert set(kept["coverage"]) == {"joint", "offline"}
    assert kept["coverage"]["joint"]["t1t_rate"]["sd_ratio"] == 1
    assert kept["coverage"]["offline"]["creep_steady"]["truths"] == 6
    assert kept["joint_online_is_offline"] == 0


def test_a_study_of_adaptive_designs_keeps_curves_ratios_and_a_plot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The runs are made up here; tests/core/validation/test_adaptive.py makes some."""

    def made(chosen: adaptive.Study, *_: object, **__: object) -> list[dict[str, Any]]:
        def points(sizes: Sequence[int], power: float, seed: int) -> list[adaptive.Point]:
            return [adaptive.Point(n, 0.03 * (16 / n) ** (power + 0.1 * seed), 0.05) for n in sizes]

        rows = []
        for k in range(chosen.seeds):
            shots = points(chosen.sizes, 2.0, k)
            curve = points(range(16, 39, 4), 4.6, k)
            control = points(range(16, 39, 4), 1.6, k)
            found = {"one_shot": shots, "adaptive": curve, "uniform": control}
            row: dict[str, Any] = {n: [asdict(p) for p in own] for n, own in found.items()}
            row |= {"rotor": k, "region": {"mean": [1.0, 0.83 + 0.03 * k, 0.0, 0.0]}}
            row["ratios"] = adaptive.ratios(curve, shots)
            rows.append(row | {"uniform_ratios": adaptive.ratios(control, shots)})
        return rows

    monkeypatch.setattr(adaptive, "run", made)
    kept = json.loads(invoke("study", "adaptive", "--seeds", "3", "--out", tmp_path))
    assert kept["study"]["sizes"] == [16, 26, 40, 54]
    told = kept["summary"]
    assert told["ratios"]["at_size"]["40"] == pytest.approx((16 / 40) ** (1 - 2.1 / 4.7), rel=0.02)
    assert told["met_by_mean"] is True
    assert told["seeds_met"] == 3
    assert told["uniform_ratios"]["reached"] == 0, "the control does not get there"
    assert len(kept["seeds"]) == 3
    assert len((tmp_path / "error.png").read_bytes()) > 20_000
