"""Simulation-based calibration: a short version here, the studies' results beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.validation.coverage import Record, run
from core.validation.sbc import CONTROLS, coverage, ecdf
from core.validation.variants import Variant, plan
from core.validation.verdict import collected, curves, names, summary

RESULTS = Path(__file__).with_name("results")
KEPT = [
    pytest.param(json.loads(file.read_text()), id=file.parent.name)
    for file in sorted(RESULTS.glob("*/result.json"))
    if "variant" in (kept := json.loads(file.read_text()))
    and "seeds" not in kept
    and "next_outage" not in kept  # of lives: `test_lives_kept`
]
# studies that missed .68 ± .05 or .95 ± .03, kept as they came out: of two shared parameters at a
# standard error of .031 one is missed by chance one time in four, both one in fifty (beside
# fourteen finite-element truths the noise has .919 ± .023, T1T .738 ± .057); ranks are inside
MISSED = {
    ("rotor-100", 200, 7),
    ("fe", 210, 11),
    ("fe-nu-six-outages", 210, 12),
}
# forty claims and twenty bands of one study; each half of its rotors misses others. One of seven
# bands, by a thousandth: three exact runs in ten leave one of theirs
AMONG_MANY = {
    ("rotor-20", 500, 13): (["creep_transient"], []),
    # the code before, whose draws were uneven, misses the same two on these rotors
    ("rotor-20", 300, 13859738): (["tbc_thickness"], ["sigma_obs.elongation"]),
    ("eight-shared", 400, 11): (
        ["theta.deformation.y", "creep_transient, CEEQ read"],
        ["t1t_rate", "creep_transient, scanned blade"],
    ),
}
# truths that are no draws from the prior (every coating at an end of its range): predictions cover
# .68 ± .03 and .95 ± .02, but are narrow by more than chance
NARROW = {("coating-at-bounds", 200, 10)}
# finite-element runs on the surrogate's own mesh lack the error nu that the network declares of a
# mesh: with six readings a blade a noise below 0.01 mm is then taken for smaller still
WITHOUT_NU = {("fe-six-outages", 210, 11)}
FEW_NU = ["sigma_obs.elongation", "tbc_thickness, posterior at a bound", "held-out elongation"]
# two rotors of 400 were not placed: a message was nats off at a few shared values, and placements
# kept halving (mended since, `panels-13`: 0.5 and 0.6); their states say that they are degenerate
NOT_PLACED = {("mixed", 400, 12): 0.05}
SHORT = plan("rotor-20", blades=4)
ROTORS, SEED, PARTICLES = 20, 20, 1000


def study(folder: Path, rotors: int = ROTORS, processes: int = 1) -> list[Record]:
    return run(
        SHORT, rotors=rotors, seed=SEED, particles=PARTICLES, folder=folder, processes=processes
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study")


@pytest.fixture(scope="module")
def records(folder: Path) -> list[Record]:
    """Twenty rotors of four blades, none dropped."""
    return study(folder)


def pooled(records: list[Record], key: str) -> tuple[np.ndarray, np.ndarray]:
    """All local truths as one sample; a rotor is a cluster."""
    parts = [
        collected(records, "truths", name, key)
        for name in ("tbc_thickness", "creep_transient", "creep_steady")
    ]
    values, cluster = zip(*parts, strict=True)
    return np.concatenate(values), np.concatenate(cluster)


def test_truths_fall_evenly_into_their_posteriors(records: list[Record]) -> None:
    result = summary(records, curves(records))
    assert result["failed"] == {}
    # of seven bands of 95 % three exact runs in ten leave one; 1,000 particles move PITs by 0.03
    assert len(result["outside_band"]) <= 1
    assert result["least_ess_ratio"] > 0.3
    assert ecdf(*pooled(records, "pit")).inside
    share, error = coverage(*pooled(records, "cdf"), 0.68)
    assert abs(share - 0.68) < 4 * error


@pytest.mark.parametrize("control", ["narrow", "shifted"])
def test_a_wrong_sampler_fails_the_same_test(records: list[Record], control: str) -> None:
    """Negative controls. A normal of equal moments, the third one, takes more rotors to tell."""
    assert control in CONTROLS
    assert not ecdf(*pooled(records, control)).inside


def test_held_out_readings_fall_evenly_into_their_predictions(records: list[Record]) -> None:
    row = summary(records, curves(records))["table"]["held-out elongation"]
    assert row["truths"] == ROTORS * SHORT.blades
    assert abs(row["inside_68"] - 0.68) < 4 * row["error_68"]
    for part in ("parameters", "value", "reading"):
        mean, error = row[f"square_{part}"]
        assert abs(mean - 1) < 4 * error


def test_a_cut_study_goes_on_in_other_processes_and_ends_alike(
    folder: Path, records: list[Record]
) -> None:
    """The last rotor's line is cut in the middle: it alone is computed again."""
    (file,) = folder.glob("*.jsonl")
    whole = file.read_text()
    file.write_text(whole[:-40])
    again = study(folder, processes=2)

    def timeless(record: Record) -> dict[str, Any]:
        return {key: value for key, value in record.items() if key != "seconds"}

    assert [timeless(r) for r in again] == [timeless(r) for r in records]
    assert again[:-1] == records[:-1]


