"""Readings that scatter more than is stated of them: told, and not taken for exchanges."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import jsonschema_rs
import numpy as np
import pytest
from scipy.stats import chi2

from core.calibration import noisier as module
from core.calibration.cavity import Seen
from core.calibration.doubted import doubted
from core.calibration.looked import Looked
from core.calibration.noisier import CHANCE, kind, scatter
from core.calibration.online import update
from core.calibration.start import Start
from core.calibration.state import RotorSpec, RotorState
from core.observation import Inspection
from service.api.answers.beliefs import HEALTH
from tests.core.calibration.test_exchanged import MODEL, NOISE, rotor, turned

BLADES = 12
SPEC = RotorSpec("r", tuple(f"b{k}" for k in range(BLADES)), particles=300, seed=4)
SEEDS, TIMES = range(4), 3.0


def told(readings: list[Inspection], times: float = 1.0) -> RotorState:
    """The state of readings whose noise is stated this many times too small."""
    stated = [replace(r, sigma=NOISE / times) for r in readings]
    state = update(MODEL, SPEC, stated)
    jsonschema_rs.validate(HEALTH, state.meta["health"] | {"trusted": False})
    return state


def test_a_noise_that_is_stated_too_small_is_told_and_no_exchange_is() -> None:
    """Of each rotor: s is what it was stated too small by, and its status is `contradicted`."""
    found = []
    for seed in SEEDS:
        health = told(rotor(seed, BLADES), TIMES).meta["health"]
        (one,) = health["noisier"]
        visits = 4 * (BLADES - len(health["contradicted"]))
        assert (one["quantities"], one["stated"], one["visits"]) == (["y"], True, visits)
        assert "exchanged" not in health
        assert health["status"] == "contradicted"
        assert "sigma is stated too small" in " ".join(health["reasons"])
        found.append(one["times"])
    assert np.exp(np.mean(np.log(found))) == pytest.approx(TIMES, rel=0.2), found


def test_without_that_blades_are_called_exchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    """The negative control: what the evidence says of noise that is believed."""
    monkeypatch.setattr(module, "FACTOR", np.inf)
    health = [told(rotor(seed, BLADES), TIMES).meta["health"] for seed in SEEDS]
    assert sum("exchanged" in one for one in health) >= 2


def test_of_sound_rotors_nothing_is_told_and_of_an_exchange_that_alone() -> None:
    for seed in SEEDS:
        sound = rotor(seed, BLADES)
        assert "noisier" not in told(sound).meta["health"]
        health = told(turned(sound, 2)).meta["health"]
        assert "noisier" not in health
        assert [one["blades"] for one in health.get("exchanged", [])] in ([], [["b1", "b4"]])


def test_a_state_to_compare_with_others_and_a_provisional_one_say_it_too() -> None:
    given = [replace(r, sigma=NOISE / TIMES) for r in rotor(1, BLADES)]
    state = update(MODEL, SPEC, given)
    before = state.meta["health"]["noisier"]
    start = Start.of(MODEL, state)
    for one in (start, start.wider(2.0), start.between(start)):
        assert update(MODEL, SPEC, given, start=one).meta["health"]["noisier"] == before
    more = replace(given[0], id="new", time_h=2.6)
    quick = update(MODEL, SPEC, [*given, more], state, quick=True)
    assert not quick.meta["sealed"]
    assert quick.meta["health"]["noisier"] == before


def seen(value: np.ndarray, quantity: str = "y", sigma: float | None = 1.0) -> Seen:
    """A visit of N(0, 1) coordinates, as it is foreseen."""
    one = Inspection("r", "b", quantity, 1.0, np.array([value[0]]), sigma=sigma)
    return Seen((one,), (), value, np.zeros(len(value)), np.eye(len(value)), True)


@pytest.mark.parametrize("size", [1, 12])
def test_s_is_the_factor_and_sound_ones_are_told_as_seldom_as_is_said(size: int) -> None:
    """Exact: visits that are independent, of any number of coordinates."""
    rng = np.random.default_rng(20_261_201)
    alarms = 0
    for _ in range(400):
        z = rng.standard_normal((20, 2, size))
        looks = {f"b{b}": {("", t): seen(z[b, t]) for t in range(2)} for b in range(20)}
        alarms += scatter(looks, ()).variance([kind(looks["b0"]["", 0])]) > 1.0
    assert alarms == 0, f"{400 * CHANCE:g} expected at most"
    z = 3.0 * rng.standard_normal((400, 2, size))
    looks = {f"b{b}": {("", t): seen(z[b, t]) for t in range(2)} for b in range(400)}
    (told,) = scatter(looks, ()).told(())
    assert told["times"] == pytest.approx(3.0, rel=0.1)
    few = {b: looks[b] for b in ("b0", "b1")}
    assert bool(scatter(few, ()).told(())) == (size > 1), "four numbers tell nothing"


def test_kinds_are_told_apart_and_accused_blades_left_out() -> None:
    one, far = np.ones(1), np.full(1, 4.0)
    looks = {
        f"b{b}": {("", t): seen(far if q == "y" else one, q) for t, q in enumerate(("y", "z", "y"))}
        for b in range(30)
    }
    found = scatter(looks, ())
    assert [row["quantities"] for row in found.told(())] == [["y"]]
    s2 = pytest.approx(16.0 / chi2.ppf(0.75, 1))
    y, z = (kind(seen(one, q)) for q in ("y", "z"))
    assert (found.variance([y]), found.variance([z])) == (s2, 1.0)
    assert found.variance([z, y]) == s2, "the larger one"
    assert found.variance([kind(seen(one, sigma=None))]) == 1.0, "another noise, another kind"
    assert found.told(looks) == scatter(looks, looks).told(()) == []


def test_what_one_blade_makes_or_a_pair_of_which_something_else_is_told_is_not_told() -> None:
    """A wrong reading puts off all visits of its blade, for others foresee them from it."""
    near, far = np.full(1, 0.5), np.full(1, 6.0)

    def looks(off: int) -> dict[str, dict[tuple[str, float], Seen]]:
        return {
            f"b{b}": {("", t): seen(far if b < off else near) for t in range(4)} for b in range(6)
        }

    one, two = scatter(looks(1), ()), scatter(looks(2), ())
    which = [kind(seen(near))]
    assert one.variance(which) > 1.0, "the control"
    assert one.variance(which, ["b0"]) == 1.0
    assert one.told(()) == []
    assert [row["visits"] for row in two.told(())] == [24], "the control"
    assert two.variance(which, ["b0", "b1"]) == 1.0
    assert two.told(["b0", "b1"]) == []


def test_a_blade_is_doubted_by_what_the_others_scatter() -> None:
    """Held against its own visits a wrong reading would excuse itself."""
    near, far = np.full(1, 0.5), np.full(1, 9.0)
    looks = {f"b{b}": {("", t): seen(far if b == 0 else near) for t in range(4)} for b in range(6)}
    rows = SimpleNamespace(of=[0, 1, 2, 3], y=np.zeros(4))
    messages = cast(Any, dict.fromkeys(looks, SimpleNamespace(rows=rows)))
    assert doubted(messages, Looked(looks, scatter(looks, ()), []), 10.0) == [("b0",)]
    wide = {b: {v: seen(1.5 * far) for v in own} for b, own in looks.items()}
    assert doubted(messages, Looked(wide, scatter(wide, ()), []), 10.0) == [], "as all others"
    assert len(doubted(messages, Looked(wide, scatter({}, ()), []), 10.0)) == 6, "the control"
