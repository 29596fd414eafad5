"""`bladetwin model convert`: runs of a table, of mesh files or of a numpy archive, as netCDF."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from core.errors import InputError
from service.commands import Json, say
from service.commands.telling import telling


def convert(
    file: Annotated[
        Path, typer.Argument(help="A table (.csv) or a numpy archive (.npz).", exists=True)
    ],
    out: Annotated[Path, typer.Option(help="The netCDF file to write.")],
    inputs: Annotated[
        list[str] | None, typer.Option("--input", help="Column that is an input; again for more.")
    ] = None,
    field: Annotated[
        list[str] | None,
        typer.Option(help="Point data and unit, as in 'temperature [K]'; again for more."),
    ] = None,
    points_unit: Annotated[str, typer.Option(help="Unit of the meshes' points.")] = "mm",
    node: Annotated[
        list[str] | None, typer.Option(help="A node with a name, as in tip=12; again for more.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Write runs as netCDF, from a table of curves, a table of mesh files, or a numpy archive.

    A table with a column `file` names mesh files (VTU, VTK, XDMF …), one for each run and instant.
    """
    from core.archive.arrays import convert_arrays
    from core.archive.meshes import convert_meshes
    from core.archive.table import HEADER, convert_table, read_table

    with telling(as_json):
        if file.suffix == ".npz":
            told = convert_arrays(file, out)
        elif field or "file" in read_table(file).units:
            fields: dict[str, str] = {}
            for text in field or ():
                match = HEADER.fullmatch(text)
                if match is None or match.group(2) is None:
                    raise InputError("field", text, "has no unit", "write 'temperature [K]'")
                fields[match.group(1)] = match.group(2)
            told = convert_meshes(
                file, out, fields, inputs=inputs, points_unit=points_unit, named=_named(node or [])
            )
        else:
            told = convert_table(file, out, inputs=inputs)
    shown = f"inputs {', '.join(map(str, _list(told['inputs'])))}; quantities "
    shown += ", ".join(map(str, _list(told["quantities"])))
    say(told | {"file": str(out)}, [f"{out}: {told['runs']} runs; {shown}"], as_json=as_json)


def _named(texts: list[str]) -> dict[str, int]:
    found = {}
    for text in texts:
        name, _, number = text.partition("=")
        if not name or not number.isdigit():
            raise InputError("node", text, "is no name and number", "write tip=12")
        found[name] = int(number)
    return found


def _list(value: object) -> list[object]:
    return list(value) if isinstance(value, list) else []
