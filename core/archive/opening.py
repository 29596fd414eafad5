"""Opens runs: a user's file, a packed archive of ours, or a folder of runs.

What comes from outside is looked at before it is read: a file whose numbers would come from
elsewhere, or that declares more of them than a machine holds, is refused. What comes
from a stranger is tried before (`core.archive.trial`): damaged bytes can keep the library busy for
ever.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from core.archive.declaration import Declaration, Mesh
from core.archive.reading import MOST_VALUES, read_user_file
from core.archive.source import Array, Column, Given, Source
from core.archive.store import Archive
from core.errors import ModelError


@contextmanager
def opened(path: str | Path, *, most_values: int = MOST_VALUES) -> Iterator[Source]:
    """A file or folder of runs, open for reading.

    Raises ModelError for what is no archive, RunsError for one whose variables do not fit.
    """
    path = Path(path)
    if path.is_dir():
        yield of_archive(Archive.open(path))
        return
    check_file(path)
    import xarray as xr

    try:
        data = xr.open_dataset(
            path, engine="h5netcdf", decode_times=False, decode_timedelta=False, cache=False
        )
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        raise ModelError(f"{path.name} cannot be read as netCDF: {error}") from error
    with data:
        packed = "declaration" in data.attrs
        with unbroken(path):
            source = _packed(path, data) if packed else read_user_file(path, data, most_values)
        own = source.read

        def read(k: int, quantity: str) -> Array:
            with unbroken(path):
                return own(k, quantity)

        yield replace(source, read=read)


@contextmanager
def unbroken(path: Path) -> Iterator[None]:
    """What the libraries raise where a file's bytes are damaged, in words."""
    try:
        yield
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        raise ModelError(f"{path.name} is damaged: {error}. Write it again") from error


def check_file(path: Path) -> None:
    """Refuse what is no HDF5 file, and one whose data would come from elsewhere.

    HDF5 can point into other files of the machine that reads it (external links and storage,
    virtual datasets); an archive holds its own numbers.
    """
    try:
        with h5py.File(path, "r") as file:
            _check_group(file, path.name)
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise ModelError(f"{path.name} cannot be read as netCDF-4: {error}") from error


def _check_group(group: Any, name: str) -> None:
    for key in group:
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            raise ModelError(f"{name}: {key!r} points elsewhere; an archive holds its own numbers")
        found = group[key]
        if isinstance(found, h5py.Group):
            raise ModelError(f"{name}: group {key!r}: put all variables at the top")
        if isinstance(found, h5py.Dataset) and (found.external or found.is_virtual):
            raise ModelError(f"{name}: {key!r} is stored elsewhere; write the numbers into it")


def of_archive(archive: Archive) -> Source:
    """Our own folder of runs; its inputs have no units, those of the network are taken."""
    declared, done = archive.declaration, archive.done()
    inputs = archive.inputs(done)
    columns = {
        item.name: Column("", item.low, item.high, inputs[:, j])
        for j, item in enumerate(declared.inputs)
    }
    return Source(
        archive.path.name,
        tuple(map(str, done)),
        columns,
        {q.name: Given(q.unit, q.kind) for q in declared.quantities},
        np.array(declared.time_h),
        archive.mesh(),
        lambda k, quantity: np.asarray(archive.stack(quantity, [done[k]])[0], dtype=float),
        declared.command,
    )


def _packed(path: Path, data: Any) -> Source:
    """One file of `Archive.to_netcdf`."""
    declared = Declaration.from_json(str(data.attrs["declaration"]))
    needed = {"index", "inputs", *(q.name for q in declared.quantities)}
    needed |= {"points", "cells", "parametric"} if declared.nodes else set()
    if needed - set(data.variables):
        missing = sorted(needed - set(data.variables))
        raise ModelError(f"{path.name} declares {missing} and does not hold them")
    inputs = np.asarray(data["inputs"].values, dtype=float)
    columns = {
        item.name: Column("", item.low, item.high, inputs[:, j])
        for j, item in enumerate(declared.inputs)
    }
    mesh = Mesh.none()
    if declared.nodes:
        points, cells, parametric = (data[n].values for n in ("points", "cells", "parametric"))
        kind = str(data["cells"].attrs.get("kind", ""))
        mesh = Mesh(declared.mesh, points, cells, parametric, declared.named, kind)
    return Source(
        path.name,
        tuple(str(int(k)) for k in data["index"].values),
        columns,
        {q.name: Given(q.unit, q.kind) for q in declared.quantities},
        np.array(declared.time_h),
        mesh,
        lambda k, quantity: np.asarray(data[quantity][k].values, dtype=float),
        declared.command,
    )
