"""What a worker remembers: states of a few rotors, readings of more, and never what is not so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from core.observation import Entry, Inspection
from service.bootstrap import make_worker
from service.fake import FakeScience, FakeState
from service.handlers.rotors import create_rotor, view_rotor
from service.ports import BladeRecord
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from service.worker import task
from service.worker.memory import ENTRY_BYTES, NO_VERSION, Memories, Memory, size

Make = Callable[..., Inspection]
Post = Callable[..., int]


def entries(count: int) -> list[Entry]:
    one = Inspection("i", "B1", "elongation", 8000.0, np.array([0.1]))
    return [Entry(seq, "inspection", "i", one) for seq in range(count)]


def memory(count: int) -> Memory:
    return Memory(7, count, FakeState({}, {}), {"a": "sha"}, entries(count))


def test_an_entry_is_counted_with_its_values_and_nodes() -> None:
    scan = Inspection("s", "B1", "deformation", 8e3, np.zeros((5, 3)), np.arange(5))
    assert size(entries(2)) == 2 * ENTRY_BYTES
    assert size([Entry(1, "inspection", "s", scan)]) == ENTRY_BYTES + 14 * 8 + 5 * 8


def test_states_beyond_the_limit_go_and_their_readings_stay() -> None:
    kept = Memories(states=2, readings_mb=1.0)
    whole = {name: memory(3) for name in "abc"}
    for name in "ab":
        kept.put(name, whole[name])
    kept.put("a", whole["a"])  # seen again: b is the oldest
    kept.put("c", whole["c"])
    assert kept.get("a") is whole["a"]
    assert kept.get("c") is whole["c"]
    assert kept.get("b") == Memory(NO_VERSION, 3, None, {}, whole["b"].entries)
    assert kept.get("d") is None


def test_readings_beyond_the_limit_go_the_oldest_first() -> None:
    kept = Memories(states=1, readings_mb=2 * 100 * ENTRY_BYTES / 2**20)
    for name in "abcd":  # d with its state; of a, b, c two have room
        kept.put(name, memory(100))
    assert [kept.get(name) is not None for name in "abcd"] == [False, True, True, True]
    kept.put("b", memory(100))  # d's state goes; b's readings no longer count as kept ones
    assert [kept.get(name) is not None for name in "bcd"] == [True, True, True]
    kept.put("e", memory(500))
    kept.put("f", memory(1))
    assert kept.get("e") is None, "too many for the limit"
    assert kept.get("f") is not None


def test_what_is_forgotten_frees_its_room() -> None:
    kept = Memories(states=1, readings_mb=100 * ENTRY_BYTES / 2**20)
    kept.put("a", memory(100))
    kept.put("b", memory(100))
    for name in "ab":
        kept.forget(name)
        assert kept.get(name) is None
    kept.put("c", memory(100))
    kept.put("d", memory(100))
    assert kept.get("c") is not None
    kept.forget("nobody")


@pytest.mark.parametrize(("readings_mb", "most"), [(1.0, 1), (0.0, 4)])
def test_a_rotor_whose_state_was_dropped_is_read_from_what_came_since(
    store: SqlStore,
    science: FakeScience,
    settings: Settings,
    reading: Make,
    post: Post,
    monkeypatch: pytest.MonkeyPatch,
    readings_mb: float,
    most: int,
) -> None:
    """Two rotors in turn with room for one state; without room for readings (the control) each
    update reads them all. The states are those of a worker that starts anew each time."""
    asked: list[int] = []
    real = task.read_entries

    def noted(*given: Any) -> Any:
        found = real(*given)
        asked.append(len(found))
        return found

    few = Settings(**settings.model_dump() | {"rotors_in_memory": 1, "readings_mb": readings_mb})
    for name in ("r1", "r2", "plain"):
        create_rotor(store, name, "rotor-blade", [BladeRecord("B1")], 64, 7)
    worker = make_worker(store, science, few, "forgetful")
    worker.drain()
    monkeypatch.setattr(task, "read_entries", noted)
    for number in range(5):
        one = reading(f"i{number}", time_h=8000.0 + number, value=0.1)
        for name in ("r1", "r2"):
            post(name, one)
            worker.drain()
    assert max(asked) == most
    monkeypatch.undo()
    for number in range(5):
        post("plain", reading(f"i{number}", time_h=8000.0 + number, value=0.1))
        make_worker(store, science, settings, f"w{number}").drain()
    views = [view_rotor(store, name).state for name in ("r1", "r2", "plain")]
    assert len({one.events_digest for one in views if one is not None}) == 1
    moments = [
        store.arrays(name, view_rotor(store, name).rotor.version)("shared/moments").tobytes()
        for name in ("r1", "r2", "plain")
    ]
    assert len(set(moments)) == 1
