"""The collector of cycles: what is there at first is walked no more, later cycles still go."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import pytest

from service.pauses import MIDDLE, OLD, YOUNG, set_aside


@pytest.fixture
def collector() -> Iterator[None]:
    before = gc.get_threshold()
    yield
    gc.unfreeze()
    gc.set_threshold(*before)


class Node:
    other: Node


def test_what_is_there_at_the_beginning_is_walked_no_more(collector: None) -> None:
    there = {"a": [1, 2]}
    assert set_aside() > 1000
    assert gc.get_threshold() == (YOUNG, MIDDLE, OLD)
    assert not any(one is there for one in gc.get_objects())


def test_cycles_that_come_later_still_go(collector: None) -> None:
    set_aside()
    one, two = Node(), Node()
    one.other, two.other = two, one
    seen = weakref.ref(one)
    del one, two
    gc.collect()
    assert seen() is None
