"""Kept studies of fleets: twice 402 clean sets, five effects of physics, and these in scans."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.validation import effects_study as study
from core.validation.effect_gains import improvement
from core.validation.effect_sets import CLEAN, CONDITIONS, NAMED, OUTSIDE, PHYSICS
from tests.claims.words import FIGURES, WORDS

RESULTS = Path(__file__).parent / "results"


def kept(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((RESULTS / name / "result.json").read_text())
    return found


@pytest.mark.parametrize(
    ("name", "kinds", "sets"),
    [
        ("effects-clean", CLEAN, 134),
        ("effects-clean-2", CLEAN, 134),
        ("effects-clean-3", CLEAN, 24),
        ("effects-clean-4", CLEAN, 134),
        ("effects-six-visits-clean", CLEAN, 16),
        ("effects-fleet-physics", PHYSICS, 6),
        ("effects-scans", ("clean", *PHYSICS, "pulse"), 2),
        ("effects-scans-clean", ("clean",), 8),
        ("effects-scans-all", CONDITIONS, 4),
        ("effects-fleet-2", CONDITIONS, 4),
        ("effects-scans-second", CONDITIONS, 1),
        ("effects-scans-second-2", CONDITIONS, 2),
        ("effects-scans-alike", CONDITIONS, {"clean": 2, "planted": 1}),
        ("effects-scans-alike-second", CONDITIONS, {"clean": 2, "planted": 1}),
        ("effects-late", ("some blades late",), 6),
        ("effects-late-second", ("some blades late",), 6),
        ("effects-scans-named", NAMED, 1),
        ("effects-scans-named-second", NAMED, 1),
        ("effects-worn", ("worn lot",), 12),
        ("effects-sensors", ("campaign", "instrument", "gain"), 6),
        ("effects-chosen", ("wear", "worn lot", "fouling", "step", "tertiary"), 2),
    ],
)
def test_every_set_is_there_and_the_seed_comes_from_the_commit(
    name: str, kinds: tuple[str, ...], sets: int | dict[str, int]
) -> None:
    found = kept(name)
    numbers = {(one["condition"], one["number"]) for one in found["sets"]}
    counts = sets if isinstance(sets, dict) else {"clean": sets, "planted": sets}
    assert numbers == {
        (kind, n) for kind in kinds for n in range(counts["clean" if kind in CLEAN else "planted"])
    }
    assert study.table(found["sets"]) == found["table"]
    assert study.marks(found["table"]) == pytest.approx(found["marks"])
    assert improvement(found["sets"]) == found["improvement"]
    beside = ("effects-late-second", "effects-scans-named-second")  # ones of the same commit
    begin = 1 if name in beside else 0
    assert found["seed"] == int(found["commit"][begin : begin + 6], 16)


def test_whoever_chooses_what_was_planted_is_nearer_than_with_another_alternative() -> None:
    """Ten fleets whose effects the readings do not name; errors of the forecast in percent."""
    found = kept("effects-chosen")["sets"]
    known = [s["rivals"] for s in found if s.get("rivals", {}).get("chosen") is not None]
    errors = {k: 100 * np.mean([abs(r[k]) for r in known]) for k in ("before", "chosen", "missed")}
    told = {k: round(float(v), 1) for k, v in errors.items()}
    assert (len(known), told) == (6, {"before": 2.2, "chosen": 1.5, "missed": 2.7})
    assert "errs by 1.5 %,\nwhere the model as it was errs by 2.2 % and another" in WORDS
    placebos = [one for s in found for one in s["placebos"]]
    assert (sum(count for *_, count, _ in placebos), sum(won for *_, won in placebos)) == (1194, 0)
    assert [s["outcome"] for s in found].count("in the set") == 3
    assert {s["outcome"] for s in found} == {"in the set", "silent"}


def test_no_name_that_is_right_is_lost_to_placebos() -> None:
    """Three kinds of sensors' faults; and twelve worn lots, as before there were any."""
    sensors, worn = kept("effects-sensors"), kept("effects-worn-placebos")
    before = [s for s in kept("effects-worn")["sets"] if s["condition"] == "worn lot"]
    assert [s["outcome"] for s in worn["sets"]] == [s["outcome"] for s in before]
    assert [s["gained_nat"] for s in worn["sets"]] == [s["gained_nat"] for s in before]
    right = {kind: 6 * row["right"] for kind, row in sensors["table"].items()}
    assert right == pytest.approx({"campaign": 6, "instrument": 6, "gain": 4})
    assert {row["wrong"] for row in sensors["table"].values()} == {0.0}
    for found, count, won in ((sensors, 6367, 0), (worn, 3221, 1)):
        asked = [one for s in found["sets"] for one in s["placebos"]]
        assert (sum(n for *_, n, _ in asked), sum(k for *_, k in asked)) == (count, won)
        assert f"{count:,} placebos" in WORDS
    assert "1 of 9,588; none" in FIGURES


