"""Whether an effect holds in conditions that were never read (`core.diagnosis.transfer`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from service.report.markup import Child, Markup, el
from service.report.tables import cell, note, section, table
from service.report.words import number

Json = Mapping[str, Any]


def conditions(found: Json) -> Markup | None:
    """A row for each condition; None where blades do not differ in a known input."""
    told = found.get("conditions")
    if not told:
        return None
    rows: list[list[Child]] = []
    for one in told:
        a, b = one["before"], one["after"]
        kind, word = ("better", "holds") if one["holds"] else ("worse", "does not hold")
        rows.append(
            [
                f"{one['input'].replace('_', ' ')} {number(one['value'])}",
                str(len(one["blades"])),
                number(a["count"]),
                number(a["rmse"]),
                cell(number(b["rmse"]), numeric=True, kind=kind),
                number(a["within_95"], 2),
                number(b["within_95"], 2),
                word,
            ]
        )
    head = ["left out", "blades", "readings", "error before", "after"]
    head += ["inside 95 % before", "after", ""]
    said = (
        "Both models were calibrated without any reading of the blades in one condition, and then "
        "predicted these readings (RMSE of the predictions' medians, in the readings' unit)."
    )
    parts: list[Child] = [el("p", said), table(head, rows, (1, 2, 3, 4, 5, 6))]
    if not all(one["holds"] for one in told):
        parts.append(note("Do not extrapolate with the effect to conditions where it fails."))
    return section("In conditions that were never read", *parts)
