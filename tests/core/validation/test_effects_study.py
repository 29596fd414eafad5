"""The study of diagnoses: what is planted, how verdicts are counted, and two of its sets."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from core.diagnosis.verdict import Verdict
from core.errors import InputError
from core.validation import effect_fleet, effect_gains, fe_rotors
from core.validation import effect_sets as sets
from core.validation import effects_study as study
from core.validation.effect_fleet import FIVE_AGES, ONE_AGE, SIX_VISITS, Fleet
from core.validation.effect_gains import improvement
from core.validation.effect_plans import NOISE, plan
from core.validation.effect_truths import (
    EFFECTS,
    JOINED,
    ROTORS,
    VISITS_H,
    WORN,
    concerned,
    course,
    share,
)

TWENTY = plan("rotor-20")
NOTHING = Verdict("adequate", 0.4, None, (), None, (), {}, {}, (), ())


def said(word: str, *names: str) -> Verdict:
    return replace(NOTHING, word=word, names=names)  # type: ignore[arg-type]


def curves(condition: str, number: int, monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Readings without noise, by blade, hour and instrument, from a fixed draw."""
    with monkeypatch.context() as patch:
        patch.setattr(sets, "NOISE", 0.0)
        made = sets.made(TWENTY, condition, number, 5, 100)
    return {
        f"{r.blade} {r.time_h:.0f} {r.instrument}": float(r.values[0]) for r in made.case.readings
    }


def test_shares_are_those_of_the_blades_that_have_the_effect() -> None:
    for rotor in ROTORS:
        for effect in EFFECTS:
            own, with_it = share(rotor, effect), list(concerned(effect))
            without = [b for b in range(fe_rotors.BLADES) if b not in with_it]
            assert np.all(own[without] == 1.0)
            assert np.all(own[with_it][:, -1] > 1.0)
        assert set(concerned("wear")) == set(WORN)
        early, late = list(range(JOINED[0])), list(JOINED)
        pulse, step = share(rotor, "pulse"), share(rotor, "step")
        assert np.all(step[early][:, :2] == 1.0)  # 7,000 and 14,000 h are before it
        assert np.all(pulse[early, 1] > pulse[early, -1])  # a pulse is made up for with time
        assert np.all(step[late, 0] > 1.0)  # they are 7,000 h old at 21,000 h of the rotor


def test_a_pulse_ends_and_a_step_stays() -> None:
    inputs = {"t1t_rate": 0.9, "tbc_thickness": 1.0}
    assert course("pulse", inputs, 0)["t1t_rate"] == [
        (0.0, 0.9), (8e3, 0.9), (8e3, 0.93), (15e3, 0.93), (15e3, 0.9)
    ]  # fmt: skip
    assert course("pulse", inputs, 15)["t1t_rate"] == [(0.0, 0.93), (1e3, 0.93), (1e3, 0.9)]
    assert course("wear", inputs, 0)["tbc_thickness"][-1] == (5e4, 0.6)
    assert course("tertiary", inputs, 0)["tertiary"] == 3.0


def test_what_is_planted_is_on_the_readings_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = sets.made(TWENTY, "clean", 3, 5, 100)
    assert made.truth == frozenset()
    assert len(made.case.readings) == 14 * 6 + 6 * 4
    assert len({r.instrument for r in made.case.readings}) == 3
    truth = fe_rotors.load()
    clean = np.sort(list(curves("clean", 3, monkeypatch).values()))
    exact = np.stack([truth.at("elongation", 3, h) for h in VISITS_H[:6]], axis=1)
    expected = np.r_[exact[:14].ravel(), exact[14:, :4].ravel()]
    assert clean == pytest.approx(np.sort(expected), abs=6e-6)
    campaign = sets.made(TWENTY, "campaign", 3, 5, 100)
    (name,) = campaign.truth
    with monkeypatch.context() as patch:
        patch.setattr(sets, "NOISE", 0.0)
        patch.setattr(sets, "OFFSET", 1000.0)
        moved = sets.made(TWENTY, "campaign", 3, 5, 100).case.readings
    visit = name.split()[-1].rstrip(")")
    assert {r.campaign for r in moved if r.values[0] > 500} == {visit}
    assert all((r.values[0] > 500) == (r.campaign == visit) for r in moved)


