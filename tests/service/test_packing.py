"""A packed log: the same when unpacked, counts the same, is small, and seldom packed anew."""

from __future__ import annotations

import gc
import tracemalloc
from sys import intern
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.log import Entry, effective
from core.observation import Inspection
from core.readings import digest_of
from service.worker import packing
from service.worker.packing import PackedLog


def drawn(count: int, seed: int = 3) -> list[Entry]:
    """Entries of every kind and shape."""
    rng = np.random.default_rng(seed)
    found: list[Entry] = []
    for seq in range(1, count + 1):
        name = f"é{seq}"
        if seq % 7 == 0:
            found.append(Entry(seq, "retraction", f"é{seq - 1}"))
            continue
        kind = int(rng.integers(4))
        nodes = None if kind == 0 else rng.integers(0, 9000, kind)
        values = rng.normal(size=(kind, 3) if kind == 3 else max(kind, 1))
        given: dict[str, Any] = {
            "sigma": float(rng.random()),
            "instrument": "gauge",
            "campaign": "c",
            "observed_at": "2026-01-02T03:04:05Z",
            "replaces": f"é{seq - 1}",
            "unit": "mm",
        }
        said = {key: value for key, value in given.items() if rng.random() < 0.5}
        time_h: float = 8000 if kind == 1 else float(rng.uniform(0, 5e4))
        one = Inspection(name, f"B{seq % 5}", "elongation", time_h, values, nodes, **said)
        one.digest()
        found.append(Entry(seq, "inspection", name, one))
    return found


def said(entries: list[Entry]) -> list[Any]:
    """All that entries say, arrays as bytes."""
    return [
        (e.seq, e.kind, e.target, e.inspection and (_parts(e.inspection), e.inspection.digest()))
        for e in entries
    ]


def _parts(reading: Inspection) -> list[Any]:
    names = [name for name in Inspection.__slots__ if not name.startswith("_")]
    values = [getattr(reading, name) for name in names]
    return [
        (v.tobytes(), v.dtype.str, v.shape, v.flags.writeable) if isinstance(v, np.ndarray) else v
        for v in values
    ]


def anew(reading: Inspection) -> str:
    """The digest, computed from what the reading says."""
    return Inspection.from_json(reading.to_json()).digest()


def packed(entries: list[Entry], portions: list[int] | None = None) -> PackedLog:
    """The entries, brought in portions; what is left over comes last."""
    log, begin = PackedLog(), 0
    for size in portions or []:
        log, begin = log.extended(entries[begin : begin + size]), begin + size
        log = log.closed() if size % 2 else log
    return log.extended(entries[begin:])


@pytest.mark.parametrize("count", [0, 1, 6, 7, 300])
def test_unpacked_entries_are_those_packed(count: int) -> None:
    entries = drawn(count)
    log = packed(entries)
    back = log.entries()
    assert said(back) == said(entries)
    assert log.count == count
    readings = [e.inspection for e in back if e.inspection is not None]
    assert all(reading.digest() == anew(reading) for reading in readings)


@pytest.mark.parametrize("portions", [[], [1] * 300, [7, 100, 1, 1, 80], [299]])
@pytest.mark.parametrize("seed", [3, 4])
def test_readings_that_count_are_those_of_the_log_and_in_its_order(
    portions: list[int], seed: int
) -> None:
    """However the entries come: one by one, in portions, at once."""
    entries = drawn(300, seed)
    expected = effective(entries)
    found = packed(entries, portions).effective()
    assert 100 < len(expected) < 200, "some do not count"
    assert len(found) == len(expected)
    assert [_parts(one) for one in found] == [_parts(one) for one in expected]
    kept = packed(entries, portions).closed().effective()
    assert [_parts(one) for one in kept] == [_parts(one) for one in expected]
    assert [one.digest() for one in found] == [one.digest() for one in expected]
    assert digest_of(found) == digest_of(expected)
    assert found.columns.time_h.tolist() == [one.time_h for one in expected]
    assert found[-1].id == found[len(found) - 1].id == expected[-1].id
    assert [one.id for one in found[3:9]] == [one.id for one in expected[3:9]]


def some(draw: st.DrawFn) -> list[Entry]:
    """A log of few names and hours: corrections of corrections, retracted, told before their turn.

    Each id is there once, as in the database.
    """
    names = draw(st.permutations([f"n{k}" for k in range(9)]))
    found: list[Entry] = []
    for name in names[: draw(st.integers(0, 9))]:
        replaces = draw(st.none() | st.sampled_from(names))
        hour = draw(st.sampled_from([0.0, 8000.0, 16000.0]))
        value = np.array([draw(st.sampled_from([0.1, 0.2]))])
        one = Inspection(name, "B1", "elongation", hour, value, replaces=replaces)
        found.append(Entry(0, "inspection", name, one))
    out = draw(st.lists(st.sampled_from(names), max_size=4, unique=True))
    found += [Entry(0, "retraction", name) for name in out]
    return [
        Entry(seq, one.kind, one.target, one.inspection)
        for seq, one in enumerate(draw(st.permutations(found)), start=1)
    ]


