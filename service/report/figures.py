"""The pictures of a report: residuals, amplitudes, evidence, p-values (`fleet`: forecasts).

`before` and `after` are the model as it was and with the effect in it; each has one colour
throughout, and in every picture another mark as well, for eyes and printers without colour.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import fmean, pstdev
from typing import Any

from service.report.markup import Markup, join
from service.report.svg import (
    LETTER,
    WIDE,
    Frame,
    Scale,
    band,
    block,
    dot,
    legend,
    line,
    padded,
    path,
    picture,
    short,
    words,
)

Json = Mapping[str, Any]
BOTH = ("before", "after")
SD = 1.96  # sds of 95 %
ROWS = 24  # most rows of a picture of groups
LABEL = 30  # letters of a row's label
STEEP = 2.5  # times the posterior's peak: of a prior that is higher no more is drawn


def named(which: str, *, changed: bool) -> str:
    """What a model is called: `before` where there is an `after`, else the model itself."""
    return which if changed else "the model"


def amplitude(one: Json, scale: float, unit: str) -> Markup:
    """An amplitude's prior and posterior, times a scale, in a unit (`words.unit_of`)."""
    x_values, prior, post = one["x"], one["prior_density"], one["density"]
    x = Scale(scale * x_values[0], scale * x_values[-1], 64.0, WIDE - 28)
    top = 1.08 * min(max(*prior, *post), STEEP * max(post))
    y = Scale(0.0, top, 170.0, 34.0)
    in_unit = f" [{unit}]" if unit else ""
    frame = Frame(x, y, f"amplitude of {one['name']}{in_unit}", "density", grid_y=False)
    at = [x(scale * v) for v in x_values]
    parts = [frame.drawn(y_ticks=False)]
    if x.low < 0 < x.high:
        parts.append(line(x(0.0), y.end, x(0.0), y.start, "zero"))
    parts.append(band(at, [y.start] * len(at), [y(v) for v in post], "after area"))
    parts.append(path(list(zip(at, (y(v) for v in post), strict=True)), "after course"))
    low_part = [(x_at, y(min(v, top))) for x_at, v in zip(at, prior, strict=True)]
    parts.append(path(low_part, "prior course"))
    low, _, high = (x(scale * q) for q in one["quantiles"])
    parts.append(block(low, y.start - 4, high - low, 4, "after mark"))
    entries = [("prior mark", "prior"), ("after area", "posterior"), ("after mark", "95 % of it")]
    parts.append(legend(66, 20, entries))
    return picture(210, *parts, label=f"Prior and posterior of {one['name']}")


def groups(title: str, rows: Mapping[str, Mapping[str, Sequence[float]]]) -> Markup:
    """z of readings by group, before and after: each reading, and the mean ± 1.96 se of a group.

    rows  {group: {"before": z, "after": z}}; where there are more than `ROWS`, those that stand
          out most before
    """
    order = list(rows)
    if len(order) > ROWS:
        loud = sorted(order, key=lambda g: -_loud(rows[g]["before"]))[:ROWS]
        order = [g for g in order if g in loud]
    several = "after" in next(iter(rows.values()))
    tall, top = 34.0 if several else 22.0, 34.0
    end = top + tall * len(order)
    most = max(3.5, *(min(6.0, abs(z)) for g in order for own in rows[g].values() for z in own))
    left = 24 + LETTER * max(len(short(g, LABEL)) for g in order)
    x = Scale(-most, most, left, WIDE - 12)
    frame = Frame(x, Scale(0.0, 1.0, end, top), "z = (reading − prediction) / sd", grid_y=False)
    parts = [frame.drawn(y_ticks=False)]
    parts += [line(x(v), top, x(v), end, "limit") for v in (-SD, SD)]
    parts.append(line(x(0.0), top, x(0.0), end, "zero"))
    for k, group in enumerate(order):
        if k:
            parts.append(line(left, top + k * tall, WIDE - 12, top + k * tall, "grid"))
        parts.append(
            words(left - 8, top + (k + 0.5) * tall + 4, short(group, LABEL), "tick", "end")
        )
        for j, which in enumerate(BOTH[: len(rows[group])]):
            level = top + k * tall + tall * (0.5 if not several else (0.3, 0.7)[j])
            parts += _strip(x, level, rows[group][which], which, most)
    entries = [
        (f"{w} mark", f"{named(w, changed=several)}: mean of the group ± 1.96 se")
        for w in BOTH[: 1 + several]
    ]
    parts.append(legend(left, 20, [*entries, ("limit mark", "± 1.96")]))
    return picture(end + 42, *parts, label=title)


def _loud(z: Sequence[float]) -> float:
    return abs(fmean(z)) * math.sqrt(len(z))