def test_labels_ids_and_order_give_nothing_away() -> None:
    one, other = (
        sets.made(TWENTY, "worn lot", n, 5, 100) for n in (0, 4)
    )  # the same rotor and effect
    assert one.truth != other.truth
    for made in (one, other):
        ids = [r.id for r in made.case.readings]
        assert ids != sorted(ids)
        assert [r.time_h for r in made.case.readings] != sorted(
            r.time_h for r in made.case.readings
        )
    again = sets.made(TWENTY, "worn lot", 0, 5, 100)
    assert [r.id for r in again.case.readings] == [r.id for r in one.case.readings]


@pytest.mark.parametrize(
    ("condition", "verdict", "outcome"),
    [
        ("clean", said("adequate"), "right"),
        ("clean", said("unattributed"), "silent"),
        ("clean", said("effect", "a"), "wrong"),
        ("pulse", said("unattributed"), "right"),
        ("pulse", said("not separable", "a", "b"), "wrong"),
        ("gain", said("effect", "a"), "right"),
        ("gain", said("effect", "b"), "wrong"),
        ("gain", said("effect", "a", "b"), "wrong"),
        ("gain", said("not separable", "a", "b"), "in the set"),
        ("gain", said("not separable", "b", "c"), "wrong"),
        ("gain", said("adequate"), "silent"),
    ],
)
def test_outcomes_are_counted_as_said(condition: str, verdict: Verdict, outcome: str) -> None:
    assert study.judged(condition, frozenset({"a"}), verdict) == outcome


@pytest.mark.parametrize(
    ("each", "verdict", "outcome"),
    [
        ("ab", said("effect", "a", "b"), "right"),
        ("ab", said("effect", "b"), "one"),
        ("ab", said("effect", "a", "c"), "wrong"),
        ("ab", said("effect", "a", "A"), "wrong"),
        ("ab", replace(said("not separable", "b", "c"), beside=("a",)), "one"),
        ("ab", replace(said("not separable", "b", "c"), beside=("d",)), "wrong"),
        ("ab", said("not separable", "b", "c"), "in the set"),
        ("ab", said("not separable", "c", "d"), "wrong"),
        ("ab", said("unattributed"), "silent"),
        ("a", said("effect", "a"), "right"),
        ("a", said("effect", "a", "c"), "wrong"),
        ("a", said("unattributed"), "silent"),
    ],
)
def test_outcomes_of_two_are_counted_as_said(each: str, verdict: Verdict, outcome: str) -> None:
    """A and a are two names of one thing."""
    names = [frozenset({n, n.upper()}) for n in each]
    assert study.judged_two(names, verdict) == outcome


def test_two_are_planted_together_and_each_as_it_is_alone() -> None:
    fleet = plan("fleet-100")
    both, alone = (sets.made(fleet, c, 1, 5, 100) for c in ("wear + instrument", "wear"))
    assert both.truth == frozenset.union(*both.each)
    assert [len(own) for own in both.each] == [2, 2]
    assert {name.split()[0] for name in both.truth} == {"coating", "instrument", "wrong"}

    def moved(made: sets.Set, by: str | None = None) -> float:
        own = [r.id for r in made.case.readings if by in (None, r.instrument)]
        return sum(float(made.exact[name][0] - made.sound[name][0]) for name in own)

    (reader,) = {name.split()[-1].rstrip(")") for name in both.each[1]}
    offset = sets.faults(fleet, 1, sets.SIZE)[0]
    assert moved(alone) > 0.5
    assert moved(both) == pytest.approx(moved(alone) + 100 * offset, rel=1e-9)
    assert moved(both, reader) > 100 * offset
    ahead = [np.sort([*one.ahead.values()]) for one in (both, alone)]
    assert ahead[0] == pytest.approx(ahead[1]), "who reads moves no blade"


def test_tables_and_marks_count_every_set() -> None:
    records = [
        {"condition": "gain", "number": 0, "outcome": "right", "alarm": True},
        {"condition": "gain", "number": 1, "outcome": "wrong", "error": "no"},
        {"condition": "wear", "number": 0, "outcome": "in the set", "alarm": True},
        {"condition": "clean", "number": 0, "outcome": "right", "alarm": False},
    ]
    table = study.table(records)
    assert table["gain"] == {
        "sets": 2, "alarms": 0.5, "right": 0.5, "in the set": 0.0, "silent": 0.0, "wrong": 0.5
    }  # fmt: skip
    marks = study.marks(table)
    assert marks["named, right"] == pytest.approx(1 / 3)
    assert marks["named, right or in the set"] == pytest.approx(2 / 3)
    assert marks["clean, alarms"] == 0.0
    assert "outside, no name" not in marks
    two = [
        {"condition": "campaign + gain", "number": n, "outcome": outcome, "alarm": True}
        for n, outcome in enumerate(("right", "one", "one", "wrong"))
    ]
    table = study.table([*records, *two])
    assert table["campaign + gain"]["one"] == 0.5
    marks = study.marks(table)
    told = [marks[f"pairs, {what}"] for what in ("both", "both or one", "wrong")]
    assert told == [0.25, 0.75, 0.25]
    assert marks["named, right"] == pytest.approx(1 / 3), "pairs are no part of it"


