"""Where an effect's change of a reading is looked up: at its own nodes, else at the network's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from core.calibration.online import RotorSpec, update
from core.diagnosis import Facts, following
from core.diagnosis.adopt import with_effects
from core.diagnosis.families import FAMILIES
from core.diagnosis.following import change
from core.diagnosis.grammar import Cell
from core.diagnosis.moving import Moving, Physics
from core.diagnosis.scoring import POINTS, scores
from core.errors import RangeError
from core.model import Model, rotor_blade, rotor_blade_wide
from core.network import Network
from core.observation import Inspection
from core.surrogate import history
from core.surrogate.driven import Driven
from core.surrogate.histories import follow_each
from core.validation.fe_rotors import scan_nodes
from core.validation.simulate import scan

MODEL = rotor_blade()
NAMED = MODEL.surrogate.named
FAMILY = {f.name: f for f in FAMILIES}


def physics(node: str | None) -> Physics:
    """With this node for the CEEQ of the network."""
    network = MODEL.network
    quantities = tuple(replace(q, node=node) if q.name == "ceeq" else q for q in network.quantities)
    return Physics.of(replace(network, quantities=quantities), MODEL.surrogate, {})


@pytest.mark.parametrize(
    ("node", "name"), [("tip", "tip"), ("critical", "critical"), (None, "critical")]
)
def test_a_reading_without_a_node_is_at_the_one_that_the_network_names(
    node: str | None, name: str
) -> None:
    bare = Inspection("i", "b", "ceeq", 8000.0, np.array([0.01]))
    assert physics(node).asked(bare) == ("ceeq", [NAMED[name]])
    assert NAMED["tip"] != NAMED["critical"]


def test_a_node_of_its_own_counts_first_and_a_scalar_has_none() -> None:
    own = Inspection("i", "b", "ceeq", 8000.0, np.array([0.01]), nodes=np.array([3]))
    assert physics("tip").asked(own) == ("ceeq", [3])
    length = Inspection("i", "b", "elongation", 8000.0, np.array([0.1]))
    assert physics("tip").asked(length) == ("elongation", None)


def test_an_effect_that_some_blades_have_already_is_in_what_another_one_adds_to_them() -> None:
    """Of a coating that wears in one blade alone: there as if it wore in all, elsewhere in none."""
    blades = ("B1", "B2")
    wear = Cell(FAMILY["coating wear"], "linear", "blade", "B1")
    facts = {b: Facts() for b in blades}
    lot = with_effects(rotor_blade_wide(), [wear], facts, {"elongation": 0.02})
    (drift,) = lot.network.drifts
    everyone = replace(lot.network, drifts=(replace(drift, blades=None),))
    model = Model.of(everyone, lot.surrogate)
    data = [
        Inspection(f"{b}-{t}", b, "elongation", t, np.array([0.3 + 1e-6 * t]), sigma=0.02)
        for b in blades
        for t in (7e3, 21e3)
    ]
    seen = scores(model, update(model, RotorSpec("r", blades, 100, 1), data), data)
    assert isinstance(model.surrogate, Driven)
    rest = dict(model.surrogate.fixed)
    fouling = Moving(
        "t1t_rate", "times", 0.01, Cell(FAMILY["fouling"], "linear", "all").course, False
    )

    def added(network: Network) -> np.ndarray:
        own = Physics.of(network, model.surrogate, rest)
        return change(own, seen, facts, fouling, {})

    some, every = added(lot.network), added(everyone)
    none = added(replace(everyone, drifts=()))
    assert np.allclose(some[0], every[0], rtol=1e-12)
    assert np.allclose(some[1], none[1], rtol=1e-9)
    assert not np.allclose(every[0], none[0], rtol=1e-3), "negative control"


def test_scans_move_as_the_runs_say_whoever_was_scanned_where_and_when() -> None:
    """A hotter gas from the start: each scan's rows change as runs at that gas are, to the
    polynomials' error; blades scanned alike are followed at once, and one that is not by itself."""
    hours, few, many = (7e3, 21e3), scan_nodes(4), scan_nodes(7)
    plan = {"B1": (few, few), "B2": (few, few), "B3": (many, many), "B4": (many, few)}
    x, rng = np.array([1.0, 0.9, 0.0, 0.0]), np.random.default_rng(1)
    noise = {"sigma_obs.deformation": 0.03}
    data = []
    for blade, nodes in plan.items():
        for hour, at in zip(hours, nodes, strict=True):
            values = scan(MODEL, x, hour, at, noise, rng)
            data.append(Inspection(f"{blade}-{hour}", blade, "deformation", hour, values, at))
            length = Inspection(f"{blade}+{hour}", blade, "elongation", hour, np.array([0.2]))
            data.append(length)
    seen = scores(MODEL, update(MODEL, RotorSpec("r", tuple(plan), 100, 1), data), data)
    always = Cell(FAMILY["cooling flow"], "constant", "all").course
    gas = Moving("t1t_rate", "plus", 0.01, always, False)
    own = Physics.of(MODEL.network, MODEL.surrogate, {})
    found = change(own, seen, {b: Facts() for b in plan}, gas, {})
    names = [i.name for i in MODEL.surrogate.inputs]
    turned = 0
    for b, rows in enumerate(seen.rows):
        points = np.stack([seen.points[b][n] for n in names], axis=1)
        hotter = points + 0.01 * (np.array(names) == "t1t_rate")
        for place, mixing in rows.mixings.items():
            made = MODEL.surrogate.mode_response(rows.readings[place].time_h, mixing.modes)
            modes = made.evaluate(hotter)[0] - made.evaluate(points)[0]
            got = found[b][:, seen.place[b] == place]
            size = np.abs(modes).max()
            assert got == pytest.approx(modes @ mixing.turn.T, abs=0.02 * size)
            assert not np.allclose(got, modes, atol=0.05 * size), "rows are turned"
            turned += 1
    assert turned == 8


