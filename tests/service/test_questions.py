"""What is said of a question that names no node, or one that is not there."""

from __future__ import annotations

from dataclasses import replace

import pytest

from core.builtin.paper_network import rotor_blade_network
from service.errors import FaultsError
from service.handlers.questions import question
from service.ports import ModelCard, Output

NETWORK = rotor_blade_network()
CARD = ModelCard(
    id="m",
    version="v",
    digest="d",
    network=NETWORK,
    horizon_h=1e4,
    node_count=10,
    nodes={"critical": 7},
    time_h=(0.0, 1e4),
    outputs={q.name: Output(q.unit, q.kind) for q in NETWORK.quantities},
    summary={},
)


@pytest.mark.parametrize(
    ("node", "words"),
    [
        (None, "node = None is needed for deformation: the model names no node, not tip"),
        ("3x", "node = '3x' does not exist in the model's mesh. To mend it: use 0 … 9[.]"),
    ],
)
def test_a_model_without_named_nodes_says_that_a_number_is_needed(
    node: str | None, words: str
) -> None:
    with pytest.raises(FaultsError, match=words):
        question(replace(CARD, nodes={}), "deformation", None, node, 0.95)
    assert question(replace(CARD, nodes={}), "deformation", None, "9", 0.95).node == 9


def test_nodes_are_told_by_name_where_there_are_any() -> None:
    with pytest.raises(FaultsError, match="use 0 … 9, or one of critical"):
        question(CARD, "deformation", None, "10", 0.95)
    assert question(CARD, "deformation", None, "critical", 0.95).node == 7
