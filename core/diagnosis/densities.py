"""Amplitudes and parameters of a diagnosis as pictures: densities, bounds, what leans on one."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.space import shared_prior
from core.calibration.state import RotorState, blade_posterior, shared_posterior
from core.diagnosis.adopt import amplitude
from core.diagnosis.grammar import Cell
from core.model import Model
from core.prior import Prior
from core.smc.particles import weighted_quantile

if TYPE_CHECKING:
    from core.diagnosis.diagnose import Diagnosis

Array = NDArray[np.float64]
Json = dict[str, Any]
LEVELS = (0.025, 0.5, 0.975)
POINTS = 61  # of a density, over its prior and again over its posterior
EDGE = 0.05  # of the prior's range: so near at its bound …
NEAR = 3.0  # … and not so many of its own sds away, a posterior leans on it


def short(value: float) -> float:
    """Six digits.

    >>> short(0.123456789)
    0.123457
    """
    return float(f"{value:.6g}")


def amplitude_picture(cell: Cell, before: Model, model: Model, state: RotorState) -> Json:
    """Prior and posterior density of an effect's amplitude on one axis, with what they rest on."""
    name, origin = amplitude(cell, before.network)
    prior = model.network.parameter(name).prior
    posterior = shared_posterior(state.meta, state.arrays.__getitem__)
    a, w = posterior.column(name), posterior.particles.w
    mean = float(w @ a)
    sd = float(np.sqrt(w @ (a - mean) ** 2))
    typical = prior.quantile(np.array([0.02, 0.98]))
    ends = (min(mean - 5 * sd, typical[0], origin), max(mean + 5 * sd, typical[1], origin))
    wide, near = np.linspace(*ends, POINTS), np.linspace(mean - 4 * sd, mean + 4 * sd, POINTS)
    x = np.unique(np.clip(np.r_[wide, near], prior.low, prior.high))
    stretch = 1.0 / x if prior.log_scale else np.ones(len(x))
    drawn = prior.quantile((np.arange(2000) + 0.5) / 2000)
    return {
        "name": cell.name,
        "unit": amplitude_unit(cell, model),
        "prior": {
            "low": prior.low - origin,
            "high": prior.high - origin,
            "mean": short(float(drawn.mean()) - origin),
            "sd": short(float(drawn.std())),
        },
        "quantiles": [short(v - origin) for v in quantiles(a, w, LEVELS)],
        "at_bound": leans(prior, a, w),
        "x": [short(v - origin) for v in x],
        "prior_density": [short(v) for v in np.exp(prior.log_density_u(prior.to_u(x))) * stretch],
        "density": [short(v) for v in density(a, w, x, prior.low, prior.high)],
    }


def amplitude_unit(cell: Cell, model: Model) -> str:
    """Of the amplitude: 1 for a share, else the unit of what it is added to."""
    if cell.family.how == "times":
        return "1"
    if cell.family.target == "reading":
        return model.network.quantity(cell.family.of).unit
    return model.network.parameter(cell.family.of).unit


def quantiles(a: Array, w: Array, levels: Sequence[float]) -> list[float]:
    """Of weighted values, linear between the middles of their weights.

    >>> quantiles(np.array([1.0, 3.0]), np.array([0.5, 0.5]), [0.5])
    [2.0]
    """
    return [float(v) for v in weighted_quantile(a, w, np.array(levels))]


def density(a: Array, w: Array, x: Array, low: float, high: float) -> Array:
    """Density at x of weighted values, by normal kernels that are folded back at the bounds.

    Silverman's width, 1.06 sd n_eff^−⅕; integrates to 1 between the bounds.
    """
    mean = w @ a
    sd = np.sqrt(w @ (a - mean) ** 2) + 1e-300
    h = 1.06 * sd * float(np.sum(w**2)) ** 0.2
    total = np.zeros(len(x))
    for centre in (a, 2 * low - a, 2 * high - a):
        total += np.exp(-0.5 * ((x[:, None] - centre) / h) ** 2) @ w
    return np.asarray(total / (h * np.sqrt(2 * np.pi)))


