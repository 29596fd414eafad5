"""The log, versions of states and their encoding, on both databases."""

from __future__ import annotations

import math
import random
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sqlalchemy import create_engine, event, func, select, text
from sqlalchemy.exc import DBAPIError

from core.digest import state_digest
from core.errors import InputError, ModelError
from core.observation import Inspection
from service.bootstrap import make_worker
from service.errors import (
    ConflictError,
    DamagedError,
    GoneError,
    NotFoundError,
    NotYetError,
    StoreAwayError,
)
from service.fake import FakeScience
from service.handlers.inspections import retract
from service.handlers.listing import list_inspections
from service.handlers.rotors import view_rotor
from service.ports import StateRecord
from service.settings import Settings
from service.store import cache
from service.store import tables as t
from service.store.cache import OVERHEAD, ArrayCache, Checked
from service.store.encoding import DamagedArrayError, decode, encode
from service.store.engine import open_engine, transaction
from service.store.named import digests
from service.store.postgres import LIMITS
from service.store.unit_of_work import SqlStore
from service.store.versions import dropped, thin, unneeded, write_state
from service.worker.loop import Worker

Make = Callable[..., Inspection]
Post = Callable[..., int]


@pytest.mark.parametrize("shape", [(), (0,), (5,), (4, 3), (2, 3, 4)])
@pytest.mark.parametrize("dtype", ["<f8", "<f4", "<i8", "|b1"])
def test_an_array_comes_back_bit_for_bit_and_read_only(shape: tuple[int, ...], dtype: str) -> None:
    array = (np.arange(np.prod(shape, dtype=int)) % 2 + 0.3).astype(dtype).reshape(shape)
    back = decode("a", encode(array))
    assert back.dtype == array.dtype
    assert back.shape == array.shape
    assert back.tobytes() == array.tobytes()
    assert not back.flags.writeable


def test_a_flipped_bit_is_noticed_and_the_array_named() -> None:
    stored = encode(np.array([1.5, 2.5]))
    damaged = replace(stored, data=stored.data[:-1] + bytes([stored.data[-1] ^ 1]))
    with pytest.raises(DamagedArrayError, match="column/B1"):
        decode("column/B1", damaged)


def test_an_array_of_another_shape_than_declared_is_refused() -> None:
    with pytest.raises(DamagedArrayError, match="3"):
        decode("a", replace(encode(np.zeros(3)), shape="4"))


def test_objects_are_never_stored() -> None:
    with pytest.raises(ModelError, match="object"):
        encode(np.array([{"a": 1}], dtype=object))


@pytest.mark.parametrize("url", ["mysql://h/x", "sqlite://", "sqlite:///:memory:", "nonsense"])
def test_a_database_of_another_kind_is_refused(url: str) -> None:
    with pytest.raises(InputError, match="BLADETWIN_DATABASE_URL"):
        open_engine(url)


def test_sequence_numbers_start_at_one_and_have_no_gap(
    store: SqlStore, rotor: str, reading: Make, post: Post
) -> None:
    assert post(rotor, reading("a"), reading("b")) == 2
    assert post(rotor, reading("c")) == 3
    with store.read() as tx:
        assert [e.seq for e in tx.log.page(rotor, "inspection", 0, 10)] == [1, 2, 3]
        assert tx.records.rotor(rotor).head_seq == 3


def test_the_same_reading_keeps_its_first_place(rotor: str, reading: Make, post: Post) -> None:
    post(rotor, reading("a"), reading("b"))
    assert post(rotor, reading("a")) == 1
    assert post(rotor, reading("c"), reading("b")) == 3


