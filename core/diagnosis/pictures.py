"""What a report shows of a diagnosis beside its numbers; plain JSON, computed with the particles.

readings     each as both models predict it from all the others (`core.diagnosis.left_out`)
courses      each blade itself (no reading's noise) over the hours, by both models: 2.5, 50 and
             97.5 % of the posterior, mean and sd
amplitudes   of every effect in the model: prior and posterior density
parameters   prior's bounds, and where a posterior leans on one
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import POOL
from core.calibration.space import shared_prior
from core.calibration.state import Posterior, RotorState, blade_posterior, shared_posterior
from core.diagnosis.adopt import amplitude
from core.diagnosis.case import Case
from core.diagnosis.diagnose import Diagnosis
from core.diagnosis.grammar import Cell, Facts
from core.diagnosis.left_out import left_out
from core.model import Model
from core.observation import Inspection
from core.prediction import Prediction, predict
from core.prior import Prior
from core.rng import stream

Array = NDArray[np.float64]
Json = dict[str, Any]
SCHEMA = 1
HOURS = 21  # of a course
ENOUGH = 512  # equally weighted particles of a blade for its course: the sd errs by 3 %
POINTS = 61  # of a density, over its prior and again over its posterior
EDGE = 0.05  # of the prior's range: so near at its bound …
NEAR = 3.0  # … and not so many of its own sds away, a posterior leans on it
LEVELS = (0.025, 0.5, 0.975)


def pictures(found: Diagnosis, case: Case) -> Json:
    """All of it; readings of several values are counted, not shown."""
    (model, state), (model_after, state_after) = found.before, found.after
    changed = state_after is not state
    before = left_out(case.seen(model, state))
    after = left_out(case.seen(model_after, state_after)) if changed else before
    later = {r.id: i for i, r in enumerate(after.readings)}
    rows = []
    for i, reading in enumerate(before.readings):
        if (j := later.get(reading.id)) is None:
            continue
        rows.append(
            {
                **_reading(model, reading, case),
                "before": _given(before.mean[i], before.sd[i], before.z[i]),
                "after": _given(after.mean[j], after.sd[j], after.z[j]),
            }
        )
    return {
        "schema": SCHEMA,
        "readings": rows,
        "readings_not_shown": len(case.readings) - len(rows),
        "courses": _both_courses(found, case),
        "amplitudes": [_amplitude(e.cell, model, *found.after) for e in found.effects],
        "parameters": _parameters(found),
    }


def _reading(model: Model, reading: Inspection, case: Case) -> Json:
    facts = case.facts.get(reading.blade, Facts())
    return {
        "id": reading.id,
        "blade": reading.blade,
        "quantity": reading.quantity,
        "unit": model.network.quantity(reading.quantity).unit,
        "time_h": float(reading.time_h),
        "rotor_h": float(reading.time_h + facts.offset_h),
        "instrument": reading.instrument,
        "campaign": reading.campaign,
        "value": float(reading.values[0]),
    }


def _given(mean: float, sd: float, z: float) -> Json:
    return {"mean": _short(mean), "sd": _short(sd), "z": round(float(z), 3)}


def _short(value: float) -> float:
    """Six digits.

    >>> _short(0.123456789)
    0.123457
    """
    return float(f"{value:.6g}")


def shown_quantity(model: Model, readings: Sequence[Inspection]) -> str | None:
    """The scalar quantity that was read most often; None: none was."""
    scalar = {q.name for q in model.network.quantities if q.kind == "scalar"}
    read = Counter(r.quantity for r in readings if r.quantity in scalar)
    return min(read, key=lambda name: (-read[name], name)) if read else None


def _both_courses(found: Diagnosis, case: Case) -> Json | None:
    model, state = found.before
    quantity = shown_quantity(model, case.readings)
    if quantity is None:
        return None
    hours = np.linspace(0.0, model.part(quantity).horizon_h, HOURS)
    before = _courses(model, state, case, quantity, hours)
    same = found.after[1] is state
    return {
        "quantity": quantity,
        "unit": model.network.quantity(quantity).unit,
        "time_h": hours.tolist(),
        "blades": list(case.spec.blades),
        "before": before,
        "after": before if same else _courses(*found.after, case, quantity, hours),
    }


def _courses(model: Model, state: RotorState, case: Case, quantity: str, hours: Array) -> Json:
    """mean, sd, low, median, high: one row a blade, one column an hour."""
    told: Json = {"mean": [], "sd": [], "low": [], "median": [], "high": []}

    def course(blade: str) -> Prediction:
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        if len(posterior.particles.log_w) > ENOUGH:
            drawn = posterior.particles.resampled(ENOUGH, stream(0, "courses"))
            posterior = Posterior(posterior.names, drawn)
        known = (case.spec.known or {}).get(blade)
        own = model.for_blade(blade)
        return predict(
            own, posterior, quantity, hours, noise=False, known=known, levels=LEVELS[1:2]
        )

    # one blade of each model first: it compiles what the others ask for again
    first = {id(model.for_blade(b)): b for b in reversed(case.spec.blades)}.values()
    made = {b: course(b) for b in first}
    rest = [b for b in case.spec.blades if b not in made]
    made |= zip(rest, POOL.map(course, rest), strict=True)
    for blade in case.spec.blades:
        got = made[blade]
        rows = (got.mean, got.sd["total"], got.lower, got.quantiles[LEVELS[1]], got.upper)
        for name, row in zip(told, rows, strict=True):
            told[name].append([_short(v) for v in row])
    return told


def _amplitude(cell: Cell, before: Model, model: Model, state: RotorState) -> Json:
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
            "mean": _short(float(drawn.mean()) - origin),
            "sd": _short(float(drawn.std())),
        },
        "quantiles": [_short(v - origin) for v in quantiles(a, w, LEVELS)],
        "at_bound": leans(prior, a, w),
        "x": [_short(v - origin) for v in x],
        "prior_density": [_short(v) for v in np.exp(prior.log_density_u(prior.to_u(x))) * stretch],
        "density": [_short(v) for v in density(a, w, x, prior.low, prior.high)],
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
    order = np.argsort(a, kind="stable")
    middle = np.cumsum(w[order]) - 0.5 * w[order]
    return [float(v) for v in np.interp(levels, middle, a[order])]


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


def _parameters(found: Diagnosis) -> list[Json]:
    """Shared ones by their own, local ones over the blades; amplitudes are among the shared."""
    (model, state), (after, made) = found.before, found.after
    effects = {amplitude(e.cell, model.network)[0] for e in found.effects}
    units = {p.name: p.unit for p in after.network.parameters}
    units |= {
        amplitude(e.cell, model.network)[0]: amplitude_unit(e.cell, after) for e in found.effects
    }
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
        "mean": _short(float(means.mean())),
        "sd": _short(float(np.sqrt(np.mean(sds**2)))),
        "spread": _short(float(means.std())),
        "of": len(posteriors),
        "at_low": at.count("low"),
        "at_high": at.count("high"),
    }
