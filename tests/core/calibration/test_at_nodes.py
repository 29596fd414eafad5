"""What messages keep of shared nodes is bounded over all of them, and never missed."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from core.calibration import at_nodes, collapsed
from core.calibration.at_nodes import AtNodes, held_bytes
from core.calibration.collapsed import CollapsedMessage
from core.calibration.direct import DirectMessage
from core.calibration.online import Workspace
from core.columns import Columns
from core.observation import Inspection
from core.readings import Readings
from tests.core.calibration.bar import bar, measured
from tests.core.calibration.linear import linear
from tests.core.calibration.test_collapsed import linear_readings, message_for
from tests.core.calibration.test_direct import ALL, message

UNIT = np.linspace(0.42, 0.6, 16)[:, None]


def test_what_is_made_at_nodes_is_made_once_and_the_oldest_of_three_anew() -> None:
    made: list[str] = []
    kept = AtNodes[np.ndarray]()

    def make(name: str) -> np.ndarray:
        made.append(name)
        return np.zeros(4)

    for name in ("a", "b", "a", "c", "b", "a"):
        kept.of(name, lambda name=name: make(name))  # type: ignore[misc]
    assert made == ["a", "b", "c", "a"]


def test_messages_hold_no_more_together_than_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    before = held_bytes()
    monkeypatch.setattr(at_nodes, "MOST_BYTES", before + 25_000)
    owners = [AtNodes[np.ndarray]() for _ in range(6)]
    for owner in owners:
        owner.of("nodes", lambda: np.zeros(1000))
    assert [owner.nbytes for owner in owners] == [0, 0, 0, 8000, 8000, 8000]
    owners[3].of("nodes", lambda: np.zeros(1000))
    owners[0].of("nodes", lambda: np.zeros(1000))
    assert [owner.nbytes for owner in owners] == [8000, 0, 0, 8000, 0, 8000]
    del owners, owner
    gc.collect()
    assert held_bytes() <= before


def test_a_closed_form_that_let_its_boxes_go_answers_the_same() -> None:
    own, unit = message(ALL, 10)
    assert isinstance(own, DirectMessage)
    column = own.column(unit)
    drawn = own.draws(unit, 24, np.random.default_rng(7), column)
    assert own._kept.nbytes > 50_000
    own._kept.let_go()
    assert np.array_equal(own.column(unit), column)
    own._kept.let_go()
    again = own.draws(unit, 24, np.random.default_rng(7), column)
    assert all(np.array_equal(one, other) for one, other in zip(drawn, again, strict=True))


def test_many_local_parameters_that_let_their_proposals_go_answer_the_same() -> None:
    own = message_for(linear(4), linear_readings((0.2, 0.9, 1.7), 0.15))
    assert isinstance(own, CollapsedMessage)
    column, error = own.column(UNIT), own.error(UNIT)
    drawn = own.draws(UNIT, 24, np.random.default_rng(7), column)
    own._fits.let_go()
    again = own.draws(UNIT, 24, np.random.default_rng(7), column)
    assert all(np.array_equal(one, other) for one, other in zip(drawn, again, strict=True))
    assert own.error(UNIT) == error


def test_an_error_is_told_of_a_column_that_is_known_and_whose_error_is_forgotten() -> None:
    own = message_for(linear(4), linear_readings((0.2, 0.9, 1.7), 0.15))
    error = own.error(UNIT)
    collapsed._ERRORS.clear()
    assert own.error(UNIT) == error


def test_rows_that_are_kept_hold_no_reading_of_another_blade() -> None:
    """Readings that are unpacked together are views of one array."""
    every = measured(40, (9000.0,), 0)
    none = [None] * len(every)
    some = Readings(Columns.of(every), lambda: ([one.id for one in every], none, none))
    assert some[0].values.base is not None
    (kept,) = Workspace().rows_of(bar(), [some[0]]).readings
    assert kept.values.base is None
    assert kept.to_json() == every[0].to_json()
    assert kept._digest == every[0].digest()


def test_a_scan_is_kept_without_the_scans_that_were_unpacked_with_it() -> None:
    nodes = np.arange(5)
    every = [
        Inspection(str(k), "B", "deformation", 10.0, np.full((5, 3), float(k)), nodes)
        for k in range(3)
    ]
    none = [None] * 3
    some = Readings(Columns.of(every), lambda: (["0", "1", "2"], none, none))
    kept = some[1].apart()
    assert (kept.values.base, kept.nodes is not None and kept.nodes.base) == (None, None)
    assert not kept.values.flags.writeable
    assert kept.to_json() == every[1].to_json()
    assert kept.apart() is kept