def test_improvement_is_over_all_sets_with_an_effect_in_the_model() -> None:
    def scored(rmse: float, bias: float, log_score: float, inside: float) -> dict[str, float]:
        return {
            "exact_rmse": rmse, "exact_bias": bias, "log_score": log_score, "inside_95": inside,
            "forecast_error": 2 * bias,
        }  # fmt: skip

    before = scored(0.04, -0.03, 1.5, 0.9)
    one = {"condition": "wear", "held": 50, "before": before, "after": scored(0.01, 0.003, 2, 0.9)}
    two = one | {"held": 150, "after": scored(0.03, -0.009, 1.4, 0.98)}
    without = {"condition": "wear", "outcome": "silent"}
    found = improvement([one, without, two])["wear"]
    assert found["sets"] == 2
    assert found["rmse"] == pytest.approx(np.sqrt((0.01**2 + 0.03**2) / 2) / 0.04)
    assert found["bias"] == found["forecast"] == pytest.approx(0.2)
    assert found["better"] == 0.5
    assert found["inside 95"] == pytest.approx((50 * 0.9 + 150 * 0.98) / 200)
    assert not {"open", "least rmse"} & set(found)
    sound = {"sound": scored(0.02, 0.0015, 2.1, 0.95)}
    found = improvement([one | sound, without, two | sound])["wear"]
    assert found["least rmse"] == pytest.approx(0.5)
    assert found["least bias"] == found["least forecast"] == pytest.approx(0.05)
    assert "least rmse" not in improvement([one | sound, two])["wear"]  # of all sets or of none
    rivals = {"count": 2, "before": -0.1, "leading": 0.04, "together": -0.01, "z": -0.2}
    torn = one | {"rivals": rivals | {"leading": None}}
    found = improvement([one | {"rivals": rivals}, torn, two])["wear"]
    assert (found["open"], found["sets"]) == (1, 3)
    assert (found["leading"], found["together"]) == pytest.approx((0.4, 0.1))
    assert "known" not in found, "of a claim nothing is chosen"
    seen = {"condition": "wear", "rivals": rivals | {"chosen": 0.02, "missed": 0.15}}
    unseen = {"condition": "wear", "rivals": rivals | {"chosen": None, "missed": 0.3}}
    alone = {"condition": "wear", "rivals": rivals | {"chosen": -0.04, "missed": None}}
    found = improvement([seen, unseen, alone])["wear"]
    assert (found["known"], found["chosen"], found["missed"]) == pytest.approx((2, 0.3, 1.5))
    both = improvement([one, seen])["wear"]
    assert (both["sets"], both["known"]) == (1, 1)


def test_rivals_are_held_against_the_truth_of_the_blades_that_they_differ_in() -> None:
    """Of ten blades two are worn; the leading rival foretells half of what wear adds."""
    case = SimpleNamespace(spec=SimpleNamespace(blades=[f"b{k}" for k in range(10)]))
    ahead = {f"b{k}": 1.5 if k < 2 else 1.0 for k in range(10)}
    Named = namedtuple("Named", ["name", "cause"])
    cell, other = Named("coating wear", "coating loss"), Named("fouling", "gas temperature")
    each = (
        SimpleNamespace(effects=(cell,), share=0.75, mean=1.2, sd=0.1),
        SimpleNamespace(effects=(other,), share=0.25, mean=1.8, sd=0.1),
    )
    others = SimpleNamespace(
        blades=("b0", "b1"), before=(0.9, 0.1), together=(1.35, 0.3), each=each
    )
    told = SimpleNamespace(before=None, rivals=(), effects=[SimpleNamespace(cell=cell)])
    told.verdict = SimpleNamespace(word="effect")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(effect_gains, "alternatives", lambda *given: others)
        given: Any = SimpleNamespace(case=case, ahead=ahead, each=(frozenset({"coating loss"}),))
        found = effect_gains.foretold(cast(Any, told), given, 5e4)
        told.verdict.word = "not separable"
        chosen = effect_gains.foretold(cast(Any, told), given, 5e4)["rivals"]
        given.each = (frozenset({"tip rub"}),)
        none = effect_gains.foretold(cast(Any, told), given, 5e4)["rivals"]
    assert found == {
        "rivals": {"count": 2, "before": -0.4, "leading": -0.2, "together": -0.1, "z": -0.5}
    }
    assert (chosen["chosen"], chosen["missed"]) == (-0.2, 0.2), "by cause"
    assert (none["chosen"], none["missed"]) == (None, 0.2)


