"""Sections of a report, each from the diagnosis' JSON; without its data it says what is missing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from service.report import figures
from service.report.fleet import fleet
from service.report.life import Life, lives
from service.report.markup import Child, Markup, el
from service.report.tables import cell, figure, note, section, table
from service.report.verdict import claims
from service.report.words import capital, counted, joined, number, sentence, unit_of, with_sd

Json = Mapping[str, Any]
ALARM, LEFT, CONFIRMED, NAMED = 0.05, 0.01, 5.0, 0.90  # of core.diagnosis.verdict
ALLOWED = 0.05  # of core.diagnosis.placebos
SHOWN = 12
BY_ALL = "calibrated with all readings"
OF_ANOTHER = (
    "Scores of readings that neither model used, and the digest after, are of the discrepancy that "
    "names no cause."
)
OLDER = "This diagnosis was made by a release that did not keep {}. Ask for a new one to have them."


def effects(found: Json) -> Markup:
    """Effects with amplitude, band and what they mean."""
    pictures = found.get("pictures") or {}
    told = {one["name"]: one for one in pictures.get("amplitudes", ())}
    model = found["rests_on"]["model"]
    title = "The effect" if len(found["effects"]) == 1 else "The effects"
    if not found["claimed"]:
        title = "Effects that were calibrated, not claimed"
    if not found["effects"]:
        return section("Effects", el("p", "No effect was put into the model."))
    parts: list[Child] = []
    _, open_ = claims(found)
    for one in found["effects"]:
        known = told.get(one["name"])
        parts.append(el("h3", one["name"]))
        parts.append(el("p", capital(sentence(one, known and known["unit"], model)) + "."))
        unclaimed = " In the model, not claimed." if found["claimed"] and one in open_ else ""
        parts.append(note(f"{one['words']}. Kind: {one['kind']}.{unclaimed}"))
        if known is None:
            continue
        scale, unit = unit_of(one, known["unit"], model)
        low, middle, high = (f"{number(scale * q)} {unit}".strip() for q in known["quantiles"])
        said = f"Median {middle}, 95 % between {low} and {high}."
        if known["at_bound"]:
            side = {"low": "lower", "high": "upper"}[known["at_bound"]]
            said += f" It leans on its {side} bound and would go on beyond it if it could."
        parts.append(figure(figures.amplitude(known, scale, unit), said))
    if not told:
        parts.append(note(OLDER.format("the amplitudes' densities")))
    parts.append(el("p", f"Log evidence gained by all of it: {number(found['gained_nat'])} nat."))
    if tried := on_trial(found):
        parts.append(el("p", tried))
    return section(title, *parts)


def on_trial(found: Json) -> str:
    """That `after` is the model with effects that nobody claims; nothing where they are claimed."""
    if found["claimed"] or not changes(found):
        return ""
    names = joined([one["name"] for one in found["effects"]])
    said = f"Where this report says after, {names} would be in the model: that is not claimed."
    if found["before_after"] is None:
        return said
    return f"{said} {OF_ANOTHER}"


def before_after(found: Json) -> Markup:
    """Both models on readings that neither used."""
    title = "Before and after, on readings that neither model used"
    if (compared := found["before_after"]) is None:
        return section(title, el("p", f"Not compared: {_not_compared(found)}."))
    a, b = compared["before"], compared["after"]
    unit = (found.get("pictures") or {}).get("courses") or {}
    unit = unit["unit"] if unit.get("quantity") == compared["quantity"] else ""
    in_unit = f" [{unit}]" if unit else ""
    rows: list[list[Child]] = []
    for key, what, digits, good in (
        ("rmse", f"RMSE{in_unit}", 3, "less"),
        ("bias", f"bias, prediction − reading{in_unit}", 3, "near 0"),
        ("log_score", "log score [nat per reading]", 3, "more"),
        ("within_68", "inside the 68 % band", 2, "near 0.68"),
        ("within_95", "inside the 95 % band", 2, "near 0.95"),
        ("width", f"width of the 95 % band{in_unit}", 3, "narrow, at a right coverage"),
    ):
        better = improved(key, a[key], b[key])
        kind = "" if better is None else "better" if better else "worse"
        told = "–" if better is None else "better" if better else "worse"
        after = cell(number(b[key], digits), numeric=True, kind=kind)
        rows.append([what, number(a[key], digits), after, good, told])
    forecast = compared["forecast"]
    what = f"{compared['quantity']} at {number(forecast['time_h'])} h{in_unit}"
    at = f"forecast: blades' mean {what} ± sd of a single blade"
    ahead = [with_sd(forecast[w]["mean"], forecast[w]["sd"]) for w in figures.BOTH]
    rows.append([at, *ahead, "", "moves by " + number(_moved(forecast))])
    many = f"{counted(a['count'], 'reading')} of {compared['quantity']}"
    said = (
        f"{many}, the latest third of every second blade's: both models were calibrated without "
        f"them, and then predicted them; the forecast is theirs, too. {_after(found)}"
    )
    held = {w: [z for z in compared[w]["z"] if z is not None] for w in figures.BOTH}
    strips = figures.groups("z of held-out readings", {"held out": held})
    return section(
        title, el("p", said), table(["", "before", "after", "good is", ""], rows, (1, 2)),
        figure(strips, "Held-out readings: how many sd each lies from its prediction."),
    )  # fmt: skip


def _not_compared(found: Json) -> str:
    """Why there is no comparison: nothing to compare with, not wanted, or nothing left out."""
    wide = found.get("widened") or {}
    if not (found["claimed"] or wide.get("borne_out")):
        return "there is no other model, as no effect is claimed"
    return (
        "it was not asked for, or too little was read: two blades at least have to be read at two "
        "hours or more, by single values"
    )


def _after(found: Json) -> str:
    """What `after` is here, and what the scores do not test."""
    if found["claimed"]:
        return (
            "Which effect is in the model after was chosen by all readings, these among them: they "
            "test its size and the forecast, not the choice."
        )
    return (
        "After is the model with a discrepancy that names no cause, whose size all readings gave."
    )


def improved(key: str, before: float | None, after: float | None) -> bool | None:
    """Whether a score got better; None: it did not change, or is not known, or cannot tell alone.

    >>> improved("rmse", 2.0, 1.0), improved("log_score", 2.0, 1.0), improved("within_95", 1.0, 0.9)
    (True, False, None)
    """
    if before is None or after is None or before == after or key == "width":
        return None
    target = {"bias": 0.0, "within_68": 0.68, "within_95": 0.95}
    if key in target:
        off = abs(before - target[key]), abs(after - target[key])
        return None if abs(off[0] - off[1]) < 1e-9 else off[1] < off[0]
    return after > before if key == "log_score" else after < before


def _moved(forecast: Json) -> float | None:
    a, b = forecast["before"]["mean"], forecast["after"]["mean"]
    return None if a is None or b is None else b - a


def life(found: Json, limit: float | None) -> Markup | None:
    """Hours until the limit, before and after; None where no limit is given."""
    if limit is None:
        return None
    courses = (found.get("pictures") or {}).get("courses")
    title = "Remaining life"
    if courses is None:
        return section(title, note(OLDER.format("the blades' courses")))
    every = lives(courses, found["pictures"]["readings"], limit)
    reach = number(courses["time_h"][-1])
    what = f"{number(limit)} {courses['unit']} of {figures.label_of(courses['quantity'])}"
    parts: list[Child] = [
        el(
            "p",
            f"Limit: {what}. The model covers {reach} h; a blade that does not pass the limit by "
            "then is shown as beyond.",
        )
    ]
    both, moved = changes(found), [one.moved_h for one in every if one.moved_h is not None]
    if both and moved:
        parts.append(
            el(
                "p",
                f"On average over {counted(len(moved), 'blade')} with a median that passes it in "
                f"both models, the median hour moves by {number(sum(moved) / len(moved))} h, at "
                f"most by {number(max(moved, key=abs))} h.",
            )
        )
    if tried := on_trial(found):
        parts.append(el("p", tried))
    rows = [
        [one.blade, number(one.now_h) if one.now_h else "not read", _hours(one.before, one.now_h)]
        + both * [_hours(one.after, one.now_h), number(one.moved_h)]
        for one in every[:SHOWN]
    ]
    head = ["blade", "hours when last read", "hours left from then"]
    if both:
        head[2:] = ["hours left from then, before", "after", "its median hour moves by [h]"]
    parts.append(table(head, rows, (1, 4)))
    first = f"The {SHOWN} of {len(every)} blades that pass first. " * (len(every) > SHOWN)
    parts.append(note(f"{first}Median and, in brackets, 95 % of the hours left, {BY_ALL}."))
    return section(title, *parts)


def _hours(one: Life, now: float) -> str:
    def left(hour: float | None) -> str:
        return "beyond" if hour is None else number(max(0.0, hour - now))

    return f"{left(one.median)} ({left(one.early)} … {left(one.late)})"


def changes(found: Json) -> bool:
    """Whether a model with effects stands beside the one as it was."""
    return bool(found["effects"])


def forecast(found: Json) -> Markup:
    """The blades' mean over the hours by both models."""
    pictures, title = found.get("pictures"), "Forecast"
    if not pictures or not pictures["courses"]:
        return section(title, note(OLDER.format("the blades' courses")))
    until = (found["before_after"] or {}).get("forecast", {}).get("time_h")
    courses, read = pictures["courses"], pictures["readings"]
    drawn = fleet(courses, read, changed=changes(found), until=until)
    count = counted(len(pictures["courses"]["blades"]), "blade")
    said = f"Mean over {count} and the band of a single one, ± 1 sd, {BY_ALL}."
    if changes(found) and found["before_after"] is not None:
        said += " The table's forecast, by models without the held-out readings, may lie elsewhere."
    return section(title, figure(drawn, f"{said} {on_trial(found)}".strip()))
