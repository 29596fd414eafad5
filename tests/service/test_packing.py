"""Packed entries: the same when unpacked, small, and seldom packed anew."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from core.observation import Entry, Inspection, effective
from service.worker import packing
from service.worker.packing import Chunks, packed, unpacked


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


@pytest.mark.parametrize("count", [0, 1, 6, 7, 300])
def test_unpacked_entries_are_those_packed(count: int) -> None:
    entries = drawn(count)
    back = unpacked(packed(entries))
    assert said(back) == said(entries)
    readings = [e.inspection for e in back if e.inspection is not None]
    assert all(reading.digest() == anew(reading) for reading in readings)
    assert [r.digest() for r in effective(back)] == [r.digest() for r in effective(entries)]


def test_a_packed_digest_is_not_computed_but_kept() -> None:
    """The control: a reading whose digest is another one comes back with that one."""
    entries = drawn(1)
    reading = entries[0].inspection
    assert reading is not None
    object.__setattr__(reading, "_digest", "0" * 32)
    back = unpacked(packed(entries))[0].inspection
    assert back is not None
    assert back.digest() == "0" * 32 != anew(back)


def test_entries_that_come_one_by_one_are_packed_anew_seldom(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    entries = drawn(512)
    counted: list[int] = []
    real: Callable[[Any], Any] = packing._chunk

    def noted(some: list[Entry]) -> Any:
        counted.append(len(some))
        return real(some)

    monkeypatch.setattr(packing, "_chunk", noted)
    chunks: Chunks = ()
    for count in range(1, 513):
        chunks = packed(entries[:count], chunks)
        assert sum(chunk.count for chunk in chunks) == count
    assert len(chunks) <= 10
    assert sum(counted) <= 10 * 512, "each entry about log₂ 512 times; all anew would be 131,328"
    assert said(unpacked(chunks)) == said(entries)
    again = packed(entries, chunks)
    assert [one is other for one, other in zip(again, chunks, strict=True)] == [True] * len(chunks)


def test_what_packed_entries_take_is_what_is_counted() -> None:
    entries = [
        Entry(i, "inspection", f"i{i}", Inspection(f"i{i}", f"B{i % 9}", "q", 1.5 * i, [0.1 * i]))  # type: ignore[arg-type]
        for i in range(4000)
    ]
    packed(entries)  # (digests that the readings keep are made here)
    gc.collect()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    chunks = [packed(entries[k : k + 40]) for k in range(0, 4000, 40)]
    gc.collect()
    taken = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    counted = sum(chunk.nbytes for one in chunks for chunk in one)
    assert counted == pytest.approx(taken, rel=0.15)
    assert taken < 100 * len(entries)
