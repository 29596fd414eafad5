"""Pictures of the contest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from core.surrogate.contest.score import Errors
from core.surrogate.contest.trial import TEST, Trial

Trials = Mapping[str, Mapping[str, Mapping[str, Trial]]]
COLUMNS = 4
COLOURS = {"raw": "#b4652a", "transformed": "#1f3b63"}
PLAIN = StrMethodFormatter("{x:g}")
MARKS = {"median": "o", "p95": "s"}


def tip_plot(found: Trials, rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """True against predicted tip elongation at the last instant, of runs that were left out."""
    names = list(dict.fromkeys(row["name"] for row in rows if not row["control"]))
    lines = -(-len(names) // COLUMNS)
    figure, axes = plt.subplots(
        lines, COLUMNS, figsize=(12, 3.1 * lines + 0.7), squeeze=False, layout="constrained"
    )
    for axis in axes.ravel()[len(names) :]:
        axis.set_visible(False)
    every = np.concatenate([end_of(found, which, name) for which in found for name in names])
    low, high = 0.85 * every[:, 0].min(), 1.18 * every[:, 0].max()
    for axis, name in zip(axes.ravel(), names, strict=False):
        axis.plot([low, high], [low, high], color="0.6", lw=0.8)
        for which, colour in COLOURS.items():
            true, told = end_of(found, which, name).T
            outside = int(np.sum((told < low) | (told > high)))
            label = which if not outside else f"{which} ({outside} outside)"
            axis.plot(true, told, "o", ms=3, alpha=0.75, color=colour, label=label, mew=0)
        axis.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high))
        for one in (axis.xaxis, axis.yaxis):
            one.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            one.set_major_formatter(PLAIN)
            one.set_minor_formatter(NullFormatter())
        axis.set_title(name, fontsize=10)
        axis.legend(fontsize=7, loc="upper left", frameon=False)
        axis.tick_params(labelsize=8)
        axis.set_aspect("equal")
    for axis in axes[:, 0]:
        axis.set_ylabel("predicted [mm]", fontsize=9)
    for axis in axes.ravel()[max(len(names) - COLUMNS, 0) : len(names)]:
        axis.set_xlabel("finite elements [mm]", fontsize=9)
    figure.suptitle(
        "Tip elongation at the last instant: runs left out of cross-validation", fontsize=11
    )
    figure.savefig(path, dpi=120)
    plt.close(figure)


def end_of(found: Trials, which: str, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """True and predicted tip elongation of every run that a fold left out, (n, 2)."""
    parts = [t.errors for fold, t in found[which][name].items() if fold != TEST]
    return Errors.joined(parts).end


def error_plot(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Errors of tip and worst node in cross-validation and on independent runs, logarithmic."""
    names = list(dict.fromkeys(row["name"] for row in rows))
    place = {name: len(names) - k for k, name in enumerate(names)}
    figure, axes = plt.subplots(
        1, 3, figsize=(13, 0.42 * len(names) + 1.9), sharey=True, layout="constrained"
    )
    panels = (
        ("tip", "tip elongation from 1000 h [%]"),
        ("ceeq", "CEEQ at the worst node from 1000 h [%]"),
        ("field", "deformation, rms [mm]"),
    )
    for axis, (what, label) in zip(axes, panels, strict=True):
        for row in rows:
            y = place[row["name"]] + (0.16 if row["targets"] == "raw" else -0.16)
            colour = COLOURS[row["targets"]]
            for key, filled in (("cross_validation", True), ("independent", False)):
                told, face = row[key], colour if filled else "white"
                if what == "field":
                    axis.plot(told["field_rmse_mm"], y, "D", ms=5, mec=colour, mfc=face)
                    continue
                ends = [told[f"{what}_{part}_percent"] for part in MARKS]
                if filled:
                    axis.plot(ends, [y, y], color=colour, lw=1)
                for end, mark in zip(ends, MARKS.values(), strict=True):
                    axis.plot(end, y, mark, ms=5, mec=colour, mfc=face)
        axis.set_xscale("log")
        axis.xaxis.set_major_formatter(PLAIN)
        axis.set_xlabel(label, fontsize=9)
        axis.grid(axis="x", color="0.88", lw=0.6)
        axis.set_axisbelow(True)
        axis.tick_params(labelsize=8)
    axes[0].set_yticks(list(place.values()), list(place), fontsize=9)
    for which, colour in COLOURS.items():
        axes[0].plot([], [], "o", color=colour, label=f"{which} targets")
    for mark, label in zip("osD", ("median", "95th percentile", "rms"), strict=True):
        axes[0].plot([], [], mark, color="0.4", label=label)
    axes[0].plot([], [], "o", mec="0.4", mfc="white", label="hollow: independent runs")
    figure.legend(loc="outside upper center", ncols=6, fontsize=8, frameon=False)
    figure.savefig(path, dpi=120)
    plt.close(figure)
