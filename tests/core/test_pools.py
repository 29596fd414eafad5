"""Processes that share out work: none is left behind, and each computes on one thread."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest

from core.archive.claims import started
from core.pools import CHUNK, THREADS, both, by_rows, process_pool
from tests.patience import PATIENCE_S

ORPHANS = """
import sys, time
from core import pools
if sys.argv[1] == "left":
    pools._end_with_parent = id  # any function of one argument that does nothing
def main():
    with pools.process_pool(1) as pool:
        import os
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(time.sleep, 3600)
        time.sleep(3600)
if __name__ == "__main__":
    main()
"""


@pytest.mark.parametrize("kind", ["watched", "left"])
def test_a_process_ends_when_its_parent_is_killed(tmp_path: Path, kind: str) -> None:
    """`left` is the negative control: without the watch it lives on."""
    script = tmp_path / "parent.py"
    script.write_text(ORPHANS)
    parent = subprocess.Popen([sys.executable, script, kind], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    until = time.monotonic() + (PATIENCE_S if kind == "watched" else 1)
    while (alive := started(child) is not None) and time.monotonic() < until:
        time.sleep(0.05)
    if alive:
        os.kill(child, signal.SIGKILL)
    assert alive == (kind == "left")


def test_each_computes_on_one_thread_and_the_callers_own_setting_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(THREADS[0], "7")
    monkeypatch.delenv(THREADS[1], raising=False)
    with process_pool(1) as made:
        assert made.submit(os.getenv, THREADS[0]).result() == "1"
        assert made.submit(os.getenv, THREADS[1]).result() == "1"
    assert os.environ[THREADS[0]] == "7"
    assert THREADS[1] not in os.environ


def test_what_waits_is_dropped_where_the_caller_fails() -> None:
    waiting: list[Future[None]] = []

    def failing() -> None:
        with process_pool(1) as made:
            waiting.extend(made.submit(time.sleep, 0.2) for _ in range(400))
            raise KeyError("the caller's own")

    with pytest.raises(KeyError):
        failing()
    assert sum(one.cancelled() for one in waiting) > 300


def test_both_run_side_by_side_and_share_their_rows_out() -> None:
    """Each waits for the other to be there: one after the other would never end."""
    meet = threading.Barrier(2, timeout=PATIENCE_S)
    big = np.arange(3.0 * CHUNK)

    def doubled(sign: float) -> float:
        meet.wait()
        return float(by_rows(lambda x: (2 * sign * x,), big)[0][-1])

    assert both(lambda: doubled(1.0), lambda: doubled(-1.0)) == (2 * big[-1], -2 * big[-1])


@pytest.mark.parametrize("place", [0, 1])
def test_what_either_of_both_raises_is_raised(place: int) -> None:
    calls = [lambda: 1.0, lambda: 1.0]
    calls[place] = lambda: 1.0 / 0
    with pytest.raises(ZeroDivisionError):
        both(*calls)
