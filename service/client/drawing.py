"""What pictures are drawn with: colours, limits, bands by source, readings, titles, legends, labels
of hours and of blades.

Colours are Okabe and Ito's, told apart without red and green. Legends stand beside the axes, where
they hide nothing. matplotlib is imported where it is needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

INK, SOFT, LINE = "#16202a", "#6b7480", "#0b4f7c"
LATE, LIMIT = "#b35900", "#8f2400"
SOURCES = {
    "parameters": ("model parameters", "#0072b2"),
    "discrepancy": ("discrepancy", "#009e73"),
    "surrogate": ("surrogate", "#e69f00"),
    "noise": ("a reading's noise", "#cc79a7"),
}
GROUPS = tuple(
    (colour, mark)
    for mark in "os"
    for colour in ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#000000")
)
MOST_LABELS = 24


def new_axes() -> Axes:
    from matplotlib import pyplot

    return pyplot.subplots(figsize=(6.4, 4.4), layout="constrained")[1]


def new_rows(count: int) -> list[Axes]:
    from matplotlib import pyplot

    size = (6.4, 0.5 + 0.55 * max(count, 1))
    _, rows = pyplot.subplots(max(count, 1), figsize=size, layout="constrained", squeeze=False)
    return list(rows[:count, 0])


def draw_limit(axes: Axes, limit: float | None, unit: str) -> None:
    if limit is not None:
        axes.axhline(limit, color=LIMIT, lw=1.2, ls="--", label=f"limit {limit:g} {unit}")


def draw_sources(axes: Axes, frame: DataFrame) -> None:
    """The band over the hours, source by source: from the inside out sds add in quadrature."""
    hours, mean = frame.index.to_numpy(), frame["mean"].to_numpy()
    sds = {source: frame[f"sd_{source}"].to_numpy() for source in SOURCES}
    total = np.sqrt(sum(sd**2 for sd in sds.values()))
    inner = np.zeros(len(hours))
    for source, sd in sds.items():
        if not np.any(sd > 0):
            continue
        outer = np.sqrt(inner**2 + sd**2)
        name, colour = SOURCES[source]
        for label, edge in ((name, frame["upper"]), (None, frame["lower"])):
            half = (edge.to_numpy() - mean) / np.where(total > 0, total, 1.0)
            axes.fill_between(
                hours, mean + half * inner, mean + half * outer,
                color=colour, alpha=0.4, lw=0, label=label,
            )  # fmt: skip
        inner = outer


def draw_readings(axes: Axes, frame: DataFrame, facts: Mapping[str, Any]) -> None:
    """Readings of the blade, each kind with a mark of its own."""
    own = frame[(frame["blade"] == facts["blade"]) & (frame["quantity"] == facts["quantity"])]
    own = own[own["value"].notna()]
    if facts["node"] is not None:
        own = own[own["node"] == facts["node"]]
    counts = own["status"] == "counts"
    kinds = (
        ("readings", own[counts & ~own["late"]], INK, "o", INK),
        ("late readings", own[counts & own["late"]], LATE, "^", LATE),
        ("replaced", own[own["status"] == "replaced"], SOFT, "s", "none"),
        ("retracted", own[own["status"] == "retracted"], SOFT, "x", SOFT),
    )
    for label, some, colour, mark, face in kinds:
        if len(some) == 0:
            continue
        told = " ± sigma" if "readings" in label and some["sigma"].notna().any() else ""
        axes.errorbar(
            some["time_h"], some["value"], yerr=some["sigma"].fillna(0.0),
            fmt=mark, ms=5, color=colour, mfc=face, elinewidth=1, capsize=2, label=label + told,
        )  # fmt: skip


def label_hours(axes: Axes) -> None:
    from matplotlib.ticker import StrMethodFormatter

    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.set_xlabel("operating hours [h]")


def legend(axes: Axes, title: str | None = None) -> None:
    """Beside the axes, where nothing is drawn."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            title=title, fontsize=8, title_fontsize=8, loc="upper left",
            bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, frameon=False,
        )  # fmt: skip


def title(axes: Axes, facts: Mapping[str, Any], what: str) -> None:
    """Rotor, version and what is shown; and where the state is not to be trusted, that."""
    version = (facts.get("rests_on") or facts.get("as_of") or {}).get("version")
    told = f"rotor {facts['rotor']}" + ("" if version is None else f", version {version}")
    health = facts.get("health") or {"trusted": True}
    warned = "" if health["trusted"] else f"\nnot to be trusted: {health['status']}"
    axes.set_title(f"{told}: {what}{warned}", fontsize=9, loc="left")


def label_blades(axes: Axes, frame: DataFrame) -> None:
    step = -(-len(frame) // MOST_LABELS) or 1
    names = [
        blade if slot == "" else f"{slot}: {blade}"
        for blade, slot in zip(frame.index, frame["slot"].fillna(""), strict=True)
    ]
    shown = np.arange(0, len(frame), step)
    upright = len(shown) > 6
    axes.set_xticks(shown, [names[i] for i in shown], rotation=90 if upright else 0, fontsize=8)
    axes.set_xlabel("blade, by slot" + ("" if step == 1 else f" (every {step}th has its name)"))
