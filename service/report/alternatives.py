"""The section on what else the readings allow: forecasts by other courses, or other causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from service.report.figures import SD, label_of
from service.report.markup import Markup, el
from service.report.split import percent
from service.report.svg import (
    LETTER,
    WIDE,
    Frame,
    Scale,
    block,
    legend,
    line,
    padded,
    picture,
    short,
    words,
)
from service.report.tables import figure, note, section, table
from service.report.words import joined, number, with_sd

Json = Mapping[str, Any]
LABEL = 48  # letters of a row's label
AS_IT_WAS, TOGETHER = "the model as it was", "all of them together"


def alternatives(found: Json) -> Markup | None:
    """Forecasts by each rival and by all together; None where there is one only."""
    told = found.get("alternatives")
    if not told:
        return None
    unit = ((found.get("pictures") or {}).get("courses") or {}).get("unit", "")
    in_unit = f" [{unit}]" if unit else ""
    what = f"{label_of(told['quantity'])} at {number(told['time_h'])} h{in_unit}"
    rows = [(AS_IT_WAS, None, told["before"])]
    rows += [(name, one["share"], one) for name, one in zip(names(told), told["each"], strict=True)]
    rows.append((TOGETHER, None, told["together"]))
    count = len(told["blades"])
    said = (
        f"The readings allow these of what was calibrated, by their shares of the evidence. They "
        f"differ in what they foretell of {count} blade{'s' * (count != 1)} on the rotor."
    )
    if found["verdict"] == "effect":
        said += (
            " An adoption puts the effects of this diagnosis into the model, and foretells by "
            "these alone."
        )
    elif "adoption" in told["each"][0]:
        said += (
            " None is claimed. Who knows from elsewhere which it is, by a borescope, say, may "
            "adopt it by its number, with the reason."
        )
    return section(
        "What else the readings allow",
        el("p", said),
        table(
            ["number", "", "share", f"mean {what}"],
            [
                [str(one.get("number", "–")), name, "–" if share is None else percent(share),
                 with_sd(one["mean"], one["sd"])]
                for name, share, one in rows
            ],
            (0, 2, 3),
        ),
        figure(
            intervals(rows, f"mean {what}"),
            "Mean of these blades, 95 % of a single one, and shares of the evidence.",
        ),
        note("What was not calibrated has no share here."),
    )  # fmt: skip


def names(told: Json) -> list[str]:
    """Each rival by the effects that not all of them have; by all of its own, where one has no
    other.

    >>> names({"each": [{"effects": [{"name": "wear", "shape": "linear", "step_h": None}]},
    ...                 {"effects": [{"name": "wear", "shape": "late", "step_h": None}]}]})
    ['wear, linear', 'wear, late']
    >>> gas, oven = ({"name": n, "shape": "constant", "step_h": None} for n in ("gas", "oven"))
    >>> names({"each": [{"effects": [gas, oven]}, {"effects": [gas]}]})
    ['gas, constant and oven, constant', 'gas, constant']
    """
    every = [[called(e) for e in one["effects"]] for one in told["each"]]
    common = set.intersection(*map(set, every))
    apart = [[e for e in one if e not in common] for one in every]
    return [joined(one) for one in (apart if all(apart) else every)]


def hypothesis(one: Json) -> str:
    """A calibrated one by its effects and their courses, for several may be of one name; by names
    where an older release made it."""
    return joined([called(e) for e in one.get("effects", ())] or one["names"])


def called(effect: Json) -> str:
    """An effect with its course before whom it concerns."""
    hour = effect["step_h"]
    when = f", {effect['shape']}" if hour is None else f" at {number(hour)} h"
    what, bracket, whom = effect["name"].partition(" (")
    return f"{what}{when}{bracket}{whom}"


def intervals(rows: Sequence[tuple[str, float | None, Json]], title: str) -> Markup:
    """Means and ± 1.96 sds, a row each: name, share, forecast."""
    left = 24 + LETTER * max(len(short(name, LABEL)) for name, _, _ in rows)
    ends = [one["mean"] + s * SD * one["sd"] for _, _, one in rows for s in (-1, 1)]
    low, high = padded(ends)
    top, tall = 34.0, 26.0
    end = top + tall * len(rows)
    x = Scale(low, high, left, WIDE - 52)
    parts = [Frame(x, Scale(0.0, 1.0, end, top), title, grid_y=False).drawn(y_ticks=False)]
    for k, (name, share, one) in enumerate(rows):
        level, which = top + tall * (k + 0.5), "before" if name == AS_IT_WAS else "after"
        mean, sd = one["mean"], one["sd"]
        parts.append(words(left - 8, level + 4, short(name, LABEL), "tick", "end"))
        parts.append(line(x(mean - SD * sd), level, x(mean + SD * sd), level, f"{which} course"))
        high_, size = (8.0, 4.0) if name == TOGETHER else (5.0, 3.0)
        parts.append(block(x(mean) - size / 2, level - high_, size, 2 * high_, f"{which} mark"))
        if share is not None:
            parts.append(words(WIDE - 46, level + 4, percent(share), "tick"))
    parts.append(
        legend(left, 20, [("before mark", "without effects"), ("after mark", "with effects")])
    )
    return picture(end + 42, *parts, label="Forecasts by what else the readings allow")