@settings(max_examples=400, deadline=None)
@given(entries=st.composite(some)(), portions=st.lists(st.integers(1, 4), max_size=9))
def test_any_log_in_any_portions_counts_the_same(entries: list[Entry], portions: list[int]) -> None:
    log, expected = packed(entries, portions), effective(entries)
    assert [_parts(one) for one in log.effective()] == [_parts(one) for one in expected]
    assert digest_of(log.effective()) == digest_of(expected)
    assert said(log.entries()) == said(entries)


def test_a_packed_digest_is_not_computed_but_kept() -> None:
    """The control: a reading whose digest is another one comes back with that one."""
    entries = drawn(1)
    reading = entries[0].inspection
    assert reading is not None
    object.__setattr__(reading, "_digest", "0" * 32)
    log = packed(entries)
    back = log.entries()[0].inspection
    assert back is not None
    assert back.digest() == log.effective()[0].digest() == "0" * 32 != anew(back)


def test_a_log_is_what_it_was_after_another_came_of_it() -> None:
    entries = drawn(40)
    log = packed(entries[:30])
    before = said(log.entries()), [one.id for one in log.effective()], log.nbytes
    log.extended(entries[30:])
    assert (said(log.entries()), [one.id for one in log.effective()], log.nbytes) == before
    assert log.extended([]) is log


def test_entries_that_come_one_by_one_are_compressed_anew_seldom(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    entries = [entry for entry in drawn(700) if entry.inspection is not None][:512]
    counted: list[int] = []
    real = packing.Chunk.of

    def noted(columns: Any, words: Any) -> Any:
        counted.append(len(columns))
        return real(columns, words)

    monkeypatch.setattr(packing.Chunk, "of", noted)
    log = PackedLog()
    for count in range(512):
        log = log.extended([entries[count]])
        assert sum(chunk.count for chunk in log.chunks) == count + 1
    assert len(log.chunks) <= 10
    assert sum(counted) <= 11 * 512, "each entry about log₂ 512 times; all anew would be 131,328"
    assert said(log.entries()) == said(entries)


def test_bringing_a_log_up_to_date_looks_at_no_text_but_where_an_hour_is_shared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And makes no reading; nor does the digest of all, or what they are as numbers."""

    def one(k: int, hour: float) -> Entry:
        return Entry(k, "inspection", f"i{k}", Inspection(f"i{k}", "B1", "q", hour, np.ones(1)))

    log = packed([one(k, 10.0 * k) for k in range(1, 65)])
    looked: list[int] = []
    real = packing.Chunk.words
    monkeypatch.setattr(
        packing.Chunk, "words", lambda chunk: looked.append(chunk.count) or real(chunk)
    )
    monkeypatch.setattr("core.readings.made", None)
    more = log.extended([one(65, 5.0)])
    readings = more.effective()
    assert readings.columns.time_h[:3].tolist() == [5.0, 10.0, 20.0]
    assert len(readings.digest()) == 32
    assert looked == []
    log.extended([one(65, 30.0)])
    assert looked == [64]


@pytest.mark.parametrize("kind", ["plain", "of many blades", "corrected", "retracted"])
@pytest.mark.parametrize("size", [50, 4000])
def test_what_packed_entries_take_is_what_is_counted(size: int, kind: str) -> None:
    """Every second reading a correction, or retracted later, of a log of its own names."""

    def come(begin: int) -> list[Entry]:
        found = []
        for i in range(begin, begin + size // (2 if kind == "retracted" else 1)):
            blade = intern(f"B{i % (500 if kind == 'of many blades' else 9)}")
            replaces = f"i{i - 1}" if kind == "corrected" and i % 2 else None
            one = Inspection(f"i{i}", blade, "q", 1.5 * i, np.array([0.1 * i]), replaces=replaces)
            found.append(Entry(i, "inspection", f"i{i}", one))
        if kind == "retracted":
            found += [Entry(9000 + e.seq, "retraction", f"i{e.seq}") for e in found]
        return found

    def measured() -> tuple[int, int]:
        gc.collect()
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        logs = [packed(come(begin)).closed() for begin in range(0, 4000, size)]
        gc.collect()
        taken = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
        return taken, sum(log.nbytes for log in logs)

    packed(come(0))
    # what other threads of the process take meanwhile comes on top
    taken, counted = min(measured() for _ in range(3))
    assert counted == pytest.approx(taken, rel=0.25)
    if kind == "plain":
        assert taken < (40 if size == 4000 else 90) * 4000
