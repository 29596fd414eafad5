"""Many small runs, each kept as a file as it ends, so that a cut campaign goes on where it was.

For runs of which little is kept (a course in time); whole fields go through `core.blade.campaign`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.pools import process_pool

Array = NDArray[np.float64]


def kept_runs(
    folder: str | Path,
    todo: Mapping[str, tuple[Any, ...]],
    run: Callable[..., Array],
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Array]:
    """`run` of each tuple of arguments, by name, in processes of their own.

    A file appears whole or not at all. An error of a run ends the campaign; what was done stays.
    """
    own = Path(folder)
    own.mkdir(parents=True, exist_ok=True)
    done = {name: np.load(own / f"{name}.npy") for name in todo if (own / f"{name}.npy").exists()}
    with process_pool(workers) as made:
        waiting = {made.submit(run, *given): n for n, given in todo.items() if n not in done}
        for finished in as_completed(waiting):
            name = waiting[finished]
            done[name] = finished.result()
            part = own / f".{name}.{os.getpid()}.npy"
            np.save(part, done[name])
            os.replace(part, own / f"{name}.npy")
            if progress is not None:
                progress(len(done), len(todo))
    return {name: done[name] for name in todo}
