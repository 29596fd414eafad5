"""Runs from a table: one line for each run and instant, the usual case without fields.

::

    run, time [h], roughness [um], drop [kPa]
    1,   0,        2.4,            0
    1,   500,      2.4,            1.31
    2,   0,        7.9,            0

The header has each column's unit in brackets. A column that keeps its value within every run is an
input, any other a quantity; `inputs` says it where that would guess wrong. The order of the lines
does not matter. Runs may have instants of their own. An empty cell is a value that is missing.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.archive.faults import Findings
from core.archive.source import Column, Given
from core.archive.write import write_runs
from core.errors import ModelError, UnitError
from core.units import hours, unit

Array = NDArray[np.float64]
HEADER = re.compile(r"\s*([A-Za-z_][\w.\-]*)\s*(?:\[([^\]]*)\])?\s*")
SAME = 1e-12
KEPT = ("points", "cells", "time_of_run", "parametric", "xyz", "node")  # `core.archive.reading`


@dataclass(frozen=True, slots=True)
class Table:
    """A table whose cells are numbers.

    units    by column, as the header has them ("" where it has none)
    labels   of the runs, in the order of their first line
    run      (L,) place in `labels` of each line; time_h (L,)
    columns  (L,) by name, NaN where a cell is empty; texts: the column `file`, where there is one
    """

    path: Path
    units: dict[str, str]
    labels: tuple[str, ...]
    run: NDArray[np.int64]
    time_h: Array
    columns: dict[str, Array]
    texts: dict[str, list[str]]


def read_table(path: str | Path) -> Table:
    """The table of a CSV file; RunsError lists every cell that is no number.

    Lines are ordered by run and time.
    """
    path, found = Path(path), Findings()
    try:
        with open(path, encoding="utf-8-sig", newline="") as handle:
            sample = handle.read(4096)
            handle.seek(0)
            divider = max(",;\t", key=sample.partition("\n")[0].count)
            reader = csv.reader(handle, delimiter=divider, strict=True)
            lines = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except UnicodeDecodeError as error:
        problem = f"{path} is no text in UTF-8, for it has a byte 0x{error.object[error.start]:02x}"
        raise ModelError(f"{problem}: save it as CSV in UTF-8 (it may be in Latin-1)") from error
    except (OSError, csv.Error) as error:
        raise ModelError(f"{path} cannot be read as CSV: {error}") from error
    if len(lines) < 2:
        raise ModelError(f"{path} holds no line below its header")
    units = _header(lines[0][1], found)
    names = list(units)
    factor = _hours(units, found)
    found.end()
    cells: dict[str, list[float]] = {n: [] for n in names if n not in ("run", "file")}
    texts: dict[str, list[str]] = {n: [] for n in ("run", "file") if n in names}
    for number, row in lines[1:]:
        if len(row) != len(names):
            problem = f"has not the {len(names)} cells of the header"
            found.fault(f"line {number}", len(row), problem, "give every cell, empty if need be")
            continue
        for name, cell in zip(names, map(str.strip, row), strict=True):
            if name in texts:
                texts[name].append(cell)
                if not cell:
                    found.fault(f"line {number}: {name}", "", "is empty", f"give the {name}")
            else:
                cells[name].append(_number(f"line {number}: {name}", cell, found))
    found.end()
    labels = tuple(dict.fromkeys(texts["run"]))
    place = {label: k for k, label in enumerate(labels)}
    run = np.array([place[label] for label in texts["run"]])
    time_h = np.array(cells.pop("time")) * factor
    for k in np.flatnonzero(~np.isfinite(time_h)):
        found.fault(f"line {lines[k + 1][0]}: time", float("nan"), "is no instant", "give it")
    order = np.lexsort((time_h, run))
    run, time_h = run[order], time_h[order]
    for k in np.flatnonzero((np.diff(run) == 0) & (np.diff(time_h) == 0)):
        problem = f"has two lines at {time_h[k]:g} h"
        found.fault(f"run {labels[run[k]]}", float(time_h[k]), problem, "keep one of them")
    found.end()
    columns = {name: np.array(values)[order] for name, values in cells.items()}
    told = {name: [values[i] for i in order] for name, values in texts.items() if name == "file"}
    return Table(path, units, labels, run, time_h, columns, told)


def _header(row: Sequence[str], found: Findings) -> dict[str, str]:
    units: dict[str, str] = {}
    for cell in row:
        match = HEADER.fullmatch(cell)
        if match is None:
            remedy = "write a name and its unit, as in drop [kPa]"
            found.fault("header", cell, "is no name of a column", remedy)
            continue
        name, text = match.group(1), match.group(2)
        name = "time" if name == "time_h" else name
        text = "h" if match.group(1) == "time_h" and text is None else text
        if name in units:
            found.fault("header", name, "names a column twice", "name each once")
        if name in KEPT:
            problem = "is a name that the format of runs keeps for itself"
            found.fault("header", name, problem, "rename the column")
        units[name] = "" if text is None else text.strip()
        if name in ("run", "file"):
            continue
        try:
            if text is None:
                raise UnitError("unit", None, "has no unit", f"write {name} [unit], [1] for none")
            unit(units[name])
        except UnitError as error:
            found.add(UnitError(f"column {name}", text, error.problem, error.remedy))
    for name in ("run", "time"):
        if name not in units:
            found.fault("header", name, "is missing among the columns", f"add a column {name}")
    return units


def _hours(units: dict[str, str], found: Findings) -> float:
    try:
        return hours(units.get("time", "h"))
    except UnitError as error:
        if not any(one.what == "column time" for one in found.faults):
            found.add(UnitError("column time", units["time"], error.problem, "write time [h]"))
        return 1.0


def _number(what: str, cell: str, found: Findings) -> float:
    if not cell or cell.lower() in ("nan", "na"):
        return float("nan")
    try:
        value = float(cell)
        if np.isfinite(value):
            return value
        found.fault(what, cell, "is not finite", "write the number, or leave it empty")
        return float("nan")
    except ValueError:
        found.fault(what, cell, "is no number", "write it with a decimal point, or leave it empty")
        return float("nan")


def split_columns(
    table: Table, inputs: Sequence[str] | None, found: Findings
) -> tuple[dict[str, Column], list[str]]:
    """Inputs with a value for each run, and the names of the other columns."""
    chosen, others = {}, []
    firsts = np.searchsorted(table.run, np.arange(len(table.labels)))
    for name in sorted(set(inputs or ()) - set(table.columns)):
        have = ", ".join(table.columns)
        found.fault("inputs", name, "is no column of the table", f"use some of {have}")
    for name, values in table.columns.items():
        at = values[firsts][table.run]
        moved = ~(np.abs(values - at) <= SAME * np.abs(at)) & ~(np.isnan(values) & np.isnan(at))
        given = inputs is not None and name in inputs
        if given and np.any(moved):
            k = int(np.flatnonzero(moved)[0])
            problem = (
                f"is {at[k]:g} at the run's first line, {values[k]:g} at {table.time_h[k]:g} h"
            )
            remedy = "an input has one value for each run"
            found.fault(f"run {table.labels[table.run[k]]}: {name}", None, problem, remedy)
        if given or (inputs is None and not np.any(moved)):
            chosen[name] = Column(table.units[name], None, None, values[firsts])
        else:
            others.append(name)
    return chosen, others


def by_run(table: Table, values: Array) -> Array:
    """A column (L,) as (n, T), NaN after a run's last line."""
    counts = np.bincount(table.run, minlength=len(table.labels))
    starts = np.cumsum(counts) - counts
    out = np.full((len(table.labels), int(counts.max())), np.nan)
    out[table.run, np.arange(len(values)) - starts[table.run]] = values
    return out


def times(table: Table) -> Array:
    """Hours (T,) that all runs share, or (n, T)."""
    own = by_run(table, table.time_h)
    return own[0] if np.all(own == own[0]) else own


def convert_table(
    path: str | Path, out: str | Path, *, inputs: Sequence[str] | None = None
) -> dict[str, object]:
    """Write the table's runs to `out`; what it took for inputs and quantities.

    Raises RunsError with every fault, ModelError for a file that is no table.
    """
    table, found = read_table(path), Findings()
    chosen, names = split_columns(table, inputs, found)
    if not names and not found.faults:
        remedy = "name the inputs, if a quantity happens to be constant in every run"
        found.fault("columns", None, "all keep their value within each run", remedy)
    if not chosen and not found.faults:
        found.fault("columns", None, "hold no input", "add one that says what a run was made with")
    found.end()
    wide = {name: by_run(table, table.columns[name]) for name in names}
    write_runs(
        out,
        labels=table.labels,
        inputs=chosen,
        quantities={name: Given(table.units[name], "scalar") for name in names},
        time_h=times(table),
        rows=({name: wide[name][k] for name in names} for k in range(len(table.labels))),
        source=table.path.name,
    )
    return {"runs": len(table.labels), "inputs": list(chosen), "quantities": names}
