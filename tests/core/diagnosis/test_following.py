"""Where an effect's change of a reading is looked up: at its own nodes, else at the network's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.diagnosis.following import Physics
from core.model import rotor_blade
from core.observation import Inspection

MODEL = rotor_blade()
NAMED = MODEL.surrogate.named


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
