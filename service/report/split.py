"""The section on the inspection that would split a set that is not separable, or too many names."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from service.report.figures import label_of
from service.report.markup import Child, Markup, el
from service.report.svg import (
    LETTER,
    WIDE,
    Frame,
    Scale,
    line,
    path,
    picture,
    short,
    words,
)
from service.report.tables import figure, note, section, table
from service.report.verdict import IDLE
from service.report.words import joined, number, with_sd

Json = Mapping[str, Any]
CURVES = 5


def split(found: Json) -> Markup | None:
    """Which inspection tells the rivals apart; None where there are none."""
    title, told = "The inspection that would tell them apart", found.get("separating")
    if found["verdict"] != "not separable" and not told:
        return None
    if not told or not told["single"]:
        why = "It was not computed: an older release, or fewer than two could be calibrated."
        return section(title, note(why))
    best = told["single"][0]
    names = [" + ".join(r["names"]) for r in told["rivals"]]  # they stand in a sentence's list
    weights = [r["weight"] for r in told["rivals"]]
    now = sum(w**2 for w in weights) / sum(weights) ** 2  # what is expected of no reading
    parts: list[Child] = []
    if found["verdict"] == "unattributed":
        said = f"No name is claimed. The weightiest of many: {joined(names)}."
        parts.append(el("p", f"{said} What follows is said as if one of these were true."))
    if best["gain_nat"] < IDLE:
        said = "No single reading that was considered tells them apart: all expect the same of it."
        parts.append(el("p", said, class_="told"))
    else:
        said = f"Best single reading: {inspection(best)}. {promise(best, now)}"
        parts.append(el("p", said, class_="told"))
        parts.append(
            figure(
                curves(names, best),
                f"What each of them expects of that reading: {joined(_expected(names, best))}.",
            )
        )
    if told.get("campaigns"):
        parts += _everybody(told["campaigns"], now)
    if len(told["set"]) > 1:
        parts.append(el("h3", "Several readings"))
        parts.append(_set(told["set"]))
    rows = [
        [inspection(one), number(one["blades_alike"]), number(one["gain_nat"]),
         percent(one["share"]), percent(one["settled"])]
        for one in told["single"]
    ]  # fmt: skip
    head = ["one reading", "blades alike", "tells [nat]", "share of the true one", "settles it"]
    parts += [el("h3", "Every kind of reading"), table(head, rows, (1, 2, 3, 4))]
    there = {n for r in told["rivals"] for n in (*r["names"], *r.get("called", ()))}
    missing = [n for n in found["names"] if n not in there and n not in found.get("beside", ())]
    if missing:
        parts.append(note(f"Not among those told apart here: {joined(missing)}."))
    parts.append(
        note(
            f"There are {number(told['entropy_nat'])} nat to be told. Shares are of the evidence, "
            "as expected before the reading; it is settled where one has 90 %. Readings are taken "
            "for normal, and each counts as of a new campaign."
        )
    )
    return section(title, *parts)


def inspection(one: Json) -> str:
    """An inspection in words."""
    return f"{label_of(one['quantity'])} of blade {one['blade']}{_how(one)}"


def _how(one: Json) -> str:
    when = "now" if one["ahead_h"] == 0 else f"{number(one['ahead_h'])} h from now"
    who = {None: "", "another": " with another instrument"}.get(
        one["instrument"], f" with instrument {one['instrument']}"
    )
    return f"{who}, {when}"


def campaign(one: Json) -> str:
    """An inspection of all blades in words.

    >>> campaign({"quantity": "ceeq", "blades": 9, "nodes": None, "instrument": None, "ahead_h": 0})
    'creep strain (CEEQ) of 9 blades, now'
    """
    what = label_of(one["quantity"])
    if one["nodes"] is not None:
        what = f"3-D scan ({what} of {number(one['nodes'])} nodes)"
    return f"{what} of {number(one['blades'])} blades{_how(one)}"


def promise(one: Json, now: float) -> str:
    """What a reading promises."""
    return (
        f"It raises the expected share of the true one from {percent(now)} to "
        f"{percent(one['share'])} and settles the question in {percent(one['settled'])} of cases."
    )


def percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _expected(names: Sequence[str], one: Json) -> list[str]:
    unit = one["unit"]
    return [
        f"{name}: {with_sd(e['mean'], e['sd'])} {unit}"
        for name, e in zip(names, one["expected"], strict=True)
    ]


def _everybody(campaigns: Sequence[Json], now: float) -> list[Child]:
    """What reading every blade once promises."""
    best = campaigns[0]
    said = f"Best of all blades at once: {campaign(best)}. {promise(best, now)}"
    if best["gain_nat"] < IDLE:
        said = "Not even all blades together tell them apart, by any quantity."
    rows = [
        [campaign(one), number(one["gain_nat"]), percent(one["share"]), percent(one["settled"])]
        for one in campaigns
    ]
    head = ["every blade once", "tells [nat]", "share of the true one", "settles it"]
    told = el("p", said, class_="told")
    return [el("h3", "All blades at once"), told, table(head, rows, (1, 2, 3))]


def _set(grown: Sequence[Json]) -> Markup:
    rows = [
        [number(k + 1), inspection(one), number(one["gain_nat"]), percent(one["share"]),
         percent(one["settled"])]
        for k, one in enumerate(grown)
    ]  # fmt: skip
    head = ["", "and this one", "all so far tell [nat]", "share of the true one", "settle it"]
    return table(head, rows, (2, 3, 4))


def curves(names: Sequence[str], one: Json) -> Markup:
    """What rivals expect of a reading, as densities."""
    told = list(zip(names, one["expected"], strict=True))[:CURVES]
    low = min(e["mean"] - 4 * e["sd"] for _, e in told)
    high = max(e["mean"] + 4 * e["sd"] for _, e in told)
    top = max(1 / e["sd"] for _, e in told)
    head = 14.0 + 18.0 * len(told)
    x, y = Scale(low, high, 64.0, WIDE - 28), Scale(0.0, 1.06 * top, head + 130.0, head)
    title = f"{label_of(one['quantity'])} of blade {one['blade']} [{one['unit']}]"
    parts = [Frame(x, y, title, "density", grid_y=False).drawn(y_ticks=False)]
    for k, (name, e) in enumerate(told):
        level = 14.0 + 18.0 * k
        parts.append(line(66, level, 96, level, f"rival r{k}"))
        most = int((WIDE - 140) / LETTER)
        parts.append(words(102, level + 4, short(name, most), "tick"))
        at = [low + (high - low) * i / 200 for i in range(201)]
        points = [
            (x(v), y(math.exp(-0.5 * ((v - e["mean"]) / e["sd"]) ** 2) / e["sd"])) for v in at
        ]
        parts.append(path(points, f"rival r{k}"))
    return picture(head + 172, *parts, label="What each rival expects of the best reading")


def what_to_read(separating: Json | None) -> Iterator[str]:
    """The inspections that tell most of what shares the evidence; of one blade, of all of them."""
    if not separating:
        return
    ways = [("one reading", separating["single"], inspection)]
    ways += [("all blades", separating.get("campaigns"), campaign)]
    for what, found, said in ways:
        if found and found[0]["gain_nat"] >= IDLE:
            best = found[0]
            yield (
                f"  {what}, to tell more: {said(best)} (expected share of the true one "
                f"{percent(best['share'])}, settled in {percent(best['settled'])} of cases)"
            )
