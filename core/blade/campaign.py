"""Many runs in parallel processes.

Each run is one process's work on one thread (more threads per run are slower than more runs).
The parent hands every finished run to `sink(index, run)` in the order of completion, so that the
caller can stream it to an archive; a campaign that was cut resumes with `done`, the indices that
the archive already holds. Processes are spawned, not forked, and get their inputs by value.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from multiprocessing import get_context
from typing import Any

from core.blade.geometry import MESHES, build_mesh
from core.blade.inputs import check_inputs
from core.blade.properties import Properties
from core.blade.run import BladeRun, check_times, on_mesh, output_times, simulate
from core.errors import BladetwinError, InputError, ModelError

Sink = Callable[[int, BladeRun], None]
Progress = Callable[[int, int, float], None]

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Set to 1 for the processes: libraries read them when they are loaded."""


@dataclass(frozen=True, slots=True)
class Failure:
    """A run that could not be computed; the campaign goes on without it."""

    index: int
    inputs: dict[str, float]
    reason: str


@dataclass(frozen=True, slots=True)
class Campaign:
    """What a campaign did: indices in order of completion, failures, seconds of wall time."""

    completed: tuple[int, ...]
    failures: tuple[Failure, ...]
    seconds: float


def run_campaign(
    inputs: Sequence[Mapping[str, float]],
    sink: Sink,
    *,
    mesh: str = "default",
    onto: str | None = None,
    properties: Sequence[Properties] | Properties | None = None,
    done: set[int] | frozenset[int] = frozenset(),
    processes: int | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Campaign:
    """Simulate all `inputs` but those in `done`.

    mesh        the mesh of the computation
    onto        name of the mesh whose nodes receive the fields (truth: mesh="fine",
                onto="default"); none: the mesh itself
    properties  one for all runs, or one per run (blades that differ in cooling, say)
    processes   none: one per core
    progress    called with (finished, total, seconds left) after each run; finished counts `done`
    options     passed to :func:`core.blade.run.simulate` (time_h, bounds, tolerance, dtype …)

    All inputs are checked before the first process starts. Raises what the sink raises, after
    the running processes have ended; raises ModelError if every run failed.
    """
    start = time.monotonic()
    bounds = options.get("bounds")
    points = [check_inputs(point, bounds) for point in inputs]
    check_times(options["time_h"] if options.get("time_h") is not None else output_times())
    for name in (mesh, onto or mesh):
        if name not in MESHES:
            raise InputError("mesh", name, "is unknown", f"choose one of {', '.join(MESHES)}")
    own = [properties] * len(points) if not isinstance(properties, Sequence) else list(properties)
    if len(own) != len(points):
        raise InputError(
            "properties", len(own), f"does not fit {len(points)} runs", "give one, or one per run"
        )
    todo = iter([i for i in range(len(points)) if i not in done])
    total, begun = len(points), len(done & set(range(len(points))))
    completed: list[int] = []
    failures: list[Failure] = []
    workers = processes or os.cpu_count() or 1
    with _one_thread(), ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:

        def submit(index: int) -> tuple[Future[BladeRun], int]:
            call = (points[index], mesh, onto, own[index], options)
            return pool.submit(_one, *call), index

        waiting = dict(submit(i) for i in islice(todo, workers + 1))
        try:
            for future, index in _as_completed(waiting):
                for following in islice(todo, 1):
                    waiting.update([submit(following)])
                try:
                    run = future.result()
                except BladetwinError as error:
                    failures.append(Failure(index, points[index], str(error)))
                else:
                    sink(index, run)
                    completed.append(index)
                finished = len(completed) + len(failures)
                if progress is not None:
                    left = total - begun - finished
                    progress(begun + finished, total, (time.monotonic() - start) / finished * left)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    if failures and not completed:
        raise ModelError(f"all {len(failures)} runs failed; the first: {failures[0].reason}")
    return Campaign(tuple(completed), tuple(failures), time.monotonic() - start)


def _as_completed(waiting: dict[Future[BladeRun], int]) -> Iterator[tuple[Future[BladeRun], int]]:
    """Like the library's, for a set that grows; a result is dropped once it is handed on."""
    while waiting:
        for future in wait(waiting, return_when=FIRST_COMPLETED).done:
            yield future, waiting.pop(future)


def _one(
    point: dict[str, float],
    mesh: str,
    onto: str | None,
    properties: Properties | None,
    options: dict[str, Any],
) -> BladeRun:
    run = simulate(point, mesh, properties, **options)
    if onto is None or onto == mesh:
        return run
    geometry = (properties or Properties()).geometry
    return on_mesh(run, build_mesh(mesh, geometry), build_mesh(onto, geometry))


@contextmanager
def _one_thread() -> Iterator[None]:
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
