"""What a worker remembers: states of a few rotors, readings of more, and never what is not so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sqlalchemy import delete, event, update

from core.calibration.state import Array, Arrays, RotorState
from core.log import Entry
from core.observation import Inspection
from service.bootstrap import make_worker
from service.fake import FakeScience, FakeState
from service.handlers.rotors import create_rotor, view_rotor
from service.ports import BladeRecord
from service.settings import Settings
from service.store import tables as t
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.worker import task
from service.worker.memory import ARRAY_BYTES, NO_VERSION, ROTOR_BYTES, Memories, Memory
from service.worker.packing import PackedLog

Make = Callable[..., Inspection]
Post = Callable[..., int]


def entries(count: int) -> list[Entry]:
    names = [f"i{seq:03d}" for seq in range(count)]
    return [
        Entry(seq, "inspection", i, Inspection(i, "B1", "elongation", 8000.0, np.array([0.1])))
        for seq, i in enumerate(names)
    ]


HUNDRED = ROTOR_BYTES + PackedLog().extended(entries(100)).nbytes
NONE = ROTOR_BYTES + PackedLog().nbytes


def memory(count: int) -> Memory:
    log = PackedLog().extended(entries(count))
    return Memory(7, count, FakeState({}, {}), {"a": "sha"}, log=log)


def test_states_beyond_the_limit_go_and_their_readings_stay() -> None:
    kept = Memories(states=2, states_mb=1.0, readings_mb=1.0)
    whole = {name: memory(3) for name in "abc"}
    for name in "ab":
        kept.put(name, whole[name])
    kept.put("a", whole["a"])  # seen again: b is the oldest
    kept.put("c", whole["c"])
    assert kept.get("c") is whole["c"]
    other = kept.get("a")
    assert other is not None
    assert (other.version, other.through, other.sha256) == (7, 3, {"a": "sha"})
    assert other.state is whole["a"].state
    assert other.log is whole["a"].log
    rest = kept.get("b")
    assert rest is not None
    assert (rest.version, rest.through, rest.state, rest.last) == (NO_VERSION, 3, None, None)
    assert rest.log is whole["b"].log
    assert kept.get("d") is None


def test_readings_beyond_the_limit_go_the_oldest_first() -> None:
    kept = Memories(states=1, states_mb=1.0, readings_mb=3 * HUNDRED / 2**20)
    for name in "abcd":  # three have room
        kept.put(name, memory(100))
    assert [kept.get(name) is not None for name in "abcd"] == [False, True, True, True]
    kept.put("b", memory(100))  # counts once
    assert [kept.get(name) is not None for name in "bcd"] == [True, True, True]
    kept.put("e", memory(500))
    kept.put("f", memory(1))
    assert kept.get("e") is None, "too many for the limit"
    assert kept.get("f") is not None
    kept.put("g", memory(500))
    assert kept.get("f") is None
    assert kept.get("g") is not None, "those of the last one stay, however many"


def large(kib: float) -> Memory:
    """One whose state counts as so much."""
    numbers = np.zeros((int(kib * 2**10) - ARRAY_BYTES) // 8)
    return replace(memory(1), state=FakeState({}, {"a": numbers}))


def with_states(kept: Memories, names: str) -> str:
    """Those that are remembered with their state."""
    found = [(name, kept.get(name)) for name in names]
    return "".join(name for name, one in found if one is not None and one.state is not None)


def test_states_beyond_a_size_go_the_oldest_first_and_their_readings_stay() -> None:
    kept = Memories(states=8, states_mb=1.0, readings_mb=1.0)
    for name in "abc":
        kept.put(name, large(341))
    assert with_states(kept, "abc") == "abc"
    kept.put("d", large(1))
    assert with_states(kept, "abcd") == "abcd", "1,024 KiB are a MiB"
    kept.put("b", large(342))  # seen again, and larger now: a is the oldest
    assert with_states(kept, "abcd") == "bcd"
    kept.put("e", large(600))
    assert with_states(kept, "abcde") == "bde"
    assert all(kept.get(name) is not None for name in "abcde")
    kept.put("f", large(5000))
    assert with_states(kept, "abcdef") == "f", "that of the last one stays, whatever its size"
    kept.put("g", large(1))
    assert with_states(kept, "abcdefg") == "g"
    for name in "hij":
        kept.put(name, large(300))
        kept.forget(name)
    for name in "klm":
        kept.put(name, large(340))
    assert with_states(kept, "ghijklm") == "gklm", "what is forgotten frees its room"


def test_without_room_the_state_of_the_last_rotor_is_kept() -> None:
    kept = Memories(states=8, states_mb=0.0, readings_mb=1.0)
    for name in "abc":
        kept.put(name, memory(1))
    assert with_states(kept, "abc") == "abc", "no arrays, no bytes"
    for name in "abc":
        kept.put(name, large(1))
    assert with_states(kept, "abc") == "c"


def test_states_whose_readings_have_no_room_give_theirs_back() -> None:
    kept = Memories(states=8, states_mb=1.0, readings_mb=3 * NONE / 2**20)
    for name in "abcdefgh":
        kept.put(name, replace(large(5), log=PackedLog()))
    assert with_states(kept, "abcdefgh") == "fgh"
    assert kept._held == sum(one.state_bytes for one in kept._states.values())


def test_arrays_that_are_still_to_be_loaded_do_not_count_and_are_not_loaded() -> None:
    asked: list[str] = []

    def get(name: str) -> Array:
        asked.append(name)
        return np.zeros(1000)

    arrays = Arrays("abc", {"a": np.zeros(10)}, get)
    one = replace(memory(1), state=RotorState({}, arrays))
    assert one.state_bytes == 80 + 3 * ARRAY_BYTES
    assert asked == []
    assert arrays["b"].nbytes == 8000
    assert one.state_bytes == 8080 + 3 * ARRAY_BYTES
    assert replace(one, state=None).state_bytes == 0


@pytest.mark.parametrize(("states_mb", "reads"), [(1.0, 0), (0.0, 12)])
def test_of_a_rotor_whose_state_is_kept_no_array_is_read(
    store: SqlStore,
    science: FakeScience,
    settings: Settings,
    reading: Make,
    post: Post,
    states_mb: float,
    reads: int,
) -> None:
    """Three rotors in turn, with room for their states or for one (the control)."""
    given = settings.model_copy(update={"states_mb": states_mb})
    for name in ("r1", "r2", "r3"):
        create_rotor(store, name, "rotor-blade", [BladeRecord("B1")], 64, 7)
    worker = make_worker(store, science, given, "remembers")
    worker.drain()
    asked: list[str] = []

    def note(_c: Any, _cursor: Any, statement: str, *_: Any) -> None:
        if statement.startswith("SELECT state_array.name, state_array.encoding"):
            asked.append(statement)

    event.listen(store.engine, "before_cursor_execute", note)
    for number in range(4):
        for name in ("r1", "r2", "r3"):
            post(name, reading(f"i{number}", time_h=8000.0 + number))
            worker.drain()
    event.remove(store.engine, "before_cursor_execute", note)
    assert len(asked) == reads
    kept = [worker.updater._memory.get(name) for name in ("r1", "r2", "r3")]
    assert [one is not None and (one.log.count, one.log.whole) for one in kept] == [(4, None)] * 3


def test_readings_count_for_the_limit_whether_or_not_the_state_is_kept() -> None:
    kept = Memories(states=8, states_mb=1.0, readings_mb=3 * HUNDRED / 2**20)
    for name in "abcd":
        kept.put(name, memory(100))
    assert [kept.get(name) is not None for name in "abcd"] == [False, True, True, True]
    seen = [kept.get(name) for name in "bcd"]
    assert all(one is not None and one.state is not None for one in seen)
    kept.put("b", memory(500))
    kept.put("c", memory(1))
    assert kept.get("b") is None, "too many for the limit: its state goes with them"
    assert list(kept._states) == ["c"], "no state stays that could not be used"
    kept.forget("c")
    kept.put("e", memory(1))
    assert [kept.get(name) is not None for name in "cde"] == [False, False, True]


def test_what_is_forgotten_frees_its_room() -> None:
    kept = Memories(states=1, states_mb=1.0, readings_mb=2 * HUNDRED / 2**20)
    kept.put("a", memory(100))
    kept.put("b", memory(100))
    for name in "ab":
        kept.forget(name)
        assert kept.get(name) is None
    kept.put("c", memory(100))
    kept.put("d", memory(100))
    assert kept.get("c") is not None
    kept.forget("nobody")


def test_rotors_without_readings_have_their_room_too() -> None:
    kept = Memories(states=1, states_mb=1.0, readings_mb=4 * NONE / 2**20)
    for name in "abcdef":
        kept.put(name, memory(0))
    assert [kept.get(name) is not None for name in "abcdef"] == [False] * 2 + [True] * 4


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


def gone_back(store: SqlStore, rotor: str) -> None:
    """The database as it was before entry 2, as after a restore or an asynchronous failover."""
    with transaction(store.engine, write=True) as connection:
        for table, column in (
            (t.state, t.state.c.version),
            (t.state_array, t.state_array.c.version),
            (t.entry, t.entry.c.seq),
        ):
            own = (table.c.rotor_id == rotor) & (column > 1)
            connection.execute(delete(table).where(own))
        connection.execute(update(t.rotor).where(t.rotor.c.id == rotor).values(head_seq=1))
        connection.execute(
            update(t.cursor).where(t.cursor.c.rotor_id == rotor).values(applied_seq=1, version=1)
        )


class Wider(FakeScience):
    """Another release: its states have one more array."""

    def update(self, *given: Any, **more: Any) -> FakeState:
        state = super().update(*given, **more)
        arrays = {**state.arrays, "shared/more": np.array([1.0])}
        return replace(state, arrays=arrays)


@pytest.mark.parametrize("rotors_in_memory", [8, 1])
@pytest.mark.parametrize("same_log", [False, True])
def test_a_worker_does_not_trust_its_memory_of_a_database_that_went_back(
    store: SqlStore,
    science: FakeScience,
    settings: Settings,
    reading: Make,
    post: Post,
    rotors_in_memory: int,
    same_log: bool,
) -> None:
    """It comes to the same numbers by another way: another reading, or the same one, to the
    microsecond, and a version that another worker made."""
    few = Settings(**settings.model_dump() | {"rotors_in_memory": rotors_in_memory})
    for name in ("r1", "other"):
        create_rotor(store, name, "rotor-blade", [BladeRecord("B1")], 64, 7)
    worker = make_worker(store, science, few, "remembers")
    for name in ("a", "b"):
        post("r1", reading(name, value=0.1))
        worker.drain()
    with store.read() as tx:
        there = tx.log.entries("r1", 1, 2, 1)
    post("other", reading("a"))
    worker.drain()  # with room for one state it has only the readings of r1 now
    gone_back(store, "r1")
    if same_log:
        with store.write() as tx:
            tx.log.restore("r1", there)
            tx.connection.execute(update(t.rotor).values(head_seq=2).where(t.rotor.c.id == "r1"))
            tx.connection.execute(update(t.cursor).values(dirty=True, dirty_since=1.0))
    else:
        post("r1", reading("c", value=0.3))
    make_worker(store, Wider(), settings, "another").drain()
    post("r1", reading("d", value=0.2))
    worker.drain()
    state = view_rotor(store, "r1").state
    assert state is not None
    assert (state.version, state.through_seq) == (3, 3)
    create_rotor(store, "plain", "rotor-blade", [BladeRecord("B1")], 64, 7)
    post("plain", reading("a", value=0.1))
    post("plain", reading("b", value=0.1) if same_log else reading("c", value=0.3))
    post("plain", reading("d", value=0.2))
    make_worker(SqlStore(store.engine), science, settings, "fresh").drain()
    plain = view_rotor(store, "plain").state
    assert plain is not None
    assert state.events_digest == plain.events_digest
    fresh = SqlStore(store.engine)
    moments = [
        fresh.arrays(name, version)("shared/moments").tobytes()
        for name, version in (("r1", 3), ("plain", plain.version))
    ]
    assert moments[0] == moments[1]
