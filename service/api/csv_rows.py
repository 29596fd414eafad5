"""Readings as CSV: the rows of a body, each as the fields that JSON would have.

A scalar, or a field at one node, is a row with a `value`. A scan is a row for each node with `x`,
`y` and `z`, all rows of one `id`; what else they say has to be the same in each. It is what
``GET …/inspections?format=csv`` writes (`service.export.readings`).
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping
from typing import Any

from service.api.problems import MOST_FAULTS, NUMBER, Fault, RequestError, fault, invalid
from service.export.readings import COLUMNS
from service.names import is_number

CSV_EXAMPLE = "id,blade,quantity,time_h,value,unit\ni3,B01,elongation,16000,0.21,mm\n"
WHOLE = re.compile(r"\d{1,9}")
NEEDED = ("id", "blade", "quantity", "time_h")
AXES = ("x", "y", "z")
NUMBERS = ("time_h", "value", "sigma", *AXES)
MOST_ROWS = 500_000
LONGEST_LINE = 20_000  # bytes; longer than all cells of a row may be
LEFT_OUT = "leave out the row of a node that was not read"
NODE = "write its number in the model's mesh, a whole one"
KNOWN = f"the columns are {', '.join(COLUMNS)}"
Row = dict[str, Any]


def csv_rows(body: bytes) -> tuple[list[tuple[str, Row]], list[Fault]]:
    """The readings with the line of each, e.g. ``line 2.``, and the faults of rows of scans that
    are left out of them. RequestError: the table itself cannot be read; it lists every fault."""
    if (count := body.count(b"\n") + body.count(b"\r") - body.count(b"\r\n")) > MOST_ROWS:
        remedy = f"post {MOST_ROWS} at a time"
        raise invalid([fault("body", count, f"has more than {MOST_ROWS} lines", remedy)])
    if max(map(len, body.splitlines()), default=0) >= LONGEST_LINE:
        told = "the body is no CSV of readings: it has a line of 20,000 bytes or more"
        raise RequestError(400, "invalid-csv", told)
    try:
        reader = csv.DictReader(io.StringIO(body.decode("utf-8-sig"), newline=""), strict=True)
        if count <= 1 and len(body.splitlines()) == 1:
            _not_folded(list(reader.fieldnames or []))
        return _readings(_rows(reader))
    except UnicodeDecodeError as error:
        line, byte = 1 + error.object.count(b"\n", 0, error.start), error.object[error.start]
        told = f"the body is not in UTF-8: byte 0x{byte:02x} in line {line} is none of it"
        remedy = "To mend it: save the file as CSV in UTF-8"
        raise RequestError(400, "invalid-csv", f"{told}. {remedy}.") from None
    except csv.Error as error:
        raise RequestError(400, "invalid-csv", f"the body is not CSV: {error}") from None


def _not_folded(header: list[str]) -> None:
    """Refuses a table whose lines were joined to one, as curl does with a file that -d names."""
    if _separated(header) is None and not set(header) <= set(COLUMNS):
        remedy = "give each reading its line; curl keeps the lines of a file by --data-binary @FILE"
        raise invalid(
            [fault("body", ",".join(header), "is one line with more than a header", remedy)]
        )


def _rows(reader: csv.DictReader[str]) -> list[tuple[int, Row]]:
    """The rows without their empty cells, read one by one: all are not held at once. One that has
    nothing else, as spreadsheets write below a table, is no row."""
    header = list(reader.fieldnames or [])
    if (odd := _separated(header)) is not None:
        raise invalid([odd])
    if len(header) > len(COLUMNS):
        problem = f"are more columns than the {len(COLUMNS)} known ones"
        raise invalid([fault("header", len(header), problem, KNOWN)])
    faults = _header_faults(header)
    if len(set(header)) < len(header):
        raise invalid([*faults, fault("header", ", ".join(header), "names a column twice", KNOWN)])
    rows = []
    for row in reader:
        number = reader.line_num
        cells = _cells(row)
        if not any(cells):
            continue
        if len(cells) != len(header):
            problem = f"has {len(cells)} cells, and the header {len(header)}"
            remedy = "give every cell, and put one that holds a comma in double quotes"
            faults.append(fault(f"line {number}", ",".join(cells), problem, remedy))
            if len(faults) > MOST_FAULTS:
                raise invalid(faults)
        rows.append((number, {k: _cell(k, v) for k, v in row.items() if v}))
    if not rows and not faults:
        faults.append(fault("body", "", "holds no row", "give at least one reading"))
    if faults:
        raise invalid(faults)
    return rows


def _separated(header: list[str]) -> Fault | None:
    """That columns are separated by something else, as spreadsheets do where a comma is decimal."""
    for sign, called in ((";", "semicolons"), ("\t", "tabs"), ("|", "bars")):
        if len(header) == 1 and len({*header[0].split(sign)} & {*COLUMNS}) > 1:
            problem = f"is separated by {called}"
            remedy = "separate columns by commas, and write numbers with a point (0.41)"
            return fault("header", header[0][:100], problem, remedy)
    return None


def _cells(row: Mapping[Any, Any]) -> list[str]:
    """All cells of a line: of one that is too long the rest stands under None, of one that is too
    short what is missing is None."""
    kept = [value for name, value in row.items() if name is not None and value is not None]
    return [*kept, *row.get(None, ())]


def _header_faults(header: list[str]) -> list[Fault]:
    meant = {name: name.strip().lower() for name in header if name not in COLUMNS}
    faults = [
        fault(name or "header", name, "is no column", _header_remedy(name, meant[name]))
        for name in header
        if name in meant
    ]
    needed = NEEDED if set(AXES) & set(header) else (*NEEDED, "value")
    absent = [name for name in needed if name not in header and name not in meant.values()]
    faults += [fault(name, None, "is missing", KNOWN) for name in absent]
    return faults


def _header_remedy(name: str, meant: str) -> str:
    if not name:
        return "delete the column without a name: a comma too many, or the index of a frame"
    return f"write it {meant!r}" if meant in COLUMNS else KNOWN


def _cell(column: str, text: Any) -> Any:
    if column in NUMBERS and is_number(text):
        return float(text)
    if column == "node" and WHOLE.fullmatch(text):
        return int(text)
    return text


def _readings(rows: list[tuple[int, Row]]) -> tuple[list[tuple[str, Row]], list[Fault]]:
    """One reading for each row, but one for all rows of a scan; and what is wrong with these rows,
    which are left out of it."""
    found: list[tuple[str, Row]] = []
    scans: dict[Any, tuple[int, Row, Row]] = {}
    faults: list[Fault] = []
    for number, row in rows:
        given = {axis: row.pop(axis) for axis in AXES if axis in row}
        node = row.pop("node", None)
        if not given:
            found.append((f"line {number}.", row | ({} if node is None else {"nodes": [node]})))
            continue
        if odd := [*_scan_faults(f"line {number}", row, given, node)]:
            faults += odd
            if len(faults) > MOST_FAULTS:
                raise invalid(faults)
            continue
        first, head, whole = scans.setdefault(row.get("id"), (number, row, {}))
        if head != row:
            name = next(n for n in COLUMNS if head.get(n) != row.get(n))
            problem = f"is another than in line {first} of the same scan"
            remedy = "give all rows of a scan the same, or another id"
            faults.append(fault(f"line {number}.{name}", row.get(name), problem, remedy))
            continue
        if not whole:
            whole |= head | {"nodes": [], "values": []}
            found.append((f"line {number}.", whole))
        whole["nodes"].append(node)
        whole["values"].append([given[axis] for axis in AXES])
    return found, faults


def _scan_faults(where: str, row: Row, given: Row, node: Any) -> Iterator[Fault]:
    for axis in AXES:
        if axis not in given:
            yield fault(f"{where}.{axis}", None, "is missing", f"give it, or {LEFT_OUT}")
        elif not isinstance(given[axis], float):
            yield fault(f"{where}.{axis}", given[axis], "is no number", f"{NUMBER}, or {LEFT_OUT}")
    if "value" in row:
        remedy = "give x, y, z for a scan, `value` for a scalar"
        yield fault(f"{where}.value", row["value"], "stands beside x, y, z", remedy)
    if node is None:
        yield fault(f"{where}.node", None, "is missing", "name the node of each x, y, z triple")
    elif not isinstance(node, int):
        yield fault(f"{where}.node", node, "is no number of a node", NODE)
