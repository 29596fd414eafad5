"""The paper at full scale: what was asked of reduction and surrogate, and what came out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.claims.words import WORDS

KEPT = Path(__file__).parent / "results" / "full-scale"


def kept(name: str) -> Any:
    return json.loads((KEPT / name).read_text())


def test_the_surrogate_of_the_full_archive_is_as_good_as_was_asked() -> None:
    made = kept("model-manifest.json")
    assert (made["mesh"], made["nodes"]) == ("paper", 27_360)
    assert made["runs"] == {"training": 66, "test": 34}
    errors = made["errors"]
    tip, ceeq = errors["elongation"]["from_1000_h"], errors["ceeq"]["worst_node_from_1000_h"]
    assert tip["median_percent"] <= 0.5
    assert tip["p95_percent"] <= 2.0
    assert errors["deformation"]["rmse_mm"] <= 0.01
    assert ceeq["median_percent"] <= 1.0
    assert ceeq["p95_percent"] <= 4.0
    for quantity in ("elongation", "ceeq", "deformation"):
        assert 0.92 <= errors[quantity]["coverage_95"] <= 0.99
    row = f"{tip['median_percent']:.2f} / {tip['p95_percent']:.2f} %"
    assert row in WORDS, "the README says another error of the tip"


def test_twenty_joint_features_rebuild_runs_that_were_left_out_to_one_percent() -> None:
    result = kept("reduction/result.json")
    assert (result["nodes"], result["instants"], len(result["quantities"])) == (27_360, 54, 6)
    assert result["runs"] == {"training": 66, "held_out": 34}
    assert result["peak_mb"] < 4000
    table = (KEPT / "reduction" / "table.md").read_text()
    whole = next(li for li in table.splitlines() if li.startswith("| error of a quantity"))
    assert float(whole.split("|")[2].split("%")[0]) <= 1.0


@pytest.mark.parametrize("folder", ["contest", "reduction"])
def test_what_is_kept_says_by_which_command_and_commit(folder: str) -> None:
    result = kept(f"{folder}/result.json")
    assert result["command"].startswith(f"bladetwin study {folder} --archive ")
    assert len(result["commit"]) == 40


def test_the_contest_at_full_scale_has_the_same_first_as_the_default_mesh() -> None:
    full = kept("contest/result.json")
    other = json.loads((KEPT.parent / "contest" / "result.json").read_text())
    assert full["best"] == other["best"] == {"name": "gaussian process", "targets": "transformed"}
    assert not full["not_installed"], "all seven took part"
