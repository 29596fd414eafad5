"""The blades of a rotor as a table in the terminal (`bladetwin inspect`)."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator, Sequence
from itertools import compress
from typing import Any

from service.report.words import percent, with_sd

Told = dict[str, Any]
FEW_SD = 2.0
FEW = 0.023  # a chance: as normal, of a limit that is 2 sd off
ROUNDING = 1e-9  # an sd below this share of the mean: all particles have one value


def columns() -> int | None:
    """How many fit on a line of the terminal; None: it goes to a file or to another program."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def around(mean: float | None, sd: float | None) -> str:
    """Mean ± sd, to two digits of the sd as on the pages, with a minus that programs read.

    >>> around(-0.80973, 0.2712), around(0.36, 0.0584), around(1234.5, 20.0)
    ('-0.81 ± 0.27', '0.360 ± 0.058', '1,234 ± 20')
    >>> around(2 / 3, 1e-14)
    '0.667'
    """
    if mean is not None and sd is not None and sd < ROUNDING * abs(mean):
        sd = 0.0
    return with_sd(mean, sd).replace("−", "-")


def blade_lines(told: Told, width: int | None) -> Iterator[str]:
    """The blades as a table; a column in which no blade has anything is left out.

    Where lines would be broken what can be missed is left out, and that is said.
    """
    lines = [*_lines(told, short=False)]
    if width is None or max(map(len, lines)) <= width:
        yield from lines
        return
    yield from _lines(told, short=True)
    margins = ", margins" if "limit" in told["question"] else ""
    yield f"slots, lots{margins} and parameters are left out: the terminal has "
    yield f"{width} columns, and the whole table {max(map(len, lines))}"


def heading(asked: Told) -> str:
    """What is predicted, of a field at which node, and when.

    >>> asked = {"quantity": "deformation", "unit": "mm", "time_h": 16000.0}
    >>> heading(asked | {"node": 5440, "place": "tip", "vector": True})
    'deformation x, y, z [mm] at node 5440 (tip), 16,000 h'
    """
    of = f"{asked['quantity']}{' x, y, z' if asked.get('vector') else ''} [{asked['unit']}]"
    name = f" ({asked['place']})" if asked.get("place") else ""
    where = "" if asked["node"] is None else f"node {asked['node']}{name}, "
    return f"{of} at {where}{asked['time_h']:,.10g} h"


def _lines(told: Told, *, short: bool) -> Iterator[str]:
    asked, blades = told["question"], told["blades"]
    local = list(blades[0]["parameters"]) if blades and not short else []
    margin = "limit" in asked
    vector = bool(blades) and isinstance(blades[0]["prediction"]["mean"], list)
    what = heading(asked | {"vector": vector})
    if short:
        yield f"predicted: {what}"
    head = ["blade", "slot", "lot", "readings", "posted last, at [h]"]
    head.append("mean ± sd" if short else what)
    units = told["units"]
    named = [f"{name} [{units[name]}]" if name in units else name for name in local]
    of_limit = ["" if short else f"margin{' of z' if vector else ''} [sd]", "age [h]", "passed"]
    of_limit = of_limit if margin else []
    rows = [[*head, *of_limit, *named, ""]]
    for blade in blades:
        readings, last = blade["readings"], blade["readings"]["last"]
        place = ["", ""] if short else [blade["slot"] or "", blade["lot"] or ""]
        row = [blade["id"], *place, str(readings["counting"])]
        row += ["" if last is None else f"{last['time_h']:,.10g}", predicted(blade["prediction"])]
        left = blade.get("margin_sd")
        passed, age = blade.get("passed"), blade.get("age_h")
        row += ["" if left is None or short else f"{left:z.1f}"] if margin else []
        row += ["" if age is None else f"{age:,.10g}"] if margin else []
        row += ["" if passed is None else percent(passed)] if margin else []
        row += [around(one["mean"], one["sd"]) for one in map(blade["parameters"].get, local)]
        rows.append([*row, noted(blade, left)])
    used = [any(column) for column in zip(*rows[1:], strict=True)]
    yield from aligned([[*compress(row, used)] for row in rows])


def predicted(told: Told) -> str:
    """Mean ± sd of the blade itself; of a vector in its three directions.

    >>> predicted({"mean": 0.5, "sd": {"blade": 0.0123}})
    '0.500 ± 0.012'
    >>> predicted({"mean": [0.0, 1.0], "sd": {"blade": [0.0, 0.1]}})
    '0, 1.00 ± 0.10'
    """
    mean, sd = told["mean"], told["sd"]["blade"]
    if not isinstance(mean, list):
        mean, sd = [mean], [sd]
    return ", ".join(around(m, s) for m, s in zip(mean, sd, strict=True))


def noted(blade: Told, margin: float | None) -> str:
    """What to look at: of a limit its chance; of a blade that has left, which has none, its margin.

    >>> told = {"retired": False, "readings": {"counting": 2}}
    >>> noted(told | {"passed": 0.84}, -1.0), noted(told | {"passed": 0.1}, 3.0)
    ('beyond the limit (84 %)', 'limit passed with 10 %')
    >>> noted(told | {"passed": 0.01}, 1.5), noted(told | {"passed": None, "retired": True}, 1.5)
    ('', 'retired, limit within 2 sd')
    """
    notes = ["retired"] if blade["retired"] else []
    passed = blade.get("passed")
    if passed is not None:
        if passed >= FEW:
            beyond = margin is not None and margin < 0 and passed >= 0.5
            told = f"({percent(passed)})" if beyond else f"passed with {percent(passed)}"
            notes.append(f"{'beyond the limit' if beyond else 'limit'} {told}")
    elif margin is not None and margin < FEW_SD:
        notes.append("beyond the limit" if margin < 0 else f"limit within {FEW_SD:g} sd")
    if blade.get("age_by") == "reading":
        notes.append("age as of its last reading")
    if not blade["readings"]["counting"]:
        notes.append("no reading")
    return ", ".join(notes)


def aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows with columns under each other.

    >>> [*aligned([["a", "bcd"], ["ef", "g"]])]
    ['a   bcd', 'ef  g']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        yield "  ".join(cells).rstrip()
