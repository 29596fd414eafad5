"""Processes that share out work: none is left behind, and each computes on one thread."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from pathlib import Path

import pytest

from core.archive.claims import started
from core.pools import THREADS, process_pool

ORPHANS = """
import sys, time
from core import pools
if sys.argv[1] == "left":
    pools._end_with_parent = id  # any function of one argument that does nothing
def main():
    with pools.process_pool(1) as pool:
        import os
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(time.sleep, 60)
        time.sleep(60)
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
    until = time.monotonic() + (20 if kind == "watched" else 2)
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
            waiting.extend(made.submit(time.sleep, 0.2) for _ in range(40))
            raise KeyError("the caller's own")

    with pytest.raises(KeyError):
        failing()
    assert sum(one.cancelled() for one in waiting) > 30
