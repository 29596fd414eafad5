"""Readings as columns: what they tell is what the readings tell, whatever their shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from core.columns import Columns
from core.observation import Inspection
from core.readings import Readings, columns_of, digest_of


def drawn(count: int, *, sigma: bool = True, plain: bool = False) -> list[Inspection]:
    """Scalars, vectors at nodes, fields at some nodes; a third of them with a sigma."""
    rng = np.random.default_rng(5)
    found = []
    for k in range(count):
        kind = 0 if plain else int(rng.integers(4))
        nodes = None if kind == 0 else rng.integers(0, 9000, kind)
        values = rng.normal(size=(kind, 3) if kind == 3 else max(kind, 1))
        own: dict[str, Any] = {"sigma": float(rng.random())} if sigma and k % 3 == 0 else {}
        own |= {"unit": "mm"} if k % 2 else {}
        found.append(Inspection(f"i{k}", f"B{k % 4}", "q", 10.0 * k, values, nodes, **own))
    return found


def as_readings(some: list[Inspection], columns: Columns | None = None) -> Readings:
    def words() -> Any:
        return ([one.id for one in some], [None] * len(some), [None] * len(some))

    return Readings(Columns.of(some) if columns is None else columns, words)


def told(some: Any) -> list[Any]:
    """All that readings say, and that they are read-only."""
    return [
        (one.to_json(), one.digest(), one.values.shape, one.values.flags.writeable) for one in some
    ]


@pytest.mark.parametrize("plain", [True, False])
@pytest.mark.parametrize("sigma", [True, False])
@pytest.mark.parametrize("rows", [[], [4], [7, 2, 2, 19, 0], range(20), range(19, -1, -1)])
def test_rows_that_are_taken_are_those_readings(rows: Any, sigma: bool, plain: bool) -> None:
    some = drawn(20, sigma=sigma, plain=plain)
    taken = Columns.of(some).taken(np.array(list(rows), dtype=np.int64))
    expected = [some[k] for k in rows]
    assert told(as_readings(expected, taken)) == told(expected)
    assert len(taken) == len(expected)


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("then", [True, False])
def test_columns_join_whichever_of_them_give_a_sigma(first: bool, then: bool) -> None:
    some, more = drawn(9, sigma=first), drawn(23, sigma=then)[9:]
    before = Columns.of(some)
    after = Columns.of(more, before.heads)
    joined = Columns.joined([before, after], after.heads)
    assert told(as_readings(some + more, joined)) == told(some + more)
    assert len(joined.sigma) == (23 if first or then else 0)
    assert len(before) == 9
    assert joined.heads[: len(before.heads)] == before.heads
    assert len(set(joined.heads)) == len(joined.heads)


def test_of_many_heads_each_keeps_its_place() -> None:
    some = [Inspection(f"i{k}", f"B{k}", "q", 1.0, np.ones(1)) for k in range(700)]
    columns = Columns.of(some[:100])
    for k in range(100, 700, 60):
        more = Columns.of(some[k : k + 60], columns.heads)
        columns = Columns.joined([columns, more], more.heads)
    assert columns.each(lambda head: head.blade) == [one.blade for one in some]


@pytest.mark.parametrize("count", [0, 1, 2, 50])
def test_a_digest_of_columns_is_that_of_the_readings_in_any_order(count: int) -> None:
    some = drawn(count)
    assert digest_of(as_readings(some)) == digest_of(some) == digest_of(some[::-1])
    if some:
        assert digest_of(as_readings(some)) != digest_of(some[1:])


def test_digests_that_begin_or_end_with_zeros_are_whole() -> None:
    """Text of a fixed length that ends with zeros is shorter where one is looked at alone."""
    some = drawn(4, plain=True)
    for one, digest in zip(
        some, ("00" * 16, "11" * 15 + "00", "00" * 15 + "11", "ff" * 16), strict=True
    ):
        object.__setattr__(one, "_digest", digest)
    readings = as_readings(some)
    assert [one.digest() for one in readings] == [one.digest() for one in some]
    assert readings.digest() == digest_of(some)


def test_readings_are_made_once_and_columns_are_not_made_again() -> None:
    some = as_readings(drawn(5))
    assert some[0] is next(iter(some)) is some[:2][0]
    assert columns_of(some) is some.columns
    assert columns_of(drawn(5)).digests.tolist() == some.columns.digests.tolist()
