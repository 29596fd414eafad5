"""The figures of the paper's Sec. 4 from a study, under their numbers, and one of the CEEQ."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image

from core.builtin.inspection_plan import OUTAGES_H, SCANNED, Plan, blades
from core.calibration.state import Posterior
from core.calibration.target import shared_prior
from core.diagnosis.pictures import density, quantiles
from core.model import Model
from core.prior import Prior
from core.validation.paper import LEVELS, SHOWN, Case, Strategy, model_with
from service.studies.paper.numbers import Course, Drawn, Missed
from service.studies.paper.run import Study
from service.studies.paper.sketch import network
from service.studies.plots import BAND, INK

Array = NDArray[np.float64]
WITH, WITH_BAND, RED, GREY = "#b8500f", "#f2d3ba", "#c0392b", "#777777"
COLOURS = {False: (INK, BAND), True: (WITH, WITH_BAND)}
SHADES = ("#9db4d3", "#5578a8", "#12294a"), ("#e9b48e", "#cf7a3a", "#7a3206")  # outages 1, 2, 3
PSI = {
    "tbc_thickness": "TBC thickness / nominal",
    "t1t_rate": "T1T rate",
    "creep_transient": "transient creep α [sd]",
    "creep_steady": "steady creep γ [sd]",
}
UNIT = {"elongation": "mm", "deformation": "mm", "ceeq": "1"}
SAYS = {False: "without δ", True: "with δ"}
POINTS = 241
SPAN_BINS = 16
AXES = ("x", "y", "z")
AXIS_COLOURS = ("#1f3b63", "#2e8b57", "#8e44ad")


@dataclass(frozen=True, slots=True)
class Line:
    """One posterior in a picture of densities."""

    posterior: Posterior
    label: str
    colour: str


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the paper, remade."""

    key: str
    title: str
    draw: Callable[[Study, Plan], Any]


def label_of(name: str) -> str:
    """How an axis names a parameter.

    >>> label_of("sigma_obs.ceeq"), label_of("theta2.elongation")
    ('noise σ of CEEQ [1]', 'θ2 of elongation [1]')
    """
    if name in PSI:
        return PSI[name]
    kind, _, quantity = name.partition(".")
    what = quantity.replace("ceeq", "CEEQ")
    if kind == "sigma_obs":
        return f"noise σ of {what} [{UNIT[quantity]}]"
    return f"{kind.replace('theta', 'θ')} of {what} [1]"


def prior_density(prior: Prior, x: Array) -> Array:
    """Density of a prior in natural units."""
    stretch = 1.0 / x if prior.log_scale else np.ones(len(x))
    return np.asarray(np.exp(prior.log_density_u(prior.to_u(x))) * stretch)


def distinct(posterior: Posterior, name: str, *, shared: bool) -> tuple[Array, Array]:
    """Values that differ, with their weights: a picture's kernels are as wide as these are few.

    Shared parameters stand on some dozens of nodes; they are drawn together by so much that the
    kernels leave the spread as it is.
    """
    found = np.unique(posterior.column(name), return_inverse=True)
    x, w = found[0], np.bincount(found[1], posterior.particles.w)
    if shared:
        wide = 1.06 * float(np.sum(w**2)) ** 0.2
        x = w @ x + (x - w @ x) / np.hypot(1.0, wide)
    return np.asarray(x), np.asarray(w)


def prior_of(model: Model, name: str) -> Prior:
    local = {p.name: p.prior for p in model.network.of_level("local")}
    return local.get(name) or shared_prior(model, name)


def posteriors(names: Sequence[str], lines: Sequence[Line], truth: Mapping[str, Any]) -> Any:
    """A panel for each parameter: prior (grey), posteriors, truth (dotted)."""
    model = model_with(True)
    figure, axes = plt.subplots(
        1, len(names), figsize=(2.75 * len(names), 2.6), squeeze=False, layout="constrained"
    )
    for axis, name in zip(axes[0], names, strict=True):
        prior = prior_of(model, name)
        met = [line for line in lines if name in line.posterior.names]
        ends = []
        for line in met:
            x, w = line.posterior.column(name), line.posterior.particles.w
            low, high = quantiles(x, w, (0.005, 0.995))
            ends += [low - 0.3 * (high - low), high + 0.3 * (high - low)]
        at = np.linspace(max(min(ends), prior.low), min(max(ends), prior.high), POINTS)
        axis.plot(at, prior_density(prior, at), color=GREY, lw=1.2, ls="--")
        shared = name not in {p.name for p in model.network.of_level("local")}
        for line in met:
            x, w = distinct(line.posterior, name, shared=shared)
            axis.plot(at, density(x, w, at, prior.low, prior.high), color=line.colour, lw=1.6)
        if (value := truth.get(name)) is not None and at[0] <= value <= at[-1]:
            axis.axvline(value, color="black", lw=1.0, ls=":")
        axis.set_xlim(at[0], at[-1])
        axis.set_ylim(bottom=0)
        axis.set_xlabel(label_of(name), fontsize=9)
        axis.tick_params(labelsize=8)
        axis.locator_params(axis="x", nbins=5)
    axes[0, 0].set_ylabel("probability density", fontsize=9)
    handles = [Line2D([], [], color=line.colour, lw=1.6) for line in lines]
    handles += [
        Line2D([], [], color=GREY, lw=1.2, ls="--"),
        Line2D([], [], color="black", lw=1.0, ls=":"),
    ]
    labels = [*(line.label for line in lines), "prior", "truth"]
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8, frameon=False
    )
    return figure


