"""Many runs in parallel processes, here or on other machines.

Each run is one process's work on one thread (more threads per run are slower than more runs).
The parent hands every finished run to `sink(index, run)` in the order of completion, so that the
caller can stream it to an archive and holds one run at a time. Which runs are computed is said by
`done`, the indices that the archive already holds, or by `todo`, which several campaigns share
(`core.archive.shared`). Processes are spawned, not forked, and get their inputs by value; where
the parent is killed they end. With `dask` they are workers of a Dask cluster (`core.blade.spread`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Any, Protocol

from core.blade.geometry import MESHES, build_mesh
from core.blade.inputs import check_inputs
from core.blade.properties import Properties
from core.blade.run import BladeRun, check_times, on_mesh, output_times, simulate
from core.blade.spread import spread
from core.errors import InputError, ModelError

Sink = Callable[[int, BladeRun], object]
Progress = Callable[[int, int, float], None]
LOOK_S = 1.0  # between two looks at what other workers have left


class Todo(Protocol):
    """Which runs a campaign computes."""

    def take(self) -> int | None:
        """The index of a run to compute; none: there is none at present."""
        ...

    def waiting(self) -> bool:
        """Whether others hold runs that may yet be left to this campaign."""
        ...

    def failed(self, index: int, reason: str) -> None:
        """Called for a run that was taken and cannot be computed."""
        ...

    @property
    def elsewhere(self) -> int:
        """How many runs others have finished."""
        ...


class Listed:
    """A list of runs for one campaign alone."""

    elsewhere = 0

    def __init__(self, indices: Iterable[int]) -> None:
        self._left = iter(indices)

    def take(self) -> int | None:
        """The next one."""
        return next(self._left, None)

    def waiting(self) -> bool:
        """Nobody else holds any."""
        return False

    def failed(self, index: int, reason: str) -> None:
        """The campaign itself keeps what failed."""


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
    todo: Todo | None = None,
    processes: int | None = None,
    dask: str | None = None,
    code: Callable[[], str] | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Campaign:
    """Simulate all `inputs` but those in `done`, or those that `todo` gives out.

    mesh        the mesh of the computation
    onto        name of the mesh whose nodes receive the fields (truth: mesh="fine",
                onto="default"); none: the mesh itself
    properties  one for all runs, or one per run (blades that differ in cooling, say)
    processes   none: one per core
    dask        address of a Dask scheduler, ``tcp://host:port``, or ``local:N``; none: processes
                of this machine
    code        digest of the program; a Dask worker that has another one is refused
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
    total = len(points)
    begun = len(done & set(range(total)))
    tasks: Todo = todo or Listed(i for i in range(total) if i not in done)
    ahead = 0 if todo else 1  # a run that waits here is one that nobody else computes
    completed: list[int] = []
    failures: list[Failure] = []
    waiting: dict[Future[BladeRun], int] = {}

    def tell() -> None:
        if progress is not None:
            own = len(completed) + len(failures)
            left = total - begun - tasks.elsewhere - own
            pace = (time.monotonic() - start) / max(own, 1)
            progress(total - left, total, pace * left)

    with spread(processes or os.cpu_count() or 1, dask, code) as pool:
        while True:
            while len(waiting) < pool.slots() + ahead and (index := tasks.take()) is not None:
                call = (points[index], mesh, onto, own[index], options)
                waiting[pool.submit(_one, *call)] = index
            if not waiting:
                if not tasks.waiting():
                    break
                time.sleep(LOOK_S)
            for future in wait(waiting, LOOK_S, FIRST_COMPLETED).done if waiting else ():
                index = waiting.pop(future)
                try:
                    run = future.result()
                except pool.lost as error:
                    failures.append(Failure(index, points[index], str(error)))
                    tasks.failed(index, str(error))
                except pool.broken as error:
                    raise ModelError(
                        f"run {index}: the process that computed it was ended from outside ({error}"
                        "); mostly memory was short. The same command goes on; give it less workers"
                    ) from error
                else:
                    sink(index, run)
                    completed.append(index)
                    del run
                tell()
    if tasks.elsewhere:
        tell()
    if failures and not completed and not tasks.elsewhere:
        raise ModelError(f"all {len(failures)} runs failed; the first: {failures[0].reason}")
    return Campaign(tuple(completed), tuple(failures), time.monotonic() - start)


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