def test_worn_lots_have_the_room_of_their_blades_and_what_leans_on_it_is_told() -> None:
    """0.40 is planted; the room of the prior's thinnest coating was 0.44 to 0.48."""
    found = kept("effects-worn")
    row, gains = found["table"]["worn lot"], found["improvement"]["worn lot"]
    assert (round(12 * row["right"]), row["wrong"], row["alarms"]) == (9, 0.0, 1.0)
    assert "**9 of 12** get the right" in WORDS
    leans = [s for s in found["sets"] if any("leans" in why for why in s["reasons"])]
    assert [s["word"] for s in leans] == ["unattributed"]
    wear = [s["effects"][n] for s in found["sets"] for n in s["effects"] if len(s["effects"]) == 1]
    assert all(abs(mean - 0.4) < 2.0 * sd for mean, sd in wear)
    assert sum(mean > 0.437 for mean, _ in wear) == 4, "what the old room would have cut off"
    assert (round(12 * gains["better"]), round(gains["rmse"], 2)) == (11, 0.52)


def test_clean_sets_alarm_as_seldom_as_asked_and_those_of_heavy_tails_too_often() -> None:
    found = kept("effects-clean")
    alarms = {kind: round(134 * found["table"][kind]["alarms"]) for kind in CLEAN}
    assert list(alarms.values()) == [4, 14, 6]
    assert found["marks"]["clean, alarms"] <= 0.075
    assert found["table"]["clean, heavy tails"]["alarms"] > 0.075, "missed, and said"
    assert "24 of 402" in WORDS
    assert "14 of 134" in WORDS
    names = [one["names"] for one in found["sets"] if one["outcome"] == "wrong"]
    assert all(len(one) == 1 and one[0].startswith("tip rub (blade") for one in names)
    assert len(names) == 4


def test_by_todays_rules_heavy_tails_alarm_as_seldom_as_asked_and_one_false_claim_is_told() -> None:
    found = kept("effects-clean-2")
    alarms = [round(134 * found["table"][kind]["alarms"]) for kind in CLEAN]
    assert alarms == [4, 8, 10]
    assert max(alarms) / 134 <= 0.075
    assert "22 of 402" in WORDS
    claimed = [one for one in found["sets"] if one["word"] == "effect"]
    said = [(one["condition"], one["names"]) for one in claimed]
    assert said == [(CLEAN[2], ["gas temperature"])]
    assert "one set with bursts is called an effect" in WORDS
    assert kept("effects-scans-clean")["table"]["clean"]["alarms"] == 0.0


def test_with_control_variates_clean_sets_alarm_as_seldom_as_asked() -> None:
    found = kept("effects-clean-3")
    alarms = [round(24 * found["table"][kind]["alarms"]) for kind in CLEAN]
    assert alarms == [0, 0, 3]
    assert "3 of 72" in WORDS
    assert found["marks"]["clean, alarms"] < 0.075
    assert all(one["word"] != "effect" for one in found["sets"])


