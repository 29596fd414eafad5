"""The format of users' own runs, and how it is read.

One netCDF-4 file, as xarray writes it (``engine="h5netcdf"`` or ``"netcdf4"``). What a variable is
shows in its dimensions, in any order; every variable has ``units`` (`core.units`; 1 for none):

=====================  ==========================  ==============================================
dimensions             is                          attributes
=====================  ==========================  ==============================================
(run)                  an input of the simulation  units; low, high: bounds of the design (default:
                                                   those of the network's prior)
(time)                 ``time``, the instants      units (h, s, d …); from 0, increasing, four or
                                                   more
(run, time)            a scalar quantity           units
(run, time, node)      a field                     units
(run, time, node, xyz) a field of vectors          units
(node, xyz)            ``points`` of the mesh      units; optional
(cell, corner)         ``cells``: node numbers     optional; kind: ``tetra``, ``hexahedron20`` …
                                                   (`core.archive.cells`), in VTK's order of nodes
(run)                  ``run``: labels             optional: 0 … n − 1
(run, time)            ``time_of_run``             units; in place of ``time`` where runs have
                                                   instants of their own, NaN after the last
=====================  ==========================  ==============================================

The file's attributes: ``named_nodes``, JSON of name → node number; ``title`` or ``source``, free
text. A run that failed may be left out of the labels or hold NaN throughout; it is named and left
out. `core.archive.write` makes such files; a packed archive of ours (`Archive.to_netcdf`) and a
folder of runs (`Archive`) are read as well. With xarray:

    ds = xr.Dataset(
        {"roughness": ("run", r, {"units": "um", "low": 1.0, "high": 9.0}),
         "drop": (("run", "time"), y, {"units": "kPa"})},
        coords={"time": ("time", t, {"units": "h"})})
    ds.to_netcdf("runs.nc", engine="h5netcdf")
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.archive.declaration import Kind, Mesh
from core.errors import InputError

Array = NDArray[np.float64]
UNKNOWN = ""  # the unit where the file says none that is known


@dataclass(frozen=True, slots=True)
class Column:
    """An input: values (n,) of the runs in `unit`, and the bounds that the file gives it."""

    unit: str
    low: float | None
    high: float | None
    values: Array


@dataclass(frozen=True, slots=True)
class Given:
    """A quantity: its unit in the file, and its kind."""

    unit: str
    kind: Kind


@dataclass(frozen=True, slots=True)
class Source:
    """Runs as a file or folder holds them; one run's values are read at a time.

    labels   of the runs, as the user calls them
    time_h   (T,), or (n, T) where runs have instants of their own, NaN after a run's last
    read     (run, quantity) → values (T,), (T, N) or (T, N, 3) in the quantity's unit
    command  where the runs come from
    faults   what is wrong with it and keeps no value from being read: units
    """

    name: str
    labels: tuple[str, ...]
    inputs: Mapping[str, Column]
    quantities: Mapping[str, Given]
    time_h: Array
    mesh: Mesh
    read: Callable[[int, str], Array]
    command: str
    faults: tuple[InputError, ...] = ()

    def empty(self, skip: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Runs that hold no number at all, no input either, and are not skipped (n,)."""
        found = ~skip
        for column in self.inputs.values():
            found &= ~np.isfinite(column.values)
        for k in map(int, np.flatnonzero(found)):
            found[k] = not any(np.isfinite(self.read(k, q)).any() for q in self.quantities)
        return found
