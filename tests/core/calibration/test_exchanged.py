"""Two blades' readings of a visit, the other way round: told by the evidence, and only then."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace
from typing import Any

import jsonschema_rs
import numpy as np
import pytest

from core.calibration import exchanged as module
from core.calibration.cavity import seen_of
from core.calibration.exchanged import (
    ODDS,
    VISIT,
    Exchange,
    _weighed,
    in_words,
    least_gain,
    other_way_round,
)
from core.calibration.noisier import Scatter
from core.calibration.online import Workspace, begun, update
from core.calibration.start import Start
from core.calibration.state import RotorSpec, RotorState
from core.calibration.step import Step
from core.observation import Inspection
from core.smc.particles import log_sum_exp
from service.api.answers.beliefs import HEALTH
from tests.core.calibration.linear import SHARED, exact_column, linear, slopes

MANY, NOISE = 2, 0.15
MODEL = linear(MANY)
HOURS = (0.3, 0.9, 1.6, 2.2)
BLADES = tuple(f"b{k}" for k in range(6))
SPEC = RotorSpec("r", BLADES, particles=1200, seed=4)


def rotor(seed: int, blades: int = len(BLADES)) -> list[Inspection]:
    """y = 0.8 s + Σ c_j(t) l_j + noise at four hours of each blade."""
    rng = np.random.default_rng([20_261_129, seed])
    found = []
    for b in range(blades):
        own = -1.0 + 0.5 * np.arange(MANY) + 0.6 * rng.standard_normal(MANY)
        for k, t in enumerate(HOURS):
            value = SHARED * 2.1 + own @ slopes(t, MANY) + NOISE * rng.standard_normal()
            name = f"b{b}v{k}"
            found.append(Inspection(name, f"b{b}", "y", t, np.array([value]), sigma=NOISE))
    return found


def turned(readings: list[Inspection], visit: int, one: int = 1, two: int = 4) -> list[Inspection]:
    """With the readings of two blades at a visit exchanged."""
    values = {r.id: r.values for r in readings}
    other = {f"b{one}v{visit}": f"b{two}v{visit}", f"b{two}v{visit}": f"b{one}v{visit}"}
    return [replace(r, values=values[other.get(r.id, r.id)]) for r in readings]


def told(readings: list[Inspection], spec: RotorSpec = SPEC) -> RotorState:
    return update(MODEL, spec, readings)


def evidence(readings: list[Inspection]) -> float:
    """Of the whole rotor in closed form, the shared parameter by a dense grid."""
    s = np.linspace(0.0, 4.0, 8001)
    total = -0.5 * ((s - 2.0) / 0.5) ** 2
    for blade in sorted({r.blade for r in readings}):
        own = [r for r in readings if r.blade == blade]
        total = total + exact_column(sorted(own, key=lambda r: r.time_h), s, MANY)
    return float(log_sum_exp(total))


def test_the_gain_is_the_evidence_of_the_exchanged_readings_over_that_of_the_given_ones() -> None:
    given = turned(rotor(1), 2)
    step = begun(MODEL, SPEC, given)
    for visit, pair in ((2, ("b1", "b4")), (2, ("b0", "b5")), (0, ("b1", "b4"))):
        one = Exchange(0.0, ("", HOURS[visit]), pair)
        got = _weighed(one, step.messages, step.weighed, messages_of(step)).gain
        exact = evidence(turned(given, visit, int(pair[0][1]), int(pair[1][1]))) - evidence(given)
        assert got == pytest.approx(exact, abs=0.05 + 0.01 * abs(exact)), pair


def messages_of(step: Step) -> module.Messages:
    def made(readings):  # type: ignore[no-untyped-def]
        rows = {b: step.work.rows_of(step.model, own) for b, own in readings.items()}
        return step.work.messages_of(step.model, rows, step.space, {})

    return made


def test_what_others_foresee_of_a_visit_is_their_normal_distribution() -> None:
    """Linear rows, normal priors: the cavity is exact, by one fit and by one without the visit."""
    given = rotor(2, 1)
    step = begun(MODEL, RotorSpec("r", ("b0",), 1200, 4), given)
    at = np.array([[0.4]])
    s = float(step.space.to_x(at)[0, 0])
    c = np.array([slopes(t, MANY) for t in HOURS])
    prior = SHARED * s + c @ (-1.0 + 0.5 * np.arange(MANY))
    cov = 0.36 * c @ c.T + NOISE**2 * np.eye(len(HOURS))
    y = np.array([r.values[0] for r in given])
    for far in (0.0, 40.0):
        moved = [replace(r, values=r.values + far * NOISE * (r.id == "b0v2")) for r in given]
        step = begun(MODEL, RotorSpec("r", ("b0",), 1200, 4), moved)
        seen = seen_of(step.messages["b0"], at)[("", HOURS[2])]
        rest = [0, 1, 3]
        gain = cov[2, rest] @ np.linalg.inv(cov[np.ix_(rest, rest)])
        assert seen.mean[0] == pytest.approx(prior[2] + gain @ (y - prior)[rest], abs=2e-3 * NOISE)
        sd = np.sqrt(cov[2, 2] - gain @ cov[rest, 2])
        assert seen.precision[0, 0] == pytest.approx(sd**-2, rel=1e-3)
        assert seen.value[0] == pytest.approx(y[2] + far * NOISE, abs=1e-12)


def test_an_exchange_is_named_and_a_correction_ends_it() -> None:
    sound = rotor(9)
    given = turned(sound, 2)
    state = told(given)
    health = state.meta["health"]
    assert health["status"] == "contradicted"
    assert health["contradicted"] == [], "each blade by itself is within the noise"
    (one,) = health["exchanged"]
    assert one["blades"] == ["b1", "b4"]
    assert one["readings"] == [["b1v2"], ["b4v2"]]
    assert one["time_h"] == [1.6, 1.6]
    assert one["campaign"] is None
    assert one["gained_nat"] == pytest.approx(evidence(sound) - evidence(given), abs=0.3)
    assert one["probability"] > 0.9
    assert "blades b1 and b4 at 2 h look exchanged" in health["reasons"][0]
    assert "look at b1v2, b4v2" in health["reasons"][0]
    jsonschema_rs.validate(HEALTH, health | {"trusted": False})  # as the API's document says
    assert told(given[::-1]).digest == state.digest, "in any order"
    assert update(MODEL, SPEC, given, told(sound), workspace=Workspace()).digest == state.digest
    mended = update(MODEL, SPEC, turned(given, 2), state)
    assert mended.meta["health"]["status"] == "ok"
    assert "exchanged" not in mended.meta["health"]
    assert mended.digest == told(sound).digest


def test_both_off_by_as_much_and_not_each_others_is_no_exchange() -> None:
    """The control: readings half way to each other's are as far off together, and stay so."""
    sound = rotor(9)
    values = {r.id: r.values for r in sound}
    half = 0.5 * (values["b1v2"] + values["b4v2"])
    given = [replace(r, values=half) if r.id in ("b1v2", "b4v2") else r for r in sound]
    assert "exchanged" not in told(given).meta["health"]