def test_physics_of_two_noises_is_noticed_and_not_named_and_never_wrongly() -> None:
    found = kept("effects-fleet-physics")
    assert found["marks"]["named, wrong"] == found["marks"]["named, right"] == 0.0
    rows = {
        k: [round(6 * row[w]) for w in ("alarms", "in the set")]
        for k, row in found["table"].items()
    }
    assert rows == {
        "wear": [6, 3], "worn lot": [3, 0], "fouling": [4, 0], "step": [6, 4], "tertiary": [6, 2]
    }  # fmt: skip
    assert "9 of 30" in WORDS
    for one in found["sets"]:
        if "rivals" in one:
            assert abs(one["rivals"]["z"]) < 1.0


def test_in_scans_physics_is_named_where_elongations_left_it_open() -> None:
    found = kept("effects-scans")
    assert found["plan"] == "fleet-scans"
    named = [one for one in found["sets"] if one["condition"] in PHYSICS]
    count = {w: sum(one["outcome"] == w for one in named) for w in ("right", "in the set", "wrong")}
    assert count == {"right": 8, "in the set": 1, "wrong": 0}
    assert all(one["alarm"] for one in named)
    assert "**8 of 10**" in WORDS
    assert found["table"]["pulse"]["right"] == found["table"]["clean"]["right"] == 1.0
    errors = [[abs(one[when]["forecast_error"]) for one in named] for when in ("before", "after")]
    assert sum(errors[1]) < 0.3 * sum(errors[0])


def test_the_bias_of_readings_falls_where_an_effect_moves_all_blades() -> None:
    whole: dict[str, list[float]] = {}
    for one in kept("effects-scans-all")["sets"]:
        if "after" in one and one["condition"] in NAMED:
            before, after = (abs(one[side]["exact_bias"]) for side in ("before", "after"))
            sums = whole.setdefault(one["condition"], [0.0, 0.0, 0.0])
            whole[one["condition"]] = [sums[0] + before, sums[1] + after, sums[2] + 1]
    falls = {k: 100 * (1 - a / b) for k, (b, a, n) in whole.items() if b / n >= 0.01}
    assert {k: round(v) for k, v in falls.items()} == {
        "campaign": 91, "step": 83, "wear": 82, "fouling": 78, "tertiary": 58,
    }  # fmt: skip
    assert min(v for k, v in falls.items() if k != "tertiary") >= 70
    assert {k for k in whole if k not in falls} == {"instrument", "gain", "worn lot"}
    assert "falls by 91 % with a campaign's offset" in WORDS
    assert "78 with fouling and 58 with accelerating creep" in WORDS


def test_in_scans_most_names_are_right_and_what_is_missed_is_said() -> None:
    found = kept("effects-scans-all")
    assert found["plan"] == "fleet-scans"
    marks = found["marks"]
    assert marks["clean, alarms"] == 0.0
    assert marks["alike, not separable"] == marks["named, alarms"] == 1.0
    assert marks["named, right"] == 28 / 32 > 0.85
    assert marks["named, wrong"] == 1 / 32 < 0.05
    assert marks["outside, no name"] == pytest.approx(11 / 12)
    assert "**28 of 32**" in WORDS
    assert "11 of 12" in WORDS
    right = {kind: found["table"][kind]["right"] for kind in NAMED}
    assert [kind for kind, share in right.items() if share < 0.7] == ["fouling"], "missed, and said"
    wrong = [(one["condition"], one["names"]) for one in found["sets"] if one["outcome"] == "wrong"]
    assert [condition for condition, _ in wrong] == ["some blades late", "step"]
    assert wrong[0][1][0].startswith("campaign offset")
    assert wrong[1][1] == ["firing temperature step", "root settling"]
    nearer = {kind: found["improvement"][kind]["forecast"] for kind in PHYSICS}
    assert [kind for kind, share in nearer.items() if share > 0.3] == ["worn lot"], "missed, said"
    told = [found["improvement"][kind] for kind in NAMED]
    assert all(one["better"] == 1.0 and 0.90 <= one["inside 95"] <= 0.98 for one in told)


