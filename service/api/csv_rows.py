"""Readings as CSV: the rows of a body, each as the fields that JSON would have.

A scalar, or a field at one node, is a row with a `value`. A scan is a row for each node with `x`,
`y` and `z`, all rows of one `id`; what else they say has to be the same in each. It is what
``GET …/inspections?format=csv`` writes (`service.export.readings`).
"""

from __future__ import annotations

import csv
import io
import re
from typing import Any

from service.api.problems import MOST_FAULTS, Fault, RequestError, fault, invalid
from service.export.readings import COLUMNS
from service.names import is_number

CSV_EXAMPLE = "id,blade,quantity,time_h,value,unit\ni3,B01,elongation,16000,0.21,mm\n"
WHOLE = re.compile(r"\d{1,9}")
NEEDED = ("id", "blade", "quantity", "time_h")
AXES = ("x", "y", "z")
NUMBERS = ("time_h", "value", "sigma", *AXES)
MOST_ROWS = 500_000
LONGEST_LINE = 20_000  # bytes; longer than all cells of a row may be
KNOWN = f"the columns are {', '.join(COLUMNS)}"
Row = dict[str, Any]


def csv_rows(body: bytes) -> list[tuple[str, Row]]:
    """The readings and the line of each, e.g. ``line 2.``. RequestError lists every fault."""
    if (count := body.count(b"\n") + body.count(b"\r") - body.count(b"\r\n")) > MOST_ROWS:
        remedy = f"post {MOST_ROWS} at a time"
        raise invalid([fault("body", count, f"has more than {MOST_ROWS} lines", remedy)])
    if max(map(len, body.splitlines()), default=0) >= LONGEST_LINE:
        told = "the body is no CSV of readings: it has a line of 20,000 bytes or more"
        raise RequestError(400, "invalid-csv", told)
    try:
        reader = csv.DictReader(io.StringIO(body.decode("utf-8-sig"), newline=""), strict=True)
        return _readings(_rows(reader))
    except (UnicodeDecodeError, csv.Error) as error:
        raise RequestError(400, "invalid-csv", f"the body is not CSV in UTF-8: {error}") from None


def _rows(reader: csv.DictReader[str]) -> list[tuple[int, Row]]:
    """The rows that are not empty in each cell, read one by one: all are not held at once."""
    header = list(reader.fieldnames or [])
    if (odd := _separated(header)) is not None:
        raise invalid([odd])
    if len(header) > len(COLUMNS):
        problem = f"are more columns than the {len(COLUMNS)} known ones"
        raise invalid([fault("header", len(header), problem, KNOWN)])
    faults = _header_faults(header)
    rows = []
    for row in reader:
        number = reader.line_num
        if None in row or None in row.values():
            problem, remedy = "has another number of cells than the header", "give every cell"
            told = ",".join(str(value) for value in row.values())
            faults.append(fault(f"line {number}", told, problem, remedy))
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


def _header_faults(header: list[str]) -> list[Fault]:
    faults = [fault(name, name, "is no column", KNOWN) for name in header if name not in COLUMNS]
    needed = NEEDED if set(AXES) & set(header) else (*NEEDED, "value")
    faults += [fault(name, None, "is missing", KNOWN) for name in needed if name not in header]
    if len(set(header)) < len(header):
        faults.append(fault("header", ", ".join(header), "names a column twice", KNOWN))
    return faults


def _cell(column: str, text: Any) -> Any:
    if column in NUMBERS and is_number(text):
        return float(text)
    if column == "node" and WHOLE.fullmatch(text):
        return int(text)
    return text


def _readings(rows: list[tuple[int, Row]]) -> list[tuple[str, Row]]:
    """One reading for each row, but one for all rows of a scan."""
    found: list[tuple[str, Row]] = []
    scans: dict[Any, tuple[int, Row, Row]] = {}
    faults: list[Fault] = []
    for number, row in rows:
        given = [row.pop(axis) for axis in AXES if axis in row]
        node = row.pop("node", None)
        if not given:
            found.append((f"line {number}.", row | ({} if node is None else {"nodes": [node]})))
            continue
        if (odd := _scan_fault(number, row, given, node)) is not None:
            faults.append(odd)
            if len(faults) > MOST_FAULTS:
                break
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
        whole["values"].append(given)
    if faults:
        raise invalid(faults)
    return found


def _scan_fault(number: int, row: Row, given: list[Any], node: Any) -> Fault | None:
    where = f"line {number}"
    if len(given) < len(AXES):
        return fault(where, given, "has not all of x, y, z", "give all three, or a `value` alone")
    if "value" in row:
        remedy = "give x, y, z for a scan, `value` for a scalar"
        return fault(f"{where}.value", row["value"], "stands beside x, y, z", remedy)
    if node is None:
        return fault(f"{where}.node", None, "is missing", "name the node of each x, y, z triple")
    return None
