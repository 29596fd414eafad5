"""The collector of cycles: what is there at first is walked no more, later cycles still go."""

from __future__ import annotations

import gc
import platform
import subprocess
import sys
import weakref
from collections.abc import Iterator

import pytest

from service.pauses import MIDDLE, OLD, YOUNG, set_aside
from tests.patience import PATIENCE_S


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


def in_its_own(code: str, *how: str) -> subprocess.CompletedProcess[str]:
    """A program that is told how, in a process of its own with glibc; skips where there is none."""
    if platform.libc_ver()[0] != "glibc":
        pytest.skip("not glibc")
    return subprocess.run(
        [sys.executable, "-c", code, *how], capture_output=True, text=True, check=True
    )


def test_threads_share_two_arenas() -> None:
    """In a process of its own: 32 threads that allocate hold so many heaps of glibc's."""
    code = (
        "import ctypes, sys, threading\n"
        "from service.arenas import share_arenas\n"
        "if sys.argv[1] == 'shared': assert share_arenas()\n"
        "libc = ctypes.CDLL(None)\n"
        "barrier = threading.Barrier(32)\n"
        "def work():\n"
        "    barrier.wait()\n"
        "    kept = [bytearray(5000) for _ in range(200)]\n"
        "    barrier.wait()\n"
        "threads = [threading.Thread(target=work) for _ in range(32)]\n"
        "[one.start() for one in threads]\n"
        "[one.join() for one in threads]\n"
        "libc.malloc_stats()\n"
    )

    def arenas(how: str) -> int:
        return in_its_own(code, how).stderr.count("Arena ")

    assert arenas("shared") <= 2
    assert arenas("own") > 2, "the control"


def test_free_pages_are_given_back() -> None:
    """In a process of its own: one block in a hundred stays, so no arena shrinks from its end."""
    code = (
        "import sys, time\n"
        "from service.arenas import give_back, share_arenas\n"
        "def held():\n"
        "    return int(open('/proc/self/statm').read().split()[1]) * 4096 / 2**20\n"
        "assert share_arenas()\n"
        "before = held()\n"
        "blocks = [bytearray(20_000) for _ in range(5_000)]\n"
        "blocks = blocks[::100]\n"
        "if sys.argv[1] == 'given': assert give_back(0.05)\n"
        "end = time.monotonic() + float(sys.argv[2])\n"
        "while held() - before > 20.0 and time.monotonic() < end:\n"
        "    time.sleep(0.01)\n"
        "print(held() - before)\n"
    )

    def held(how: str, patience_s: float) -> float:
        return float(in_its_own(code, how, str(patience_s)).stdout)

    assert held("given", PATIENCE_S) < 20.0
    assert held("kept", 0.5) > 60.0, "the control"