def test_on_a_second_scanned_rotor_most_names_are_right_too_and_what_is_missed_is_said() -> None:
    first, second = kept("effects-scans-all"), kept("effects-scans-second")
    assert second["plan"] == "fleet-scans-2"
    outcome = {one["condition"]: one["outcome"] for one in second["sets"]}
    assert {kind for kind in NAMED if outcome[kind] != "right"} == {"fouling"}
    assert outcome["fouling"] == "in the set"
    assert [kind for kind in CONDITIONS if outcome[kind] == "wrong"] == ["some blades late"]
    assert second["marks"]["named, alarms"] == second["marks"]["alike, not separable"] == 1.0
    assert second["marks"]["clean, alarms"] == 0.0
    sets = [one for found in (first, second) for one in found["sets"]]
    named = [one["outcome"] for one in sets if one["condition"] in NAMED]
    assert (len(named), named.count("right"), named.count("wrong")) == (40, 35, 1)
    assert "35 of 40" in WORDS
    rest = {"pulse", "alternating", "some blades late"}
    free = [one["outcome"] for one in sets if one["condition"] in rest]
    assert (len(free), free.count("right")) == (15, 13), "missed, and said"
    assert "13 of 15" in WORDS
    nearer = {kind: 1 - second["improvement"][kind]["forecast"] for kind in PHYSICS}
    assert {kind for kind, share in nearer.items() if share >= 0.7} == {"fouling"}
    assert "80 % with fouling, 67 with wear, 66 with accelerating creep, 61 with a step" in WORDS


def test_a_third_of_the_blades_late_is_hardly_called_an_offset_of_all() -> None:
    sets = [s for name in ("effects-late", "effects-late-second") for s in kept(name)["sets"]]
    assert [one["outcome"] for one in sets].count("right") == 11
    assert 11 / len(sets) >= 0.9
    assert "**11 of 12** sets with a third of the blades late get no name" in WORDS
    (wrong,) = (one for one in sets if one["outcome"] == "wrong")
    assert f"an offset of that visit ({wrong['gained_nat']:.1f} nat)" in WORDS
    refused = [one["reasons"][0] for one in sets if one["effects"] and one is not wrong]
    assert sum("is open" in why for why in refused) == 2
    assert sum("not in all 100 blades" in why and "about 40%" in why for why in refused) == 1
    assert len(refused) == 3
    rest = [
        one["outcome"]
        for name in ("effects-scans-all", "effects-scans-second")
        for one in kept(name)["sets"]
        if one["condition"] in ("pulse", "alternating")
    ]
    assert (len(rest), rest.count("right")) == (10, 10)
    assert "21 of 22 of what is outside" in WORDS


def test_what_has_a_name_keeps_it_beside_the_rival_of_some_blades() -> None:
    both = [kept(name) for name in ("effects-scans-named", "effects-scans-named-second")]
    sets = [one for found in both for one in found["sets"]]
    assert [one["outcome"] for one in sets].count("right") == 14
    assert "**14 of 16** get it alone" in WORDS
    silent = {one["condition"] for one in sets if one["outcome"] == "silent"}
    assert silent == {"fouling", "tertiary"}
    assert len(sets) == 16
    reasons = [why for one in sets for why in one["reasons"]]
    assert not any("is open" in why or "not in all" in why for why in reasons)
    nearer = {k: round(100 * (1 - v["forecast"])) for k, v in both[1]["improvement"].items()}
    assert [nearer[k] for k in ("wear", "fouling", "step", "tertiary", "worn lot")] == [
        74, 71, 84, 82, 58,
    ]  # fmt: skip
    assert "74 % with wear, 71 with fouling, 84 with a step, 82 with accelerating creep" in WORDS
    first = both[0]["improvement"]
    assert [round(100 * (1 - first[k]["forecast"])) for k in ("wear", "worn lot")] == [54, 86]
    better = sum(found["improvement"][kind]["better"] for found in both for kind in NAMED)
    assert better == 15
    known = ("effects-scans-all", "effects-scans-second")
    older = [one for name in known for one in kept(name)["sets"] if one["condition"] in NAMED]
    right = [one["outcome"] for one in (*sets, *older)].count("right")
    assert (right, len(sets) + len(older)) == (49, 56)
    assert "49 of 56 right names (87.5 %), 1 of 56 wrong" in WORDS