@pytest.mark.parametrize("kept", KEPT)
def test_a_kept_study_holds(kept: dict[str, Any]) -> None:
    """No rotor failed; shares and squares by source near what they should be; controls caught.

    A study of 200 rotors or more is held to its own verdict: all claims, and all controls caught
    (a normal of equal moments is too near the truth for 40 rotors to tell, or for fourteen truths
    however often each is read).
    """
    assert kept["failed"] == {}
    which = (kept["variant"], kept["rotors"], kept["seed"])
    assert kept["least_ess_ratio"] >= NOT_PLACED.get(which, 0.1)
    drawn = kept["controls_caught"] is not None
    if drawn:
        assert kept["controls_caught"]["narrow"]
        assert kept["controls_caught"]["shifted"]
    if which in MISSED:
        assert not kept["passed"]
        assert kept["outside_band"] == []
        assert set(kept["not_covering"]) <= {"t1t_rate", "sigma_obs.elongation"}
    elif which in AMONG_MANY:
        assert not kept["passed"]
        assert (kept["outside_band"], kept["not_covering"]) == AMONG_MANY[which]
    elif which in NARROW:
        row = kept["table"]["held-out elongation"]
        assert not kept["passed"]
        assert kept["not_covering"] == []
        assert kept["outside_band"] == ["held-out elongation"]
        assert row["square_value"][0] == pytest.approx(1.213, abs=0.001)
        assert 0.65 < row["inside_68"] < 0.68
        assert 0.93 < row["inside_95"] < 0.95
        return
    elif which in WITHOUT_NU:
        table = kept["table"]
        assert kept["outside_band"] == ["sigma_obs.elongation"]
        assert sorted(kept["not_covering"]) == sorted(FEW_NU)
        assert table["sigma_obs.elongation"]["inside_95"] < 0.9
        for name in ("t1t_rate", "tbc_thickness", "creep_transient", "creep_steady"):
            assert table[name]["covers"]
        return
    elif max(row["clusters"] for row in kept["table"].values()) < 40:
        assert kept["not_covering"] == kept["outside_band"] == []
    elif kept["rotors"] >= 200:
        assert kept["passed"]
    for name, row in kept["table"].items():
        if not drawn and not name.startswith("held-out"):
            continue
        for c in (68, 95):
            nominal = np.sqrt(c / 100 * (1 - c / 100) / row["truths"])
            assert abs(row[f"inside_{c}"] - c / 100) < 3.5 * max(row[f"error_{c}"], nominal), name
        if drawn:
            for part in ("parameters", "value", "reading"):
                mean, error = row.get(f"square_{part}", (1.0, 0.0))
                assert abs(mean - 1) <= 4 * error, (name, part)


def test_a_rotor_that_cannot_be_calibrated_is_counted(records: list[Record]) -> None:
    broken: Record = {**records[0], "truths": {}, "held": {}, "error": "no nodes"}
    result = summary([broken, *records[1:]], curves(records[1:]))
    assert result["failed"] == {0: "no nodes"}
    assert not result["passed"]
    assert names(records, "truths")[0] == "t1t_rate"


def test_variants_are_values() -> None:
    """A record's file is named by its variant: equal plans are equal, others are not."""
    assert plan("rotor-100") == Variant("rotor-100")
    assert repr(plan("mixed")) != repr(plan("mixed", 20))
