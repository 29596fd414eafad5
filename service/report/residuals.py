"""Where the model is off: residuals by blade and inspection, hours, campaigns, instruments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from service.report import figures
from service.report.heat import heat, rows_of
from service.report.markup import Child, Markup, el
from service.report.sections import OLDER, SHOWN, changes
from service.report.tables import figure, note, section
from service.report.words import capital, counted, number

Json = Mapping[str, Any]
NOTICEABLE = 2.0  # nat
STANDS_OUT = 3.0  # of a group's mean z, in its standard errors


def residuals(found: Json) -> Markup:
    """z of every reading before and after: blade × inspection, hours, campaigns, instruments."""
    pictures, title = found.get("pictures"), "Residuals"
    if not pictures or not pictures["readings"]:
        return section(title, note(OLDER.format("its readings' residuals")))
    readings, changed = pictures["readings"], changes(found)
    said = (
        "Each reading is predicted from all the others, without itself; z is its distance from the "
        "prediction in sd. Where the model is right, 95 of 100 lie within ± 1.96, without a "
        "pattern."
    )
    rest = pictures["readings_not_shown"]
    parts: list[Child] = [el("p", said)]
    if rest:
        parts.append(note(f"{rest} readings of several values (scans) are not drawn."))
    again = " Where a blade was read twice at a visit, the larger one." * (
        len(
            {
                (r["blade"], v)
                for v, m in rows_of(readings).items()
                for r in (readings[i] for i in m)
            }
        )
        < len(readings)
    )
    for one in heat(readings, changed=changed):
        parts.append(figure(one, f"z by blade and inspection.{again}"))
    parts.append(figure(figures.over_hours(readings, changed=changed), "z over the rotor's hours."))
    for key in ("campaign", "instrument"):
        of_each: dict[str, dict[str, list[float]]] = {}
        for r in readings:
            name = r[key] if r[key] is not None else f"no {key} given"
            own = of_each.setdefault(name, {w: [] for w in figures.BOTH[: 1 + changed]})
            for w, z in own.items():
                z.append(r[w]["z"])
        if set(of_each) == {f"no {key} given"}:
            parts.append(note(f"No reading names its {key}."))
            continue
        extra = f" The {figures.ROWS} that stand out most." if len(of_each) > figures.ROWS else ""
        parts.append(figure(figures.groups(f"z by {key}", of_each), f"z by {key}.{extra}"))
    return section(title, *parts)


def known(found: Json) -> Markup | None:
    """Where nothing could be named: what is known all the same. None for the other verdicts."""
    if found["verdict"] != "unattributed":
        return None
    said = [el("li", capital(reason.removesuffix(".")) + ".") for reason in found["reasons"]]
    for one in found["tried"]:
        if one["what"].startswith("by ") and (one["log_bf"] or 0.0) >= NOTICEABLE:
            gain = f"{number(one['log_bf'])} nat"
            said.append(el("li", f"A misfit of any course {one['what']} gains {gain}."))
    for name, z in groups_of((found.get("pictures") or {}).get("readings", ())):
        mean = sum(z) / len(z)
        if abs(mean) * len(z) ** 0.5 >= STANDS_OUT:
            side = "above" if mean > 0 else "below"
            told = f"{counted(len(z), 'reading')} of {name} lie{'s' * (len(z) == 1)}"
            far = f"{number(abs(mean), 2)} sd {side} the model's prediction"
            said.append(el("li", f"{told} {far}{' on average' * (len(z) > 1)}."))
    return section("What is known", el("ul", *said[:SHOWN]))


def groups_of(readings: Sequence[Json]) -> list[tuple[str, list[float]]]:
    """z before by visit, instrument and blade, what stands out most first."""
    found = {f"visit {v}": [readings[i]["before"]["z"] for i in m]
             for v, m in rows_of(readings).items()}  # fmt: skip
    for key in ("instrument", "blade"):
        for r in readings:
            if r[key] is not None:
                found.setdefault(f"{key} {r[key]}", []).append(r["before"]["z"])
    return sorted(found.items(), key=lambda one: -abs(sum(one[1])) / len(one[1]) ** 0.5)
