"""Courses over the hours: the surrogate's (Fig. 3), elongations (Figs. 9 and 15) and CEEQ."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from core.builtin.inspection_plan import OUTAGES_H, Plan, blades
from core.validation.paper import SHOWN, Case, Strategy, model_with
from core.validation.paper_above import LEVELS
from service.studies.paper.look import COLOURS, RED, SAYS, SHADES
from service.studies.paper.numbers import Course
from service.studies.paper.run import Study
from service.studies.plots import BAND, INK


def _course(axis: Any, course: Course, rows: Sequence[Mapping[str, Any]], *, delta: bool) -> None:
    """Mean ± sd of a blade, its readings with the bars of a reading."""
    colour, band = COLOURS[delta]
    hours = course.time_h / 1000
    axis.fill_between(hours, course.mean - course.blade, course.mean + course.blade, color=band)
    axis.plot(hours, course.mean, color=colour, lw=1.3)
    for row in rows:
        at, face = row["time_h"] / 1000, "black" if row["used"] else "white"
        axis.errorbar(at, row["mean"], yerr=row["sd"], color=RED, lw=1.3, capsize=3, zorder=3)
        axis.plot(at, row["mean"], "s", color=colour, ms=4.5, zorder=4)
        axis.plot(at, row["reading"], "o", mec="black", mfc=face, ms=4.5, zorder=5)


def _truth(axis: Any, plan: Plan, quantity: str, blade: str) -> None:
    clean = {"elongation": plan.elongation, "ceeq": plan.ceeq}[quantity][blades().index(blade)]
    at = plan.time_h <= 40_000
    axis.plot(plan.time_h[at] / 1000, clean[at], color="black", lw=1.0, ls="--")


def _course_legend(figure: Any, *, held_out: bool) -> None:
    entries: list[tuple[Any, str]] = [
        (Line2D([], [], color=INK, marker="s", ms=4.5, lw=1.3), "predicted mean"),
        (Rectangle((0, 0), 1, 1, color=BAND), "μ ± σ of the blade (and δ)"),
        (Line2D([], [], color=RED, marker="_", lw=1.3), "μ ± σ of a reading"),
        (Line2D([], [], color="black", marker="o", lw=0), "reading used"),
        (Line2D([], [], mec="black", mfc="white", marker="o", lw=0), "reading not used"),
        (Line2D([], [], color="black", lw=1.0, ls="--"), "finite elements"),
    ]
    shown = entries if held_out else [e for e in entries if e[1] != "reading not used"]
    figure.legend(
        [e[0] for e in shown],
        [e[1] for e in shown],
        loc="outside lower center",
        ncols=len(shown),
        fontsize=8,
        frameon=False,
    )


def elongation(strategy: Strategy) -> Callable[[Study, Plan], Any]:
    """Blade 90: offline one panel with and one without δ; online one for each outage too."""

    def draw(study: Study, plan: Plan) -> Any:
        stages = {d: study.drawn[Case(strategy, d).name] for d in (False, True)}
        numbers = {d: study.numbers["cases"][Case(strategy, d).name] for d in (False, True)}
        count = len(stages[False])
        shape = (1, 2) if count == 1 else (2, count)
        figure, axes = plt.subplots(
            *shape,
            figsize=(10.5, 3.4 if count == 1 else 5.6),
            sharex=True,
            sharey=True,
            squeeze=False,
            layout="constrained",
        )
        panels = [(d, k) for d in (False, True) for k in range(count)]
        for axis, (d, k) in zip(axes.ravel(), panels, strict=True):
            _course(axis, stages[d][k].elongation, numbers[d][k]["elongation"], delta=d)
            _truth(axis, plan, LEVELS["multi"], SHOWN)
            after = f", after {stages[d][k].outages} outage{'s' * (k > 0)}" if count > 1 else ""
            axis.set_title(f"({'ab'[d]}) {SAYS[d]}{after}", fontsize=9)
            axis.tick_params(labelsize=8)
            axis.set_xlim(0, 40)
            axis.set_ylim(bottom=0)
        for axis in axes[-1]:
            axis.set_xlabel("operating hours [1000 h]", fontsize=9)
        for axis in axes[:, 0]:
            axis.set_ylabel("tip elongation [mm]", fontsize=9)
        _course_legend(figure, held_out=True)
        return figure

    return draw


def ceeq(study: Study, plan: Plan) -> Any:
    """CEEQ of the blades that were cut up, offline."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
    stages = {d: study.drawn[Case("offline", d).name][-1] for d in (False, True)}
    numbers = {d: study.numbers["cases"][Case("offline", d).name][-1] for d in (False, True)}
    for axis, blade in zip(axes, stages[False].ceeq, strict=True):
        for delta in (True, False):
            course, rows = stages[delta].ceeq[blade], numbers[delta]["ceeq"][blade]
            colour, band = COLOURS[delta]
            hours = course.time_h / 1000
            low, high = (100 * (course.mean + s * course.blade) for s in (-1, 1))
            axis.fill_between(hours, low, high, color=band, alpha=0.8)
            axis.plot(hours, 100 * course.mean, color=colour, lw=1.3, label=SAYS[delta])
        clean = plan.ceeq[blades().index(blade)]
        at = plan.time_h <= 40_000
        axis.plot(plan.time_h[at] / 1000, 100 * clean[at], color="black", lw=1.0, ls="--")
        for row in rows:
            axis.plot(row["time_h"] / 1000, 100 * row["reading"], "o", color="black", ms=5)
        axis.set_title(f"blade {int(blade[1:])}", fontsize=9)
        axis.set_xlabel("operating hours [1000 h]", fontsize=9)
        axis.tick_params(labelsize=8)
        axis.set_xlim(0, 40)
        axis.set_ylim(bottom=0)
    axes[0].set_ylabel("CEEQ at the critical node [%]", fontsize=9)
    handles = [
        *(Line2D([], [], color=COLOURS[d][0], lw=1.3) for d in (False, True)),
        Line2D([], [], color="black", lw=1.0, ls="--"),
        Line2D([], [], color="black", marker="o", lw=0),
    ]
    labels = ["mean ± σ without δ", "mean ± σ with δ", "finite elements", "destructive test"]
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def surrogate(study: Study, plan: Plan) -> Any:
    """CEEQ at the critical node at true inputs: blade 12 over time, and all blades at outages."""
    model = model_with(False)
    part = model.part("ceeq")
    node, blade = [part.named["critical"]], blades().index("B012")
    late = plan.time_h >= 500.0
    mean, sd = (
        100 * v[:, :, 0] for v in part.predict(plan.inputs, "ceeq", plan.time_h[late], node)
    )
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
    hours = plan.time_h[late] / 1000
    left.fill_between(
        hours, (mean - 2 * sd)[blade], (mean + 2 * sd)[blade], color=BAND, label="± 2 sd"
    )
    left.plot(hours, mean[blade], color=INK, lw=1.4, label="surrogate")
    left.plot(
        hours, 100 * plan.ceeq[blade][late], color="black", ls="--", lw=1.0, label="finite elements"
    )
    left.set_xlabel("operating hours [1000 h]", fontsize=9)
    left.set_ylabel("CEEQ at the critical node [%]", fontsize=9)
    left.set_title("blade 12", fontsize=9)
    left.legend(fontsize=8, frameon=False)
    at = np.searchsorted(plan.time_h[late], OUTAGES_H)
    for k, (shade, hour) in enumerate(zip(SHADES[0], OUTAGES_H, strict=True)):
        clean = 100 * plan.ceeq[:, late][:, at[k]]
        right.loglog(clean, mean[:, at[k]], ".", ms=4, color=shade, label=f"{hour:,.0f} h")
    ends = [
        float(100 * plan.ceeq[:, late][:, at].min()),
        float(100 * plan.ceeq[:, late][:, at].max()),
    ]
    right.plot(ends, ends, color="black", ls="--", lw=0.8)
    right.set_xlabel("finite elements, CEEQ [%]", fontsize=9)
    right.set_ylabel("surrogate, CEEQ [%]", fontsize=9)
    right.set_title(f"all {len(plan.inputs)} blades", fontsize=9)
    right.legend(fontsize=8, frameon=False)
    for axis in (left, right):
        axis.tick_params(labelsize=8)
    return figure