def test_a_node_that_the_changed_inputs_would_reach_late_is_looked_at_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A cold node of a blade whose gas gets far colder: its creep all but stops; the mutant asks
    when it would have crept so far, and there is no answer."""
    node, hours = int(scan_nodes(5)[0]), (20e3, 30e3)
    data = [
        Inspection(f"{h}", "B1", "ceeq", h, np.array([y]), np.array([node]))
        for h, y in zip(hours, (6e-4, 6.1e-4), strict=True)
    ]
    seen = scores(MODEL, update(MODEL, RotorSpec("r", ("B1",), 100, 1), data), data)
    step = Cell(FAMILY["firing temperature step"], "step", "all", None, 21e3).course
    colder = Moving("t1t_rate", "plus", -0.19, step, False)
    own, facts = Physics.of(MODEL.network, MODEL.surrogate, {}), {"B1": Facts()}
    found = change(own, seen, facts, colder, {})[0]
    assert np.all(found[:, 0] == 0.0), "before the step"
    assert np.all(np.isfinite(found))
    assert np.abs(found).max() < 1.2e-4, "a fifth of what there is"
    monkeypatch.setattr(following, "follow_each", lambda *a, late: follow_each(*a))
    with pytest.raises(RangeError, match="longer runs"):
        change(own, seen, facts, colder, {})


@pytest.mark.parametrize("count", [4, 12])
def test_blades_that_are_read_at_hours_of_their_own_cost_no_more_than_alike(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two readings each, an effect that grows by the rotor's hours: what the process is asked goes
    with the blades. (Between the hours of all of them it went with their square.)"""
    blades = tuple(f"B{b:02d}" for b in range(count))
    wear = Moving(
        "tbc_thickness", "times", -0.2, Cell(FAMILY["fouling"], "linear", "all").course, True
    )
    asked, known = [], history.Walk.known

    def counted(self: Any, x: np.ndarray) -> Any:
        asked.append(len(x))
        return known(self, x)

    monkeypatch.setattr(history.Walk, "known", counted)
    cost = []
    for apart in (0.0, 37.0):
        data = [
            Inspection(f"{b}-{t}", name, "elongation", t + apart * b, np.array([0.02 + 1e-5 * t]))
            for b, name in enumerate(blades)
            for t in (7e3, 21e3)
        ]
        facts = {name: Facts(offset_h=3 * apart * b) for b, name in enumerate(blades)}
        seen = scores(MODEL, update(MODEL, RotorSpec("r", blades, 100, 1), data), data)
        asked.clear()
        change(Physics.of(MODEL.network, MODEL.surrogate, {}), seen, facts, wear, {})
        cost.append(sum(asked))
    alike, other = cost
    assert alike == other
    between = sum(0 < hour < 21e3 for hour in wear.course.cuts(following.PARTS))
    assert alike == count * POINTS * (between + 2 + 2), "two readings with the wear and without"


def test_at_hour_0_nothing_has_moved_whatever_else_was_read() -> None:
    """One blade read at hour 0 and later, lengths and strain, and one read at hour 0 alone."""
    read = (("A", "elongation", 0.0, 0.001), ("A", "elongation", 8e3, 0.1))
    read += (("B", "elongation", 0.0, 0.001), ("A", "ceeq", 8e3, 0.001))
    data = [Inspection(f"{i}", b, q, h, np.array([y])) for i, (b, q, h, y) in enumerate(read)]
    seen = scores(MODEL, update(MODEL, RotorSpec("r", ("A", "B"), 100, 1), data), data)
    gas = Moving("t1t_rate", "times", 0.01, Cell(FAMILY["fouling"], "linear", "all").course, True)
    facts = {"A": Facts(), "B": Facts(offset_h=100.0)}
    found = change(Physics.of(MODEL.network, MODEL.surrogate, {}), seen, facts, gas, {})
    hours = np.where(seen.real, seen.hours, np.nan)
    assert np.all(found[np.repeat(hours[:, None] == 0, found.shape[1], axis=1)] == 0.0)
    assert np.all(found[np.repeat(hours[:, None] > 0, found.shape[1], axis=1)] > 0.0)
