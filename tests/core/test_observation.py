"""Which readings count."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import permutations

import numpy as np
import pytest

from core.errors import InputError
from core.log import Entry, effective
from core.network import Network, Parameter, Quantity
from core.observation import Inspection, faults
from core.prior import Prior


def log(*readings: str, retracted: str = "") -> list[Entry]:
    """Readings like ``b>a``, b in place of a; and the retraction of each letter."""
    entries = list[Entry]()
    for told in readings:
        own, _, named = told.partition(">")
        value = np.array([0.1])
        reading = Inspection(own, "B1", "elongation", 8000.0, value, replaces=named or None)
        entries.append(Entry(len(entries) + 1, "inspection", own, reading))
    return entries + [Entry(len(entries) + n, "retraction", one) for n, one in enumerate(retracted)]


@pytest.mark.parametrize(
    ("entries", "counting"),
    [
        (log("a", "b>a", "c>b"), "c"),
        (log("a", "b>a", "c>b", retracted="b"), "c"),
        (log("a", "b>a", "c>b", retracted="c"), "b"),
        (log("a", "b>a", "c>b", retracted="bc"), "a"),
        (log("a", "b>a", "c>b", "d>c", retracted="bc"), "d"),
        (log("a", "b>a", "c>b", "d>b", retracted="b"), "cd"),
        (log("a", "b>a", "c>a"), "bc"),
        (log("b>a", "c>b", retracted="b"), "c"),
        (log("a>b", "b>a"), ""),
        (log("a>b", "b>a", retracted="b"), "a"),
        (log("a>b", "b>a", "c>b", retracted="b"), "c"),
        (log("a>b", "b>c", "c>b", retracted="bc"), "a"),
    ],
)
def test_a_chain_of_corrections_counts_by_its_last_link_that_stands(
    entries: list[Entry], counting: str
) -> None:
    for order in permutations(entries):
        assert "".join(one.id for one in effective(order)) == counting


@dataclass(frozen=True)
class Mesh:
    """What a reading is held against."""

    nodes: dict[str, int] = field(default_factory=dict)
    horizon_h: float = 1e5
    node_count: int = 10


NOISE = Prior("log_uniform", 1e-6, 1e-3)


@pytest.mark.parametrize(
    ("node", "named", "taken"),
    [(None, {"critical": 3}, True), (None, {"hot": 3}, False), ("hot", {"hot": 3}, True),
     ("hot", {"critical": 3}, False), (None, {}, False)],
)  # fmt: skip
def test_a_field_is_read_at_a_node_that_is_known(
    node: str | None, named: dict[str, int], taken: bool
) -> None:
    """Without a number: at the quantity's own node, or the critical one; refused where none is."""
    quantity = Quantity("strain", "1", "field", NOISE, 0.0, 1.0, node=node)
    parameters = (Parameter("a", "local", Prior("uniform", 0.0, 1.0)),)
    network = Network("plate", parameters, (quantity,))
    bare = Inspection("i", "B1", "strain", 5.0, np.array([1e-4]))
    found = list(faults(bare, network, Mesh(named)))
    assert bool(found) != taken
    if not taken:
        assert isinstance(found[0], InputError)
        assert "give the number of a node" in found[0].remedy
    exact = Inspection("j", "B1", "strain", 5.0, np.array([1e-4]), np.array([7]))
    assert not list(faults(exact, network, Mesh(named)))


def test_a_node_that_a_scan_names_twice_is_told() -> None:
    quantity = Quantity("deformation", "mm", "vector", NOISE, -1.0, 1.0)
    parameters = (Parameter("a", "local", Prior("uniform", 0.0, 1.0)),)
    network = Network("plate", parameters, (quantity,))
    scan = Inspection("s", "B1", "deformation", 5.0, np.zeros((3, 3)), np.array([7, 9, 7]))
    (fault,) = faults(scan, network, Mesh())
    assert (fault.what, fault.value) == ("nodes", 7)