def test_the_second_rotor_with_scans_by_todays_rules_names_all_but_accelerating_creep() -> None:
    found = kept("effects-scans-second-2")
    assert (found["plan"], found["algorithm"]) == ("fleet-scans-2", "panels-19")
    right = {k: round(2 * row["right"]) for k, row in found["table"].items()}
    assert {k: right[k] for k in NAMED if right[k] < 2} == {"fouling": 1, "tertiary": 0}
    assert [s["outcome"] for s in found["sets"]].count("wrong") == 0
    assert found["marks"]["named, alarms"] == found["marks"]["outside, no name"] == 1.0
    assert sum(right[k] for k in CLEAN) == 4
    loud = [s for s in found["sets"] if s["condition"] in CLEAN and s["alarm"]]
    assert [(s["condition"], s["names"]) for s in loud] == [("clean, heavy tails", [])] * 2
    nearer = {k: round(100 * (1 - v["forecast"])) for k, v in found["improvement"].items()}
    assert [nearer[k] for k in ("wear", "worn lot", "fouling", "step", "tertiary")] == [
        89, 91, 78, 71, 75,
    ]  # fmt: skip
    every = ("effects-scans-all", "effects-scans-second", "effects-scans-named",
             "effects-scans-named-second", "effects-scans-second-2")  # fmt: skip
    named = [s for one in every for s in kept(one)["sets"] if s["condition"] in NAMED]
    told = [s["outcome"] for s in named]
    assert (told.count("right"), told.count("wrong"), len(told)) == (62, 1, 72)
    for said in ("**13 of 16** effects", "62 of 72 right names (86 %), 1 of 72 wrong"):
        assert said in WORDS


def test_by_todays_rules_sensors_are_named_in_fleets_and_physics_is_not() -> None:
    found = kept("effects-fleet-2")
    outcomes = {
        kind: [one["outcome"] for one in found["sets"] if one["condition"] == kind]
        for kind in CONDITIONS
    }
    named = {kind for kind in NAMED if outcomes[kind] == ["right"] * 4}
    assert named == set(NAMED) - set(PHYSICS)
    assert sum(outcomes[kind].count("right") for kind in PHYSICS) == 0
    alarms = sum(one["alarm"] for one in found["sets"] if one["condition"] in PHYSICS)
    assert f"Physics alarms in {alarms} of 20 and none is named" in WORDS
    assert found["marks"]["named, right"] == 0.375, "missed, and said"
    assert "12 of 32 get their name, 38 %" in WORDS
    assert sum(outcomes[kind].count("wrong") for kind in NAMED) == 1
    assert found["marks"]["named, wrong"] <= 0.05
    assert found["marks"]["outside, no name"] == found["marks"]["alike, not separable"] == 1.0
    better = found["improvement"]
    assert f"nearer by {100 * (1 - better['wear']['forecast']):.0f} % with wear" in WORDS
    assert f"{100 * (1 - better['tertiary']['forecast']):.0f} % with accelerating creep" in WORDS
    assert f"{100 * (better['step']['forecast'] - 1):.0f} % farther with a step" in WORDS