def test_a_sound_rotor_is_adequate_and_a_campaign_set_to_zero_anew_is_named() -> None:
    sound, moved = study.run({"clean": 1, "campaign": 1}, seed=12, particles=1000)
    assert (sound["condition"], sound["outcome"]) == ("clean", "right")
    assert (moved["condition"], moved["outcome"]) == ("campaign", "right")
    # the rotor without the fault is what the effect in the model can come to, and about comes to
    errors = [moved[when]["exact_rmse"] for when in ("before", "after", "sound")]
    assert errors[0] > 1.2 * max(errors[1:])
    assert errors[1] == pytest.approx(errors[2], rel=0.15)
    (mean, sd) = next(iter(moved["effects"].values()))
    assert abs(mean - sets.OFFSET) < 3 * sd
    with pytest.raises(InputError, match="unknown"):
        study.run({"wind": 1}, seed=1, particles=100)


def test_effects_as_they_were_run_have_no_size() -> None:
    assert TWENTY.strength(0, "step", None) == 1.0
    with pytest.raises(InputError, match="rotor-20"):
        TWENTY.strength(0, "step", 2.0)
    with pytest.raises(InputError, match="fleet-7"):
        plan("fleet-7")


def test_where_every_visit_has_a_scanner_of_its_own_no_single_name_is_right() -> None:
    three = replace(
        TWENTY, visits_h=TWENTY.visits_h[:3], elongation=TWENTY.elongation[:, :, :3],
        odd_visits=(1, 2),
    )  # fmt: skip
    made = sets.made(three, "one scanner a visit", 0, 5, 100)
    both = {(r.campaign, r.instrument) for r in made.case.readings}
    assert len(both) == 3
    name = next(n for n in made.truth if n.startswith("instrument offset"))
    assert any(name == f"instrument offset (instrument {who})" for _, who in both)
    alone, pair = said("effect", name), said("not separable", name, "campaign offset (campaign x)")
    other = said("not separable", "a", "b")
    outcomes = [study.judged("one scanner a visit", made.truth, v) for v in (alone, pair, other)]
    assert outcomes == ["wrong", "right", "wrong"]


def test_a_size_is_the_change_at_the_last_visit_in_noises() -> None:
    scaled = replace(TWENTY, scaled=True)
    for rotor in ROTORS:
        for size in (0.5, 2.0):
            change = scaled.changed(rotor, "step", size) - TWENTY.elongation[rotor]
            assert np.mean(change[:, -1]) == pytest.approx(size * NOISE, rel=1e-9)
        offset, gain, odd = sets.faults(scaled, rotor, 3.0)
        assert (offset, odd) == pytest.approx((0.06, 0.06))
        assert np.mean(gain * scaled.elongation[rotor, :, -1]) == pytest.approx(0.06)
    with pytest.raises(InputError, match="would need"):
        scaled.with_effect("tertiary", 500.0)


def test_a_fleet_reads_blades_of_five_ages_at_three_visits_and_is_forecast_beyond_them() -> None:
    fleet = plan("fleet-100")
    assert (fleet.rotors, fleet.blades, fleet.own_h.shape) == (2, 100, (100, 3))
    assert np.all(np.isfinite(fleet.elongation))
    assert np.all(np.diff(fleet.elongation, axis=2) > 0)
    assert len({*fleet.own_h[:, 0]}) == 5
    assert fleet.own_h.max() < fleet.horizon_h
    for rotor in range(fleet.rotors):
        ahead = fleet.ahead(rotor, None)
        assert ahead is not None
        assert np.all(ahead > fleet.elongation[rotor, :, -1])


def test_a_fleet_of_one_age_is_as_old_as_its_rotor() -> None:
    fleet = plan("fleet-one-age")
    assert np.all(fleet.own_h == fleet.visits_h)
    assert np.all(np.diff(fleet.elongation, axis=2) > 0)
    ahead = fleet.ahead(0, None)
    assert ahead is not None
    assert np.all(ahead > fleet.elongation[0, :, -1])
    assert set(sets.conditions(fleet)) == set(sets.CONDITIONS)