def test_sound_rotors_are_told_nothing_and_exchanged_ones_where_the_evidence_says_so() -> None:
    """One in VISIT / ODDS of a visit at most, by Markov's inequality: 0.1 of 24 rotors."""
    limit, missed = least_gain(15), 0
    for seed in range(100, 124):
        sound = rotor(seed)
        assert begun(MODEL, SPEC, sound).exchanged() == []
        given = turned(sound, 2)
        exact = evidence(sound) - evidence(given)
        if abs(exact - limit) < 0.5:
            continue
        found = [one["blades"] for one in begun(MODEL, SPEC, given).exchanged()]
        assert found == ([["b1", "b4"]] if exact > limit else []), (seed, exact)
        missed += exact < limit
    assert 4 * 24 * VISIT / ODDS < 0.11
    assert 6 <= missed <= 18, "blades that are alike cannot be told apart, others are"


def test_of_two_visits_nothing_tells_at_which_it_was() -> None:
    """Blades that were read twice are each other's with either visit exchanged: both are told."""
    given = [
        Inspection(f"{b}v{k}", b, "y", t, np.array([1.7 + level * (-1) ** k]), sigma=NOISE)
        for b, level in (("b0", 0.0), ("b1", 1.2), ("b2", 0.1), ("b4", -1.2))
        for k, t in enumerate(HOURS[:2])
    ]
    state = update(linear(1), SPEC, [r for r in given if r.blade != "b2"])
    (one,) = state.meta["health"]["exchanged"]
    assert one["blades"] == one["rivals"][0]["blades"] == ["b1", "b4"]
    assert {one["time_h"][0], one["rivals"][0]["time_h"][0]} == {*HOURS[:2]}
    (words,) = (why for why in state.meta["health"]["reasons"] if "exchanged" in why)
    assert "nat (or b1 and b4 at " in words


def test_several_pairs_of_a_visit_are_told() -> None:
    given = turned(turned(rotor(9), 2), 2, 0, 2)
    pairs = [one["blades"] for one in told(given).meta["health"].get("exchanged", [])]
    assert sorted(pairs) == [["b0", "b2"], ["b1", "b4"]]


