"""Reads a file to its end in a process of its own first, for HDF5 believes what it reads.

A length or an address that is damaged, or was made so, can keep the library busy for ever (a heap
of strings whose free space is said to be of no length is walked through without end), or end the
process that reads it. No exception tells of either, and no thread runs meanwhile. So a file from
outside is first read by a child with a bound on its processor time, its memory and its wall time;
only what a child has read to its end is opened here. What it finds wrong in words is not its
business: whoever opens the file says it (`core.archive.opening`).

    python -m core.archive.trial FILE SECONDS PARENT

The child ends with its parent, where the system can see to that (Linux).
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from core.archive.opening import check_file
from core.archive.reading import MOST_VALUES
from core.errors import ModelError

LEAST_S = 60.0  # of processor time
SPEED = 20e6  # bytes a second beside it
PATIENCE = 10.0  # times the processor time, of wall time: the machine may have other work
MEMORY = 8 * 2**30
SLAB = 2**23  # numbers that are read at once
PR_SET_PDEATHSIG = 1


def tried(path: str | Path, most_s: float | None = None) -> None:
    """Return if a child has read the file; ModelError: it did not come back.

    most_s   processor time [s]; none: `LEAST_S`, and more for larger files
    """
    path = Path(path)
    seconds = LEAST_S + path.stat().st_size / SPEED if most_s is None else most_s
    command = [sys.executable, "-m", __name__, os.fspath(path.resolve()), str(seconds)]
    command.append(str(os.getpid()))
    alone = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "HDF5_USE_FILE_LOCKING": "FALSE"}
    where = os.pathsep.join(p for p in sys.path if p)
    why = "it did not answer"
    with suppress(subprocess.TimeoutExpired):
        code = subprocess.run(
            command,
            env={**os.environ, **alone, "PYTHONPATH": where},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=PATIENCE * seconds,
            check=False,
        ).returncode
        if not code:
            return
        why = f"signal {-code}" if code < 0 else f"status {code}"
    raise ModelError(
        f"{path.name} is damaged: the HDF5 library did not come to its end within {seconds:g} s of "
        f"processor time, or broke off on it ({why}). Write it again"
    )


def read_all(path: Path) -> None:
    """Every attribute, dimension and number of the file, and what xarray makes of it.

    Nothing of one that points elsewhere, for libraries follow links; it is refused later.
    """
    import h5py
    import xarray as xr

    try:
        check_file(path)
    except ModelError:
        return
    with _told_elsewhere(), h5py.File(path, "r") as file:
        _attributes(file)
        for found in file.values():
            _attributes(found)
            with _told_elsewhere():
                for dimension in found.dims:
                    dict(dimension.items())
            with _told_elsewhere():
                _values(found)
    how: dict[str, Any] = {"decode_times": False, "decode_timedelta": False, "cache": False}
    with _told_elsewhere(), xr.open_dataset(path, engine="h5netcdf", **how) as data:
        _ = data.sizes, data.attrs, [(v.dims, v.attrs) for v in data.variables.values()]


@contextmanager
def _told_elsewhere() -> Iterator[None]:
    with suppress(Exception):
        yield


def _attributes(found: Any) -> None:
    with _told_elsewhere():
        for name in found.attrs:
            with _told_elsewhere():
                _ = found.attrs[name]


def _values(dataset: Any) -> None:
    """Read in slabs along the first axis; what is larger than a file may hold is not read."""
    if dataset.size and dataset.size <= MOST_VALUES:
        if not dataset.shape:
            _ = dataset[()]
            return
        rows = max(1, SLAB * dataset.shape[0] // dataset.size)
        for first in range(0, dataset.shape[0], rows):
            _ = dataset[first : first + rows]


def end_with(parent: int) -> None:
    """Have the kernel end this process with its parent, though a library holds every lock."""
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(0)


def main(path: str, seconds: str, parent: str) -> None:
    end_with(int(parent))
    most = max(1, round(float(seconds)))
    resource.setrlimit(resource.RLIMIT_CPU, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(ValueError, OSError):  # not every system bounds addresses
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    read_all(Path(path))


if __name__ == "__main__":
    main(*sys.argv[1:])
