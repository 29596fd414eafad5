"""Processes and threads that share out work; processes end with the one that asked for it.

Python's pool leaves its processes behind where their parent is killed: each holds the pipe that it
reads from open for the others, so that none ever sees its end. A process of ours watches its parent
and ends with it, whatever it is doing; what it was at is lost, and nothing else.

Libraries of linear algebra compute on one thread each: processes are as many as there are
processors, and results must not depend on how many threads there were. Rows of large arrays go to
threads in chunks of a fixed size (`by_rows`), for the same reason.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
A = TypeVar("A")
B = TypeVar("B")

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Set to 1 for the processes: libraries read them when they are loaded."""
WATCH_S = 0.5
CHUNK = 1024  # rows
_LEAVES = ThreadPoolExecutor(max_workers=os.cpu_count() or 1, thread_name_prefix="rows")
_OTHERS = ThreadPoolExecutor(max_workers=os.cpu_count() or 1, thread_name_prefix="others")


def by_rows(work: Callable[..., tuple[Array, ...]], *arrays: Array) -> tuple[Array, ...]:
    """Results (n, …) of row-wise work on arrays (n, …), computed chunk by chunk side by side.

    The work must not ask for `by_rows` itself: its threads wait for nothing.

    >>> big = np.arange(2500.0)[:, None]
    >>> double, half = by_rows(lambda x: (2 * x, x / 2), big)
    >>> bool(np.all(double == 4 * half))
    True
    """
    n = len(arrays[0])
    parts = [[a[i : i + CHUNK] for a in arrays] for i in range(0, n, CHUNK)]
    if len(parts) < 2:
        return work(*arrays)
    made = list(_LEAVES.map(lambda part: work(*part), parts))
    return tuple(np.concatenate(column) for column in zip(*made, strict=True))


def both(one: Callable[[], A], other: Callable[[], B]) -> tuple[A, B]:
    """What two calls return, made side by side; they may ask for `by_rows`, and not for `both`.

    >>> both(lambda: 1, lambda: "b")
    (1, 'b')
    """
    later = _OTHERS.submit(other)
    try:
        first = one()
    except BaseException:
        later.cancel()
        raise
    return first, later.result()


@contextmanager
def process_pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """So many processes, started anew.

    Where the caller's block raises, calls that run are waited for and others dropped.
    """
    with (
        one_thread(),
        ProcessPoolExecutor(
            processes,
            mp_context=get_context("spawn"),
            initializer=_end_with_parent,
            initargs=(os.getpid(),),
        ) as made,
    ):
        try:
            yield made
        except BaseException:
            made.shutdown(wait=True, cancel_futures=True)
            raise


@contextmanager
def one_thread() -> Iterator[None]:
    """Processes that start meanwhile compute on one thread."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _end_with_parent(parent: int) -> None:
    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="end with parent").start()