def test_two_courses_in_the_model_cost_forecasts_of_scanned_fleets_nothing() -> None:
    found, before = kept("effects-courses"), kept("effects-scans-all")
    assert found["seed"] == before["seed"], "the very sets"
    numbers = {(one["condition"], one["number"]) for one in found["sets"]}
    assert numbers == {(kind, n) for kind in PHYSICS for n in range(2)}
    assert {one["outcome"] for one in found["sets"]} == {"right"}
    same = [one for one in before["sets"] if (one["condition"], one["number"]) in numbers]
    nearer = [
        {kind: round(100 * (1 - of[kind]["forecast"])) for kind in PHYSICS}
        for of in (found["improvement"], improvement(same))
    ]
    assert [
        tuple(of[kind] for kind in ("wear", "worn lot", "fouling", "step", "tertiary"))
        for of in nearer
    ] == [(93, 90, 71, 95, 71), (92, 93, 66, 95, 72)]
    assert "nearer by 93 % with wear (before 92), 90 with a worn lot (93)" in WORDS


def test_with_shared_errors_accelerating_creep_has_its_name_and_no_clean_set_alarms() -> None:
    """One set of each kind; in the two sets of this rotor before it had none."""
    found = kept("effects-scans-alike-second")
    assert (found["plan"], found["algorithm"]) == ("fleet-scans-2", "panels-19")
    named = [s for s in found["sets"] if s["condition"] in NAMED]
    assert [s["condition"] for s in named if s["outcome"] != "right"] == ["fouling"]
    assert found["table"]["fouling"]["in the set"] == 1.0
    (creep,) = (s for s in named if s["condition"] == "tertiary")
    assert creep["names"] == ["accelerating creep"]
    clean = [s for s in found["sets"] if s["condition"] in CLEAN]
    assert (len(clean), sum(s["alarm"] for s in clean)) == (6, 0)
    assert [round(f([s["p"] for s in clean]), 2) for f in (min, max)] == [0.07, 0.81]
    outside = {k: found["table"][k]["wrong"] for k in ("pulse", "alternating", "some blades late")}
    assert outside == {"pulse": 0.0, "alternating": 0.0, "some blades late": 1.0}
    nearer = {k: round(100 * (1 - v["forecast"])) for k, v in found["improvement"].items()}
    assert [nearer[k] for k in ("wear", "worn lot", "fouling", "step", "tertiary")] == [
        80, 99, 59, 81, 64,
    ]  # fmt: skip


def test_with_shared_errors_accelerating_creep_keeps_its_name_in_both_rotors() -> None:
    """One set of each kind in each; none had a name in three of the four sets before."""
    both = [kept("effects-scans-alike"), kept("effects-scans-alike-second")]
    assert [one["plan"] for one in both] == ["fleet-scans", "fleet-scans-2"]
    sets = [s for one in both for s in one["sets"]]
    named = [s for s in sets if s["condition"] in NAMED]
    told = [s["outcome"] for s in named]
    assert (told.count("right"), told.count("in the set"), told.count("wrong")) == (15, 1, 0)
    assert [s["condition"] for s in named if s["outcome"] == "in the set"] == ["fouling"]
    creep = [s for s in named if s["condition"] == "tertiary"]
    assert [s["names"] for s in creep] == [["accelerating creep"]] * 2
    clean = [s for s in sets if s["condition"] in CLEAN]
    assert (len(clean), sum(s["alarm"] for s in clean)) == (12, 0)
    outside = [s["outcome"] for s in sets if s["condition"] in OUTSIDE]
    assert (outside.count("right"), len(outside)) == (4, 6)
    alone = [s["word"] for s in sets if s["condition"] == "one scanner a visit"]
    assert alone == ["not separable"] * 2
    every = ("effects-scans-all", "effects-scans-second", "effects-scans-named",
             "effects-scans-named-second", "effects-scans-second-2")  # fmt: skip
    more = [s for one in every for s in kept(one)["sets"] if s["condition"] in NAMED]
    total = [s["outcome"] for s in (*named, *more)]
    assert (total.count("right"), total.count("wrong"), len(total)) == (77, 1, 88)
    for said in ("**15 of 16** effects", "77 of 88 right names (87.5 %), 1 of 88 wrong"):
        assert said in WORDS