def test_visits_that_are_not_alike_are_not_compared() -> None:
    """By campaign, else by the hour; blades read once at all can be exchanged with any."""
    given = turned(rotor(9), 2)
    apart = [replace(r, time_h=1.61) if r.id == "b4v2" else r for r in given]
    hours = [one["time_h"] for one in told(apart).meta["health"].get("exchanged", [])]
    assert not any({1.6, 1.61} & {*pair} for pair in hours)
    one = [replace(r, campaign="C2") if r.id in ("b1v2", "b4v2") else r for r in apart]
    (found,) = told(one).meta["health"]["exchanged"]
    assert (found["campaign"], found["time_h"]) == ("C2", [1.6, 1.61])
    assert "in campaign C2 (2 h)" in in_words(found)
    once = [r for r in given if r.id.endswith("v2")]
    assert "exchanged" not in told(once).meta["health"]


def test_what_a_reading_says_goes_with_it_and_what_it_is_of_stays() -> None:
    given = [replace(r, campaign="C") for r in rotor(9, 2) if r.id.endswith("v2")]
    given[1] = replace(given[1], sigma=0.2, time_h=1.7)
    step = begun(MODEL, SPEC, given)
    got = other_way_round(step.messages["b0"], step.messages["b1"], ("C", 0.0))
    (a,), (b,) = got["b0"], got["b1"]
    assert (a.id, a.blade, a.time_h, a.sigma) == ("b0v2", "b0", 1.6, 0.2)
    assert (b.id, b.blade, b.time_h, b.sigma) == ("b1v2", "b1", 1.7, NOISE)
    assert (a.values, b.values) == (given[1].values, given[0].values)


def test_a_provisional_state_says_it_of_blades_that_were_not_read_since() -> None:
    given = turned(rotor(9), 2)
    state = told(given)
    more = Inspection("b0v9", "b0", "y", 2.6, np.array([1.0]), sigma=0.5)
    quick = update(MODEL, SPEC, [*given, more], state, quick=True)
    assert not quick.sealed
    assert quick.meta["health"]["exchanged"] == state.meta["health"]["exchanged"]
    touched = replace(more, id="b4v9", blade="b4")
    again = update(MODEL, SPEC, [*given, touched], state, quick=True)
    assert not again.sealed
    assert "exchanged" not in again.meta["health"]
    assert update(MODEL, SPEC, [*given, touched], again).meta["health"]["exchanged"]


def test_looks_are_kept_for_blades_that_were_not_read_since(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looked: list[str] = []
    monkeypatch.setattr(
        module,
        "seen_of",
        lambda message, at: (
            looked.append(message.rows.readings[0].blade) or seen_of(message, at)  # type: ignore[func-returns-value]
        ),
    )
    given, work = turned(rotor(9), 2), Workspace()
    first = begun(MODEL, SPEC, given, workspace=work).exchanged()
    assert looked == list(BLADES)
    more = Inspection("b0v9", "b0", "y", 2.6, np.array([1.0]), sigma=5.0)
    again = begun(MODEL, SPEC, [*given, more], workspace=work).exchanged()
    assert looked[len(BLADES) :] == ["b0"]
    assert again[0]["blades"] == first[0]["blades"]


def test_a_state_to_compare_with_others_says_it_too() -> None:
    """A diagnosis tells of it whatever effect its model has."""
    given = turned(rotor(9), 2)
    state = told(given)
    start = Start.of(MODEL, state)
    for one in (start, start.wider(2.0), start.between(start)):
        other = update(MODEL, SPEC, given, start=one)
        assert other.meta["health"]["exchanged"] == state.meta["health"]["exchanged"]


def test_pairs_are_weighed_once_where_the_nodes_stay_what_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """First for doubts about the nodes, then for the state."""
    seen: list[Exchange] = []

    def weighing(one: Exchange, *given: Any) -> Exchange:
        seen.append(one)
        return _weighed(one, *given)

    monkeypatch.setattr(module, "_weighed", weighing)
    assert told(turned(rotor(0), 1)).meta["health"]["exchanged"]
    assert len(seen) == len({(one.visit, one.pair) for one in seen}) > 0


def test_more_pairs_ask_for_more() -> None:
    assert least_gain(100) - least_gain(10) == pytest.approx(np.log(10.0))


def test_what_a_look_misses_by_chance_is_weighed_where_blades_are_accused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = turned(rotor(9), 2)
    step = begun(MODEL, SPEC, given)
    monkeypatch.setattr(module, "ROUGH", -1e9)
    assert step.exchanged() == []
    weighed = step.weighed
    looked = module.looks(step.messages, weighed, OrderedDict())
    bad = ["b1", "b4"]
    given_of = messages_of(step)
    found = module.exchanged(step.messages, weighed, bad, given_of, looked, Scatter({}))
    assert [one["blades"] for one in found] == [["b1", "b4"]]
