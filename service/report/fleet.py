"""The picture of a forecast: the blades' mean over the hours, before and after."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from service.report.figures import BOTH, label_of, named
from service.report.markup import Markup
from service.report.svg import WIDE, Frame, Scale, band, dot, legend, padded, path, picture

Json = Mapping[str, Any]


def fleet(
    courses: Json, readings: Sequence[Json], *, changed: bool, until: float | None = None
) -> Markup:
    """The blades' mean and a blade's ± 1 sd over the hours, with the readings.

    until  hour of the forecast; none: twice that of the last reading. What was read is drawn
           whatever it is
    """
    quantity, unit = courses["quantity"], courses["unit"]
    shown = [r for r in readings if r["quantity"] == quantity]
    last = max((r["time_h"] for r in shown), default=0.0)
    count = _reaching(courses["time_h"], max(last, until or 2.0 * last))
    hours = courses["time_h"][:count]
    told = {k: _mean_course(courses[k], count) for k in (BOTH if changed else BOTH[:1])}
    ends = [r["value"] for r in shown]
    for mean, sd in told.values():
        ends += [m + s for m, s in zip(mean, sd, strict=True)] + [mean[0]]
    low, high = padded([0.0, *ends])
    x = Scale(0.0, hours[-1], 64.0, WIDE - 28)
    frame = Frame(x, Scale(low, high, 290.0, 34.0), "operating hours of the blade [h]",
                  f"{label_of(quantity)} [{unit}]")  # fmt: skip
    parts: list[Markup] = [frame.drawn()]
    at = [x(h) for h in hours]
    for which, (mean, sd) in told.items():
        ups = [frame.y(m + s) for m, s in zip(mean, sd, strict=True)]
        downs = [frame.y(max(low, m - s)) for m, s in zip(mean, sd, strict=True)]
        parts.append(band(at, downs, ups, f"{which} area"))
        line_ = list(zip(at, (frame.y(m) for m in mean), strict=True))
        parts.append(path(line_, f"{which} course"))
    for r in shown:
        where = f"{r['id']}: {r['blade']}, {r['time_h']:,.0f} h, {r['value']:.4g} {unit}"
        parts.append(dot(x(r["time_h"]), frame.y(r["value"]), "reading", 2.0, where))
    entries = [(f"{w} area", named(w, changed=changed)) for w in told]
    what = ("", "line and band: mean of the blades ± 1 sd of a blade")
    parts.append(legend(66, 20, [*entries, ("reading", "readings"), what]))
    return picture(330, *parts, label=f"Fleet mean of {quantity} over hours with readings")


def _reaching(hours: Sequence[float], until: float) -> int:
    """How many of the hours it takes to reach one; all where none does, or nothing is asked.

    >>> [_reaching([0.0, 10.0, 20.0, 30.0], until) for until in (15.0, 20.0, 40.0, 0.0)]
    [3, 3, 4, 4]
    """
    if until <= 0:
        return len(hours)
    return next((k + 1 for k, hour in enumerate(hours) if hour >= until and k), len(hours))


def _mean_course(course: Json, count: int) -> tuple[list[float], list[float]]:
    mean = [fmean(column) for column in list(zip(*course["mean"], strict=True))[:count]]
    own = list(zip(*course["sd"], strict=True))[:count]
    return mean, [math.sqrt(fmean(v * v for v in column)) for column in own]