def test_six_visits_are_over_the_hours_of_three() -> None:
    three, six = plan("fleet-100"), plan("fleet-six-visits")
    assert six.own_h.shape == (100, 6)
    assert np.array_equal(six.own_h[:, [0, -1]], three.own_h[:, [0, -1]])
    assert np.all(np.diff(six.elongation, axis=2) > 0)
    given = sets.made(six, "campaign", 0, 3, 100)
    assert len(given.case.readings) == 600
    (name,) = given.truth
    late = {r.time_h for r in given.case.readings if f"campaign {r.campaign})" in name}
    assert late == {36e3, 31e3, 26e3, 21e3, 16e3}  # the fourth visit
    assert set(sets.CONDITIONS) - set(sets.conditions(six)) == {"one scanner a visit"}


@pytest.mark.parametrize(
    ("of", "effect"), [(FIVE_AGES, "step"), (ONE_AGE, "tertiary"), (SIX_VISITS, "pulse")]
)
def test_what_ships_of_a_fleet_is_what_the_finite_elements_say(of: Fleet, effect: str) -> None:
    blade = 57
    with np.load(of.shipped, allow_pickle=False) as data:
        assert np.array_equal(data["inputs"], of.design())
        kept = data["share"][effect_fleet.EFFECTS.index(effect), 0, blade]
    anew, sound = (effect_fleet.run(of, 0, blade, what) for what in (effect, "sound"))
    assert kept == pytest.approx(anew / sound, abs=1e-6)
    assert np.all(kept[-2:] > 1.0)


@pytest.mark.parametrize("effect", ["wear", "worn lot", "fouling", "step", "tertiary", "pulse"])
@pytest.mark.parametrize("name", ["fleet-100", "fleet-one-age", "fleet-six-visits"])
def test_a_fleets_effects_have_their_size(name: str, effect: str) -> None:
    fleet = plan(name)
    for rotor, size in ((0, 2.0), (fleet.rotors - 1, 0.5)):
        change = fleet.changed(rotor, effect, size) - fleet.elongation[rotor]
        concerned = fleet.coat == 0 if effect == "worn lot" else np.ones(100, bool)
        assert np.all(change[~concerned] == 0.0)
        assert np.mean(change[concerned, -1]) == pytest.approx(size * NOISE, rel=1e-9)
        assert np.all(change[concerned, -1] > 0)
    before = fleet.changed(0, "step") - fleet.elongation[0]
    assert np.all(before[:, 0] == 0.0)  # the step is after the first visit


def test_faults_of_a_fleet_have_its_size_too() -> None:
    fleet = plan("fleet-100")
    for rotor in range(2):
        offset, gain, odd = sets.faults(fleet, rotor, 3.0)
        assert (offset, odd) == pytest.approx((0.06, 0.06))
        assert np.mean(gain * fleet.elongation[rotor, :, -1]) == pytest.approx(0.06)


def test_a_set_without_what_is_planted_has_the_same_noise() -> None:
    fleet = plan("fleet-100")
    planted, clean = (sets.made(fleet, what, 1, 5, 10) for what in ("wear", "clean"))
    by_id = {r.id: r for r in planted.without}
    assert [r.id for r in planted.without] == [r.id for r in planted.case.readings]
    for r in planted.case.readings:
        noise = r.values - planted.exact[r.id]
        assert by_id[r.id].values == pytest.approx(planted.sound[r.id] + noise, abs=1e-12)
    more = [r.values - by_id[r.id].values for r in planted.case.readings]
    assert np.min(more) > 0  # a worn blade is longer
    assert planted.sound_ahead.keys() == planted.ahead.keys()
    assert all(planted.ahead[b] > own for b, own in planted.sound_ahead.items())
    assert all(np.all(r.values == one.values)
               for r, one in zip(clean.case.readings, clean.without, strict=True))  # fmt: skip
    assert clean.sound_ahead == clean.ahead


def test_conditions_are_those_with_a_truth() -> None:
    assert "fouling" in sets.conditions(plan("fleet-100"))
    assert not {"wear", "fouling"} & set(sets.conditions(TWENTY))
    assert set(sets.conditions(plan("fleet-100"))) == set(sets.CONDITIONS)
    assert sets.pairs(plan("fleet-100")) == sets.PAIRS
    assert "wear + instrument" not in sets.pairs(TWENTY)
    assert "worn lot + campaign" in sets.pairs(TWENTY)
    with pytest.raises(InputError, match="unknown"):
        study.run({"fouling": 1}, seed=1, particles=100)
