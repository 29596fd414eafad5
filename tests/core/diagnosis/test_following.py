"""Where an effect's change of a reading is looked up: at its own nodes, else at the network's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.online import RotorSpec, update
from core.diagnosis import Facts
from core.diagnosis.adopt import with_effects
from core.diagnosis.families import FAMILIES
from core.diagnosis.following import Moving, Physics, change
from core.diagnosis.grammar import Cell
from core.diagnosis.scoring import scores
from core.model import Model, rotor_blade, rotor_blade_wide
from core.network import Network
from core.observation import Inspection
from core.surrogate.driven import Driven

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
    assert np.array_equal(some[0], every[0])
    assert np.allclose(some[1], none[1], rtol=1e-9)
    assert not np.allclose(every[0], none[0], rtol=1e-3), "negative control"
