"""Plots of a study: distributions of ranks with their bands, and coverage."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from core.validation.sbc import PLACES, PROBABILITIES, Ecdf

INK, BAND = "#1f3b63", "#c9d6e8"
WRONG = {"narrow": "#c0392b", "shifted": "#d68910", "laplace": "#7d3c98"}
LABELS = {
    "narrow": "spread × 0.7",
    "shifted": "shifted by 0.5 sd",
    "laplace": "normal of equal moments",
}
COLUMNS = 3


def rank_plot(curves: Mapping[str, Mapping[str, Ecdf]], title: str, path: Path) -> None:
    """F(z) − z of the truths' ranks for each name, its 95 % simultaneous band, and the controls."""
    rows = -(-len(curves) // COLUMNS)
    figure, axes = plt.subplots(
        rows, COLUMNS, figsize=(11, 2.9 * rows + 0.9), squeeze=False, layout="constrained"
    )
    for axis in axes.ravel()[len(curves) :]:
        axis.set_visible(False)
    for axis, (name, found) in zip(axes.ravel(), curves.items(), strict=False):
        one = found["pit"]
        axis.fill_between(PLACES, one.lower - PLACES, one.upper - PLACES, color=BAND, lw=0)
        axis.axhline(0, color="0.5", lw=0.8)
        for key, colour in WRONG.items():
            if key in found:
                axis.plot(PLACES, found[key].share - PLACES, color=colour, lw=1.1, ls="--")
        axis.plot(PLACES, one.share - PLACES, color=INK, lw=1.8)
        reach = max(
            float(np.max(np.abs(one.share - PLACES))),
            float(np.max(one.upper - PLACES)),
            float(np.max(PLACES - one.lower)),
        )
        axis.set_ylim(-1.6 * reach, 1.6 * reach)
        axis.set_xlim(0, 1)
        note = "" if one.inside else ", outside the band"
        colour = "black" if one.inside else WRONG["narrow"]
        axis.set_title(f"{name}\n({one.truths} truths{note})", fontsize=9, color=colour)
        axis.tick_params(labelsize=8)
    for axis in axes[:, 0]:
        axis.set_ylabel("F(z) − z", fontsize=9)
    for axis in axes.ravel()[max(len(curves) - COLUMNS, 0) : len(curves)]:
        axis.set_xlabel("rank z of the truth", fontsize=9)
    handles = [
        Patch(color=BAND),
        Line2D([], [], color=INK, lw=1.8),
        *(Line2D([], [], color=c, lw=1.1, ls="--") for c in WRONG.values()),
    ]
    labels = ["95 % simultaneous band", "bladetwin", *(f"control: {v}" for v in LABELS.values())]
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    figure.suptitle(title, fontsize=11)
    _save(figure, path)


def coverage_plot(table: Mapping[str, Mapping[str, Any]], title: str, path: Path) -> None:
    """Shares of truths inside central intervals, less the nominal share, ± two standard errors."""
    names = list(table)
    figure, axes = plt.subplots(
        1,
        len(PROBABILITIES),
        figsize=(11, 0.36 * len(names) + 1.5),
        sharey=True,
        layout="constrained",
    )
    y = np.arange(len(names))[::-1]
    for axis, probability in zip(axes, PROBABILITIES, strict=True):
        c = round(100 * probability)
        off = np.array([100 * (table[n][f"inside_{c}"] - probability) for n in names])
        error = np.array([100 * min(table[n][f"error_{c}"], 1.0) for n in names])
        axis.axvline(0, color="0.5", lw=0.8)
        axis.errorbar(off, y, xerr=2 * error, fmt="o", color=INK, ms=4, lw=1.2, capsize=2)
        reach = 1.15 * float(np.max(np.abs(off) + 2 * error)) + 1
        axis.set_xlim(-reach, reach)
        axis.set_title(f"{c} % intervals", fontsize=9)
        axis.set_xlabel("inside − nominal [points]", fontsize=8)
        axis.tick_params(labelsize=8)
    axes[0].set_yticks(y, names, fontsize=8)
    axes[0].set_ylim(-0.6, len(names) - 0.4)
    figure.suptitle(title, fontsize=11)
    _save(figure, path)


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=130)
    plt.close(figure)
