"""What the service said of measured creep curves: the kept answer, as it was given over HTTP."""

from __future__ import annotations

import json
from typing import Any

from core.builtin import creep_specimens as built
from core.model import Model
from tests.claims.make_specimen_diagnosis import COMMAND, FILE, readings
from tests.claims.specimen_data import specimens

KEPT: dict[str, Any] = json.loads(FILE.read_text())
TOLD: dict[str, Any] = KEPT["result"]
DECOYS = {"drift of the extensometer", "offset of the extensometer", "gain of an extensometer"}


def test_it_is_the_answer_of_the_present_model_to_all_readings() -> None:
    assert KEPT["command"] == COMMAND
    assert KEPT["model"] == Model(built.network(), built.formula()).digest
    assert TOLD["readings"] == {"delivered": 276, "used": 276}


def test_primary_and_tertiary_creep_are_claimed_together_and_no_decoy_is() -> None:
    assert TOLD["verdict"] == "effect"
    assert TOLD["names"] == ["primary creep", "tertiary creep"]
    assert TOLD["gained_nat"] > 500
    assert TOLD["p"] <= 0.05
    assert TOLD["p_after"] > 0.01
    assert not DECOYS & set(TOLD["names"])
    assert {e["name"] for e in TOLD["effects"]} == set(TOLD["names"])


def test_neither_alone_is_worth_what_both_are() -> None:
    gained = {frozenset(c["names"]): c["gained_nat"] for c in TOLD["calibrated"]}
    both = gained[frozenset({"primary creep", "tertiary creep"})]
    assert both > gained[frozenset({"tertiary creep"})] + 200
    assert gained[frozenset({"primary creep", "drift of the extensometer"})] < 5


def test_the_decoy_that_was_tried_and_the_stress_that_fails_are_said() -> None:
    said = " ".join(TOLD["reasons"])
    assert "drift of the extensometer would gain 14.0 nat more, but not in each half by" in said
    by_stress = {c["value"]: c for c in TOLD["conditions"]}
    assert sorted(by_stress) == [140.0, 170.0, 200.0, 230.0]
    for stress, one in by_stress.items():
        assert (one["after"]["rmse"] < one["before"]["rmse"]) is (stress < 230)
        assert one["holds"] is (stress in (170, 200)), "at 140 MPa bands shrink more than errors"
        assert (f"does not hold at stress = {stress:g}" in said) is not one["holds"]


def test_each_half_finds_both_by_itself_and_one_has_not_one_amplitude() -> None:
    assert len(TOLD["holds"]) == 4
    for one in TOLD["holds"]:
        assert min(one["gained_nat"]) > 100
        assert one["stands"]
        assert one["agrees"] is (one["effect"] == "primary creep")
    said = [why for why in TOLD["reasons"] if why.startswith("tertiary creep is found")]
    assert len(said) == 2
    assert all("a forecast with one amplitude for all is too sure" in why for why in said)


def test_no_placebo_of_either_gains_as_much() -> None:
    asked = {(one["effect"], one["by"]): one for one in TOLD["placebos"]}
    ways = ("other blades", "other readings")
    assert set(asked) == {(name, by) for name in TOLD["names"] for by in ways}
    for one in asked.values():
        assert (one["won"], one["stands"]) == (0, True)
        assert one["count"] > 150


def test_forecasts_of_readings_that_neither_model_used_got_better() -> None:
    both = TOLD["before_after"]
    assert both["after"]["rmse"] < 0.4 * both["before"]["rmse"]
    assert both["after"]["log_score"] > both["before"]["log_score"] + 5
    assert len(both["held_out"]) == 43


def test_ids_say_nothing_and_the_order_is_none_of_the_data() -> None:
    """Skips without the measured data."""
    posted = readings(KEPT["seed"])
    assert [one["id"] for one in posted] == [f"i{k:04d}" for k in range(276)]
    natural = [(r.blade, r.time_h) for one in specimens() for r in one.readings]
    assert [(one["blade"], one["time_h"]) for one in posted] != natural
    assert sorted((one["blade"], one["time_h"]) for one in posted) == sorted(natural)
