"""Which readings count."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from core.observation import Entry, Inspection, effective


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
