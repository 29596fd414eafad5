"""Blade 01's scans, foreseen and read (Figs. 10 and 16)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from core.builtin.inspection_plan import Plan
from core.validation.paper import Case, Strategy
from service.studies.paper.look import RED, SAYS
from service.studies.paper.numbers import Drawn
from service.studies.paper.run import Study
from service.studies.paper.scans import Missed

Array = NDArray[np.float64]
SPAN_BINS = 16
AXES = ("x", "y", "z")
AXIS_COLOURS = ("#1f3b63", "#2e8b57", "#8e44ad")
YELLOW = "#f1c40f"


def _residuals(axis: Any, one: Missed, span: Array) -> None:
    """Reading − mean over the span, with the mean width of the bounds in bins of it."""
    miss = 1000 * (one.reading - one.mean)
    for c, (name, colour) in enumerate(zip(AXES, AXIS_COLOURS, strict=True)):
        axis.plot(span, miss[:, c], ".", ms=1.4, alpha=0.35, color=colour, label=name)
    edges = np.quantile(span, np.linspace(0, 1, SPAN_BINS + 1))
    place = np.clip(np.searchsorted(edges, span, side="right") - 1, 0, SPAN_BINS - 1)
    middle = np.array([span[place == b].mean() for b in range(SPAN_BINS)])
    own = np.array([np.sqrt(np.mean(one.sd[place == b] ** 2)) for b in range(SPAN_BINS)])
    axis.fill_between(middle, -1000 * own, 1000 * own, color=YELLOW, alpha=0.75, zorder=3)
    both = 1000 * np.hypot(own, one.noise)
    for sign in (-1, 1):
        axis.plot(middle, sign * both, color=RED, lw=1.2, zorder=4)
    axis.set_ylim(-130, 130)


def deformation(strategy: Strategy) -> Callable[[Study, Plan], Any]:
    """Blade 01's scans: predicted and read, and what is left; online the scan that comes next."""

    def draw(study: Study, plan: Plan) -> Any:
        shown = {d: _scans(study.drawn[Case(strategy, d).name]) for d in (False, True)}
        count = len(shown[False])
        figure, axes = plt.subplots(
            3, count, figsize=(11, 6.6), sharey="row", squeeze=False, layout="constrained"
        )
        span = span_of()
        for k in range(count):
            one, what = shown[False][k]
            top = axes[0, k]
            for c, colour in enumerate(AXIS_COLOURS):
                top.plot(one.mean[::4, c], one.reading[::4, c], ".", ms=2, color=colour)
            ends = [float(one.mean.min()), float(one.mean.max())]
            top.plot(ends, ends, color="black", lw=0.8, ls="--")
            top.set_title(what, fontsize=9)
            top.set_xlabel("predicted mean, without δ [mm]", fontsize=8)
            for row, delta in ((1, False), (2, True)):
                axis, own = axes[row, k], shown[delta][k][0]
                _residuals(axis, own, span)
                rms = float(np.sqrt(np.mean((own.truth - own.mean) ** 2)))
                axis.set_title(
                    f"({'ab'[delta]}) {SAYS[delta]}: {1000 * rms:.1f} µm off the truth", fontsize=9
                )
            axes[2, k].set_xlabel("span from root to tip [1]", fontsize=9)
        axes[0, 0].set_ylabel("scan [mm]", fontsize=9)
        for row in (1, 2):
            axes[row, 0].set_ylabel("scan − mean [µm]", fontsize=9)
        for axis in axes.ravel():
            axis.tick_params(labelsize=8)
        handles: list[Any] = [Line2D([], [], color=c, marker=".", lw=0) for c in AXIS_COLOURS]
        handles += [
            Rectangle((0, 0), 1, 1, color=YELLOW, alpha=0.75),
            Line2D([], [], color=RED, lw=1.2),
        ]
        labels = [*AXES, "± σ of the blade (and δ)", "± σ of a reading"]
        figure.legend(
            handles, labels, loc="outside lower center", ncols=5, fontsize=8, frameon=False
        )
        return figure

    return draw


def _scans(stages: Sequence[Drawn]) -> list[tuple[Missed, str]]:
    """Offline all scans of the one stage, online each stage's next one; with their titles."""
    if len(stages) == 1:
        return [
            (one, f"{one.time_h / 1000:g} 000 h, {'used' if one.used else 'held out'}")
            for one in stages[0].scans
        ]
    return [
        (stage.scans[-1], f"{stage.scans[-1].time_h / 1000:g} 000 h, foreseen at t{stage.outages}")
        for stage in stages
    ]


def span_of() -> Array:
    """Place of the scanned nodes between root (0) and tip (1)."""
    from core.blade import build_mesh
    from core.validation.paper_scan import load

    return np.asarray(build_mesh("default").parametric[load().nodes, 2], float)