def test_another_reading_of_the_same_id_stores_nothing_of_its_batch(
    store: SqlStore, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a", value=0.11))
    with pytest.raises(ConflictError) as caught:
        post(rotor, reading("new"), reading("a", value=0.12))
    assert caught.value.name == "a"
    with store.read() as tx:
        assert tx.records.rotor(rotor).head_seq == 1
        assert tx.log.find(rotor, "new") is None


def test_the_list_says_which_readings_count(
    store: SqlStore, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a"), reading("b", replaces="a", value=0.12), reading("c"))
    post(rotor, reading("d", replaces="c"))
    retract(store, rotor, "d")
    status = {one.body["id"]: one.status for one in list_inspections(store, rotor, 0, 10)}
    assert status == {"a": "replaced", "b": "counts", "c": "counts", "d": "retracted"}


def _write(store: SqlStore, version: int, sealed: bool = True, **arrays: float | None) -> None:
    changed = {
        name: None if value is None else encode(np.array([value])) for name, value in arrays.items()
    }
    meta = {"v": version, "sealed": sealed, "events_digest": "e", "algorithm_version": "a-1"}
    with store.write() as tx:
        sha256 = digests(tx.connection, "r1")
        sha256 |= {name: one.sha256 for name, one in changed.items() if one is not None}
        sha256 = {name: sha256[name] for name in sha256 if changed.get(name, True) is not None}
        digest = state_digest(meta, sha256)
        record = StateRecord(
            "r1", version, version, "rotor-blade", "1", "a-1", sealed, digest, "e", meta, 0.0
        )
        write_state(tx.connection, record, changed)
        tx.connection.execute(t.cursor.update().values(version=version, applied_seq=version))


def test_a_version_is_read_with_the_arrays_that_it_had(store: SqlStore, rotor: str) -> None:
    _write(store, 1, a=1.5, b=10.5)
    _write(store, 2, a=2.5)
    _write(store, 3, b=None)
    assert [float(store.arrays(rotor, v)("a")[0]) for v in (1, 2, 3)] == [1.5, 2.5, 2.5]
    assert float(store.arrays(rotor, 2)("b")[0]) == 10.5
    with pytest.raises(ModelError, match="no array 'b'"):
        store.arrays(rotor, 3)("b")
    with store.read() as tx:
        assert set(digests(tx.connection, rotor)) == {"a"}
        assert tx.states.get(rotor).meta["v"] == 3
        assert tx.states.get(rotor, 1).version == 1


def test_thinning_keeps_new_versions_checkpoints_and_all_that_they_need(
    store: SqlStore, rotor: str
) -> None:
    for version in range(1, 13):
        changed = {"always": float(version)} | ({"once": 7.5} if version == 2 else {})
        _write(store, version, True, **changed)
    assert thin(store.engine, rotor, keep=3, every=4, chunk=2) == 6
    assert thin(store.engine, rotor, keep=3, every=4) == 0
    with store.read() as tx:
        kept = tx.connection.execute(select(t.state.c.version).order_by(t.state.c.version))
        assert list(kept.scalars()) == [4, 8, 9, 10, 11, 12]
        rows = (
            select(func.count()).select_from(t.state_array).where(t.state_array.c.name == "always")
        )
        assert tx.connection.execute(rows).scalar() == 6
    fresh = SqlStore(store.engine)
    for version in (4, 8, 9, 10, 11, 12):
        assert float(fresh.arrays(rotor, version)("always")[0]) == version
        assert float(fresh.arrays(rotor, version)("once")[0]) == 7.5
    with store.read() as tx, pytest.raises(GoneError):
        tx.states.get(rotor, 5)
    with store.read() as tx, pytest.raises(NotFoundError):
        tx.states.get(rotor, 13)


@settings(deadline=None)
@given(
    rows=st.lists(st.tuples(st.sampled_from("ab"), st.integers(1, 9)), unique=True),
    kept=st.lists(st.integers(1, 9), unique=True),
)
def test_a_row_is_dropped_where_no_kept_version_has_it(
    rows: list[tuple[str, int]], kept: list[int]
) -> None:
    """Held against what each version has: of each name the row with the greatest version."""
    own = {
        (name, max(v for n, v in rows if n == name and v <= version))
        for version in kept
        for name in "ab"
        if any(n == name and v <= version for n, v in rows)
    }
    last = {(name, max(v for n, v in rows if n == name)) for name, _ in rows}
    assert set(unneeded(sorted(rows), sorted(kept))) == set(rows) - own - last


def test_what_is_written_while_a_rotor_is_thinned_keeps_its_arrays(
    store: SqlStore, rotor: str
) -> None:
    """Versions come just when either its rows or its versions have been looked at."""
    for version in range(1, 6):
        _write(store, version, a=float(version), b=float(-version))
    begun = threading.Event()

    def write() -> None:
        begun.wait(60.0)
        for version in (6, 7, 8):
            _write(store, version, a=float(version), b=float(-version))

    other = threading.Thread(target=write)
    other.start()
    versions_alone = "SELECT state.version \n"

    def meanwhile(connection: Any, cursor: Any, statement: str, *rest: Any) -> None:
        if "ORDER BY state_array.name" in statement or statement.startswith(versions_alone):
            begun.set()
            other.join(60.0)

    event.listen(store.engine, "after_cursor_execute", meanwhile)
    try:
        thin(store.engine, rotor, keep=2, every=1000)
    finally:
        event.remove(store.engine, "after_cursor_execute", meanwhile)
        begun.set()
        other.join()
    thin(store.engine, rotor, keep=4, every=1000)
    fresh = SqlStore(store.engine)
    for version in _kept(store, rotor):
        assert float(fresh.arrays(rotor, version)("a")[0]) == version
        assert float(fresh.arrays(rotor, version)("b")[0]) == -version
    assert _kept(store, rotor)[-4:] == [5, 6, 7, 8]


def test_thinning_asks_as_many_questions_whatever_there_is(store: SqlStore, rotor: str) -> None:
    """It asked one for every row of every version, in the database: 50 ms of a hundred blades."""
    for version in range(1, 40):
        _write(store, version, **{f"x{n}": float(version) for n in range(version % 7 + 1)})
    asked: list[str] = []

    def note(connection: Any, cursor: Any, statement: str, *rest: Any) -> None:
        asked.append(statement)

    event.listen(store.engine, "before_cursor_execute", note)
    try:
        assert thin(store.engine, rotor, keep=3, every=4, chunk=1000) > 50
    finally:
        event.remove(store.engine, "before_cursor_execute", note)
    told = [one for one in asked if one.split()[0] in ("SELECT", "DELETE")]
    assert len(told) == 6
    assert not any("EXISTS" in one or one.count("SELECT") > 1 for one in told)


def _kept(store: SqlStore, rotor: str) -> list[int]:
    kept = select(t.state.c.version).where(t.state.c.rotor_id == rotor)
    with store.read() as tx:
        return list(tx.connection.execute(kept.order_by(t.state.c.version)).scalars())


def test_checkpoints_are_the_sealed_ones_of_a_rotor_read_one_reading_at_a_time(
    store: SqlStore, settings: Settings, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    """Its even versions are provisional, and so was every n-th one."""
    worker.drain()
    other = make_worker(store, FakeScience(provisional=True), settings)
    for i in range(20):
        post(rotor, reading(f"i{i}", time_h=1000.0 + i))
        other.drain()
    assert view_rotor(store, rotor).rotor.version == 41
    thin(store.engine, rotor, keep=1, every=4)
    assert _kept(store, rotor) == [15, 23, 31, 35, 39, 41]
    with store.read() as tx:
        assert {tx.states.get(rotor, version).sealed for version in _kept(store, rotor)} == {True}
        assert tx.states.get(rotor, 15).through_seq == 7
        with pytest.raises(GoneError) as gone:
            tx.states.get(rotor, 16)
    assert gone.value.kept == ((15, 7), (23, 11))
    fresh = SqlStore(store.engine)
    for version in _kept(store, rotor):
        assert fresh.arrays(rotor, version)("column/B1")[0] > 0


def test_checkpoints_are_few_however_long_a_rotor_lives() -> None:
    """And those that are there are the same, whenever and however often it was thinned."""
    chosen = random.Random(20310507)
    sealed = [chosen.random() < 0.3 for _ in range(1501)]
    kept: list[int] = []
    for last in range(1, 1501):
        kept.append(last)
        if chosen.random() < 0.1 or last == 1500:
            gone = dropped([(one, sealed[one]) for one in kept], last, 5)
            kept = [one for one in kept if one not in set(gone)]
            at_once = dropped([(one, sealed[one]) for one in range(1, last + 1)], last, 5)
            assert kept == sorted(set(range(1, last + 1)) - set(at_once))
            assert len(kept) <= 2 * math.log2(max(last / 5, 1)) + 2
            assert not dropped([(one, sealed[one]) for one in kept], last, 5)


def test_of_versions_none_of_which_is_sealed_the_last_one_stays() -> None:
    one_sealed = [(1, False), (2, True), (3, False), (4, False)]
    assert dropped(one_sealed, 4, 4) == [1, 3, 4]
    assert dropped([(one, False) for one, _ in one_sealed], 4, 4) == [1, 2, 3]


def test_a_rotor_without_posterior_says_what_to_wait_for(store: SqlStore, rotor: str) -> None:
    with store.read() as tx, pytest.raises(NotYetError, match="wait_for=0"):
        tx.states.get(rotor)


def test_a_damaged_row_is_named_and_not_used(store: SqlStore, rotor: str) -> None:
    _write(store, 1, a=1.5)
    with store.read() as tx:
        tx.states.get(rotor, 1)
    with transaction(store.engine, write=True) as connection:
        connection.execute(text("UPDATE state_array SET sha256 = 'other'"))
    with pytest.raises(DamagedError, match="array a"):
        store.arrays(rotor, 1)("a")


def test_the_cache_holds_no_more_than_its_limit_and_drops_the_oldest() -> None:
    kept = ArrayCache(limit_mb=2 * (80 + OVERHEAD) / 2**20)
    arrays = [np.full(10, float(i)) for i in range(3)]
    for i, array in enumerate(arrays):
        kept.put(("r", 1, str(i), "sha"), array)
        kept.get(("r", 1, "0", "sha"))
    assert kept.get(("r", 1, "0", "sha")) is arrays[0]
    assert kept.get(("r", 1, "1", "sha")) is None
    assert kept.get(("r", 1, "2", "sha")) is arrays[2]
    kept.put(("r", 1, "big", "sha"), np.zeros(1000))
    assert kept.get(("r", 1, "big", "sha")) is None


def test_versions_that_are_read_stay_compared_longest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "MOST_CHECKED", 2)
    checked = Checked()
    for version in (1, 2):
        checked.put("r", version, "told", {"a": "sha"})
    assert checked.get("r", 1) == {"a": "sha"}
    checked.put("r", 3, "told", {})
    assert [checked.get("r", version) is not None for version in (1, 2, 3)] == [True, False, True]


def _array(store: SqlStore, version: int) -> float:
    with store.read() as tx:
        return float(tx.states.reader(tx.states.get("r1", version))("a")[0])


def test_an_array_of_a_version_that_was_written_anew_is_not_served_from_before(
    store: SqlStore, rotor: str
) -> None:
    """As after a restore: the same numbers by another way."""
    _write(store, 1, a=1.5)
    assert _array(store, 1) == 1.5
    with transaction(store.engine, write=True) as connection:
        for table in (t.state, t.state_array):
            connection.execute(table.delete())
    _write(store, 1, a=2.5)
    assert _array(store, 1) == 2.5
    assert float(store.arrays(rotor, 1)("a")[0]) == 2.5


@pytest.mark.parametrize("most", [1, 512])
def test_an_array_of_a_version_that_is_gone_is_not_replaced_by_an_older_one(
    store: SqlStore, rotor: str, monkeypatch: pytest.MonkeyPatch, most: int
) -> None:
    monkeypatch.setattr(cache, "MOST_CHECKED", most)
    _write(store, 4, a=4.5)
    _write(store, 5, sealed=False, a=5.5)
    with store.read() as tx:
        state = tx.states.get(rotor, 5)
    arrays = store.arrays(rotor, 5)
    _write(store, 6, a=6.5)
    assert _array(store, 6) == 6.5
    assert thin(store.engine, rotor, keep=1, every=8) == 1
    with store.read() as tx, pytest.raises(GoneError):
        tx.states.reader(state)("a")
    with pytest.raises(GoneError):
        arrays("a")


def test_the_cache_holds_few_versions_of_a_rotor_those_used_last() -> None:
    cache = ArrayCache(limit_mb=1.0)
    one = np.zeros(2)

    def there(rotor: str) -> list[int]:
        return [v for v in range(1, 9) if cache.get((rotor, v, "a", None)) is not None]

    for version in range(1, 5):
        for name in ("a", "b"):
            cache.put(("r", version, name, None), one)
    assert there("r") == [2, 3, 4]
    assert cache.get(("r", 1, "b", None)) is None
    cache.put(("other", 1, "a", None), one)
    cache.get(("r", 2, "a", None))  # asked for as of then
    cache.put(("r", 5, "a", None), one)
    assert there("r") == [2, 4, 5]
    assert there("other") == [1]
    assert len(cache) == 2 + 2 + 1 + 1


def test_what_is_dropped_for_want_of_room_leaves_nothing_behind() -> None:
    cache = ArrayCache(limit_mb=10 * (16 + OVERHEAD) / 2**20)
    for rotor in range(100):
        cache.put((f"r{rotor}", 1, "a", None), np.zeros(2))
    assert len(cache) == 10
    assert len(cache._versions) == 10


def test_a_database_that_is_away_is_told_as_such(tmp_path: Path) -> None:
    for url in (
        f"sqlite:///{tmp_path / 'no' / 'such' / 'folder.db'}",
        f"postgresql://u@/d?host={tmp_path}",
    ):
        engine = open_engine(url)
        with pytest.raises(StoreAwayError), transaction(engine, write=False):
            pass
        engine.dispose()


def test_what_is_said_of_a_failed_statement_names_no_value(store: SqlStore) -> None:
    secret, wrong = "0.123454321", text("SELECT 1 WHERE nothing = :value")
    with pytest.raises(DBAPIError) as failed, store.engine.connect() as connection:
        connection.execute(wrong, {"value": secret})
    assert "nothing" in str(failed.value)
    assert secret not in str(failed.value)
    loud = create_engine(store.engine.url)  # the control: as SQLAlchemy has it
    with pytest.raises(DBAPIError) as failed, loud.connect() as connection:
        connection.execute(wrong, {"value": secret})
    loud.dispose()
    assert secret in str(failed.value)


def test_a_server_that_vanishes_is_noticed_unless_the_url_says_otherwise() -> None:
    """Limits of libpq, for the engine and for who listens beside it."""
    url = open_engine("postgresql://twin@host/name?connect_timeout=3").url
    told = dict(url.query)
    assert told["connect_timeout"] == "3"
    assert told["tcp_user_timeout"] == LIMITS["tcp_user_timeout"] == "30000"
    assert LIMITS.keys() <= told.keys()