def _strip(x: Scale, level: float, z: Sequence[float], which: str, most: float) -> list[Markup]:
    parts = [dot(x(max(-most, min(most, v))), level, f"{which} ring", 2.4) for v in z]
    mean = fmean(z)
    error = SD * max(pstdev(z) if len(z) > 2 else 1.0, 0.3) / math.sqrt(len(z))
    ends = max(-most, mean - error), min(most, mean + error)
    parts.append(block(x(ends[0]), level - 2.5, x(ends[1]) - x(ends[0]), 5, f"{which} bar"))
    parts.append(block(x(mean) - 1.5, level - 6, 3, 12, f"{which} mark"))
    return parts


def over_hours(readings: Sequence[Json], *, changed: bool) -> Markup:
    """z against the rotor's hours: before, and after beside it."""
    which = BOTH if changed else BOTH[:1]
    top, end = 34.0, 220.0
    hours = padded([0.0, *(r["rotor_h"] for r in readings)], 0.03)
    every = [min(6.0, abs(r[w]["z"])) for w in which for r in readings]
    most = max(3.5, *every)
    gap = 46.0
    wide = (WIDE - 20 - 64 - gap * (len(which) - 1)) / len(which)
    parts: list[Markup] = []
    for j, w in enumerate(which):
        left = 64 + j * (wide + gap)
        x, y = Scale(*hours, left, left + wide), Scale(-most, most, end, top)
        title = "z = (reading − prediction) / sd" if j == 0 else ""
        parts.append(Frame(x, y, "hours of the rotor [h]", title).drawn())
        parts += [line(left, y(v), left + wide, y(v), "limit") for v in (-SD, SD)]
        parts.append(line(left, y(0.0), left + wide, y(0.0), "zero"))
        parts.append(words(left + 4, top - 10, named(w, changed=changed), f"{w} head"))
        for r in readings:
            z = max(-most, min(most, r[w]["z"]))
            where = f"{r['id']}: z = {r[w]['z']:.2f}"
            parts.append(dot(x(r["rotor_h"]), y(z), f"{w} ring", 2.4, where))
    return picture(end + 42, *parts, label="z of every reading against the rotor's hours")


def bars(title: str, axis: str, values: Sequence[tuple[str, float]], *, share: bool) -> Markup:
    """Horizontal bars with their numbers; a share runs to 100 %."""
    left = 24 + LETTER * min(52, max(len(name) for name, _ in values))
    high = 100.0 if share else max(1.0, *(v for _, v in values))
    low = 0.0 if share else min(0.0, *(v for _, v in values))
    room = 0.0 if share else 0.02 * (high - low)
    x = Scale(low - (room if low < 0 else 0.0), high + room, left, WIDE - 64)
    top, tall = 8.0, 22.0
    end = top + tall * len(values)
    frame = Frame(x, Scale(0.0, 1.0, end, top), axis, grid_y=False)
    parts = [frame.drawn(y_ticks=False)]
    for k, (name, value) in enumerate(values):
        level = top + k * tall
        parts.append(words(left - 8, level + 15, short(name, 52), "tick", "end"))
        a, b = sorted((x(0.0), x(max(low, min(high, value)))))
        parts.append(block(a, level + 4, b - a, tall - 8, "after bar", name))
        said = f"{value:.0f} %" if share else f"{value:+z.1f}".replace("-", "−")
        parts.append(words(WIDE - 58, level + 15, said, "tick"))
    if low < 0:
        parts.append(line(x(0.0), top, x(0.0), end, "zero"))
    return picture(end + 40, *parts, label=title)


def p_values(rows: Sequence[tuple[str, float, float]]) -> Markup:
    """Probabilities on a logarithmic axis, each with the level below which it alarms."""
    left = 24 + LETTER * max(len(name) for name, _, _ in rows)
    x = Scale(0.001, 1.0, left, WIDE - 64, log=True)
    top, tall = 8.0, 26.0
    end = top + tall * len(rows)
    frame = Frame(
        x, Scale(0.0, 1.0, end, top), "p: so large a misfit comes by chance", grid_y=False
    )
    parts = [frame.drawn(y_ticks=False)]
    for k, (name, p, alarm) in enumerate(rows):
        level = top + (k + 0.5) * tall
        at = x(min(1.0, max(0.001, p)))
        parts.append(words(left - 8, level + 4, name, "tick", "end"))
        parts.append(line(x(1.0), level, at, level, "stem"))
        parts.append(dot(at, level, "alarm mark" if p <= alarm else "after mark", 4.5))
        parts.append(line(x(alarm), level - 9, x(alarm), level + 9, "level"))
        parts.append(words(WIDE - 58, level + 4, f"{p:.3g}", "tick"))
    parts.append(legend(left, end + 50, [("level-mark", "level below which it alarms")]))
    return picture(end + 60, *parts, label="p-values before and after")


def label_of(quantity: str) -> str:
    """A quantity as an axis names it."""
    told = {"elongation": "permanent tip elongation", "ceeq": "creep strain (CEEQ)"}
    return told.get(quantity, quantity.replace("_", " "))


__all__ = ["amplitude", "bars", "groups", "join", "label_of", "over_hours", "p_values"]
