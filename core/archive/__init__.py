"""Archives of simulation runs, ours and users' own.

declaration  what the runs of an archive have in common
store        the archive that training reads: a directory of netCDF files
layout, disk  what lies in its files, and how they are written: whole or not at all
source       the format of users' own runs (documented there), and how it is read
check        every fault of such runs, with run, node and quantity
take         runs that are sound become an archive
axis         runs with unequal instants on a common axis
write        that format, written run by run
table, arrays, meshes   converters from CSV, npz and series of mesh files
faults       what is wrong, and what to mind
"""

from core.archive.declaration import BLADE_QUANTITIES, Declaration, Input, Mesh, Quantity, Run
from core.archive.store import Archive

__all__ = [
    "BLADE_QUANTITIES",
    "Archive",
    "Declaration",
    "Input",
    "Mesh",
    "Quantity",
    "Run",
]
