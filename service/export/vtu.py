"""A field on its mesh as VTU (VTK XML unstructured grid), for ParaView, PyVista and meshio.

One piece; arrays in binary (base64, each behind its length in bytes), little-endian. Point data
are named with their unit, as ParaView shows them. `TimeValue` is the hour. What the field rests on
stands as JSON in a processing instruction, which XML readers pass over and people can read:

    <?bladetwin {"rotor": "r1", "version": 7, …}?>
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from service.ports import Mesh

# vtkCellType.h; of linear wedges VTK's order is not that of most codes
CELL_TYPES = {
    "vertex": 1, "line": 3, "triangle": 5, "quad": 9, "tetra": 10, "hexahedron": 12, "wedge": 13,
    "pyramid": 14, "triangle6": 22, "quad8": 23, "tetra10": 24, "hexahedron20": 25,
}  # fmt: skip
NAMES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}
Numbers = NDArray[Any]


def vtu(
    mesh: Mesh, point_data: Mapping[str, Numbers], time_h: float, facts: Mapping[str, Any]
) -> bytes:
    """The file; each array of `point_data` is (N,) or (N, 3)."""
    e, n = mesh.cells.shape
    cells = {
        "connectivity": mesh.cells.astype("<i8"),
        "offsets": np.arange(n, n * e + 1, n, dtype="<i8"),
        "types": np.full(e, CELL_TYPES[mesh.kind], dtype="u1"),
    }
    time = _array("TimeValue", np.array([time_h]), ' NumberOfTuples="1"')
    told = json.dumps(facts, ensure_ascii=True).replace("?>", "? >")
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f"<?bladetwin {told}?>",
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64">',
        "<UnstructuredGrid>",
        f"<FieldData>{time}</FieldData>",
        f'<Piece NumberOfPoints="{len(mesh.points)}" NumberOfCells="{e}">',
        "<PointData>",
        *(_array(name, values) for name, values in point_data.items()),
        "</PointData>",
        f"<Points>{_array('Points', mesh.points)}</Points>",
        "<Cells>",
        *(_array(name, values.reshape(-1)) for name, values in cells.items()),
        "</Cells>",
        "</Piece>",
        "</UnstructuredGrid>",
        "</VTKFile>",
    ]
    return ("\n".join(lines) + "\n").encode()


def _array(name: str, values: Numbers, more: str = "") -> str:
    data = np.ascontiguousarray(values)
    data = data.astype(data.dtype.newbyteorder("<"))
    body = data.tobytes()
    text = base64.b64encode(len(body).to_bytes(8, "little") + body).decode()
    kind = NAMES[data.dtype.str[1:]]
    width = f' NumberOfComponents="{data.shape[1]}"' if data.ndim == 2 else ""
    return (
        f'<DataArray type="{kind}" Name={quoteattr(name)}{width}{more} format="binary">'
        f"{text}</DataArray>"
    )