def _lines(study: Study, strategy: Strategy, of: Callable[[Drawn], Posterior]) -> list[Line]:
    """Offline: with and without δ. Online: after each outage as well."""
    found = []
    for delta in (False, True):
        stages = study.drawn[Case(strategy, delta).name]
        for stage in stages:
            after = f", t{stage.outages}" if len(stages) > 1 else ""
            colour = SHADES[int(delta)][stage.outages - 1] if len(stages) > 1 else COLOURS[delta][0]
            found.append(Line(of(stage), SAYS[delta] + after, colour))
    return found


def parameters(strategy: Strategy, level: str, *, hyper: bool) -> Callable[[Study, Plan], Any]:
    """Posteriors of psi, or of sigma_obs and theta, by elongations or by scans."""
    part = "shown" if level == "multi" else "scanned"
    quantity = LEVELS[level]
    names = (
        [f"sigma_obs.{quantity}", f"theta1.{quantity}", f"theta2.{quantity}"] if hyper else [*PSI]
    )

    def draw(study: Study, plan: Plan) -> Any:
        stage = study.numbers["cases"][Case(strategy, False).name][-1]
        truth = {name: one["truth"] for name, one in stage[part].items()}
        return posteriors(names, _lines(study, strategy, lambda d: getattr(d, part)), truth)

    return draw


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


def _residuals(axis: Any, one: Missed, span: Array) -> None:
    """Reading − mean over the span, with the mean width of the bounds in bins of it."""
    miss = 1000 * (one.reading - one.mean)
    for c, (name, colour) in enumerate(zip(AXES, AXIS_COLOURS, strict=True)):
        axis.plot(span, miss[:, c], ".", ms=1.4, alpha=0.35, color=colour, label=name)
    edges = np.quantile(span, np.linspace(0, 1, SPAN_BINS + 1))
    place = np.clip(np.searchsorted(edges, span, side="right") - 1, 0, SPAN_BINS - 1)
    middle = np.array([span[place == b].mean() for b in range(SPAN_BINS)])
    own = np.array([np.sqrt(np.mean(one.sd[place == b] ** 2)) for b in range(SPAN_BINS)])
    axis.fill_between(middle, -1000 * own, 1000 * own, color="#f1c40f", alpha=0.75, zorder=3)
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
        handles = [Line2D([], [], color=c, marker=".", lw=0) for c in AXIS_COLOURS]
        handles += [
            Rectangle((0, 0), 1, 1, color="#f1c40f", alpha=0.75),
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


_B90, _B01 = f"blade {int(SHOWN[1:])}", f"blade {int(SCANNED[1:]):02d}"


def _of_parameters(first: int, strategy: Strategy) -> list[Figure]:
    """Four figures from a number on: psi and hyperparameters, by elongations and by scans."""
    told = (
        (f"Posteriors of ψ, {_B90}, elongations, {strategy}", "multi", False),
        (f"Posteriors of σ and θ, elongations, {strategy}", "multi", True),
        (f"Posteriors of ψ, {_B01}, with its scans, {strategy}", "scanned", False),
        (f"Posteriors of σ and θ, scans, {strategy}", "scanned", True),
    )
    return [
        Figure(str(first + k), title, parameters(strategy, level, hyper=hyper))
        for k, (title, level, hyper) in enumerate(told)
    ]


FIGURES = (
    Figure("3", "Surrogate against finite elements at the critical node", surrogate),
    Figure("4", "The network and the order of calibration", lambda study, plan: network()),
    *_of_parameters(5, "offline"),
    Figure("9", f"Elongation of {_B90}, offline", elongation("offline")),
    Figure("10", f"Deformation of {_B01}, offline", deformation("offline")),
    *_of_parameters(11, "online"),
    Figure("15", f"Elongation of {_B90}, online", elongation("online")),
    Figure("16", f"Deformation of {_B01}, online", deformation("online")),
    Figure("ceeq", "CEEQ of the blades that were cut up, offline (not drawn in the paper)", ceeq),
)


def draw_all(study: Study, plan: Plan, folder: Path) -> dict[str, Path]:
    """Every figure as a PNG; their files by key."""
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for one in FIGURES:
        figure, path = one.draw(study, plan), folder / f"figure-{one.key}.png"
        keep(figure, path)
        found[one.key] = path
    return found


def keep(figure: Any, path: Path) -> None:
    """A figure as a PNG of 64 colours, a third of the size."""
    with BytesIO() as whole:
        figure.savefig(whole, dpi=100, format="png")
        plt.close(figure)
        with Image.open(whole) as image:
            image.convert("RGB").quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)
