"""Posteriors of parameters as densities: prior, posteriors, truth (Figs. 5–8, 11–14)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from core.builtin.inspection_plan import Plan
from core.calibration.space import shared_prior
from core.calibration.state import Posterior
from core.diagnosis.densities import density, quantiles
from core.model import Model
from core.prior import Prior
from core.validation.paper import Case, Strategy, model_with
from core.validation.paper_above import LEVELS
from service.studies.paper.look import COLOURS, GREY, SAYS, SHADES
from service.studies.paper.numbers import Drawn
from service.studies.paper.run import Study

Array = NDArray[np.float64]
PSI = {
    "tbc_thickness": "TBC thickness / nominal",
    "t1t_rate": "T1T rate",
    "creep_transient": "transient creep α [sd]",
    "creep_steady": "steady creep γ [sd]",
}
UNIT = {"elongation": "mm", "deformation": "mm", "ceeq": "1"}
POINTS = 241


@dataclass(frozen=True, slots=True)
class Line:
    """One posterior in a picture of densities."""

    posterior: Posterior
    label: str
    colour: str


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
    """A panel for each parameter that a posterior has: prior (grey), posteriors, truth (dotted)."""
    model = model_with(True)
    names = [n for n in names if any(n in line.posterior.names for line in lines)]
    figure, axes = plt.subplots(
        1, len(names), figsize=(11, 2.7), squeeze=False, layout="constrained"
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