def leans(prior: Prior, a: Array, w: Array) -> str | None:
    """``low`` or ``high`` where a posterior leans on that bound of its prior, else None.

    Where its outer sixth begins within `EDGE` of the range from the bound, and the mean lies within
    `NEAR` of its own sds: a parameter that would go on if it could.
    """
    u = prior.to_u(a)
    low, high = prior.box
    mean = float(w @ u)
    sd = float(np.sqrt(w @ (u - mean) ** 2))
    sixth, last = quantiles(u, w, (0.16, 0.84))
    edge = EDGE * (high - low)
    if sixth - low <= edge and mean - low <= NEAR * sd:
        return "low"
    if high - last <= edge and high - mean <= NEAR * sd:
        return "high"
    return None


def leaning(model: Model, state: RotorState, besides: Collection[str] = ()) -> list[str]:
    """One sentence for each shared input or adopted amplitude that leans on an end of its prior,
    but for those named `besides`: an effect may stand for what the prior does not allow. It is no
    reason against one: a gas temperature 1.5 sds inside of its prior leans, too, and refused a
    campaign's offset of 0.042 ± 0.005 mm where 0.04 was planted."""
    shared, told = shared_posterior(state.meta, state.arrays.__getitem__), []
    for one in model.network.of_level("shared"):
        if one.name in besides or one.name not in shared.names:
            continue
        side = leans(one.prior, shared.column(one.name), shared.particles.w)
        if side is not None:
            end = {"low": one.prior.low, "high": one.prior.high}[side]
            told.append(
                f"{one.name} leans on {end:g}, the {side} end of its prior: what is "
                "found may stand for what lies beyond. Where it can be so, widen the prior"
            )
    return told


def parameter_pictures(found: Diagnosis) -> list[Json]:
    """Shared ones by their own, local ones over the blades; amplitudes are among the shared."""
    (model, state), (after, made) = found.before, found.after
    effects = {amplitude(e.cell, model.network)[0] for e in found.effects}
    units = {p.name: after.network.unit_of(p.name) for p in after.network.parameters}
    units |= {q.sigma_name: q.unit for q in after.network.quantities}
    shared = [n for n in made.meta["shared"] if n not in state.meta["shared"]]
    told = []
    for name in (*state.meta["shared"], *shared, *state.meta["local"]):
        level = "local" if name in state.meta["local"] else "shared"
        of = made if name in made.meta[level] else state
        prior = _prior(after if of is made else model, name, level)
        told.append(
            {
                "name": name,
                "level": level,
                "unit": units.get(name.split("@")[0], units.get(name, "1")),
                "low": prior.low,
                "high": prior.high,
                "effect": name in effects,
                "before": _where(name, level, prior, state),
                "after": _where(name, level, prior, made),
            }
        )
    return told


def _prior(model: Model, name: str, level: str) -> Prior:
    return model.network.parameter(name).prior if level == "local" else shared_prior(model, name)


def _where(name: str, level: str, prior: Prior, state: RotorState) -> Json | None:
    """Mean and sd; of a local one the mean over blades and the root mean square of their sds."""
    get = state.arrays.__getitem__
    if name not in state.meta[level]:
        return None
    if level == "shared":
        posteriors = [shared_posterior(state.meta, get)]
    else:
        posteriors = [blade_posterior(state.meta, get, b) for b in state.meta["blades"]]
    columns = [(p.column(name), p.particles.w) for p in posteriors]
    means = np.array([w @ a for a, w in columns])
    sds = np.array([np.sqrt(w @ (a - m) ** 2) for (a, w), m in zip(columns, means, strict=True)])
    at = [leans(prior, a, w) for a, w in columns]
    return {
        "mean": short(float(means.mean())),
        "sd": short(float(np.sqrt(np.mean(sds**2)))),
        "spread": short(float(means.std())),
        "of": len(posteriors),
        "at_low": at.count("low"),
        "at_high": at.count("high"),
    }
