"""Whether blades pass a limit when they are told to: chances of `core.rotor_life` against truths.

A rotor is simulated (`core.validation.simulate`: truths from the priors, or finite-element runs),
calibrated from its readings, and asked when its blades pass a limit. The limits depend on the
readings alone: `FACTORS` times what the blades are expected to have, on average, at the next outage
(`held_out_h`). So whatever is told of the time T to them has to hold of the truths:

    passed_b(T_b)   is uniform on 0 … 1 for each blade b
    any(T)          is uniform for the first of the rotor's blades, T = min_b T_b

with T the hour at which the truth without noise reaches the limit; of what does not reach it within
the model's hours the chance is drawn between passed_b(horizon) and 1, where a uniform one would
lie. Beside them stand what must not be uniform, lest the test see nothing:

    narrow   Φ(`SHARP` Φ⁻¹(passed_b)), of one who is surer than the particles are
    worst    max_b passed_b, of one who looks at the worst blade for the rotor

and 1 − Π_b (1 − passed_b) (`independent`), which forgets that blades share parameters: how much
that matters goes with how much is known of these.

And chances by the next outage: what the twin tells (`twin`), what its mean ± sd would give if it
were a bell (`band`), and what stands in a spreadsheet (`trend`): each blade's readings as a_b t^β,
β of all together, its chance by the residuals' sd. A blade is pulled where its chance is `PULL` or
more; of those that pass some are left (missed), of those that do not some are pulled (in vain).

In finite-element rotors T is found between instants along a straight line.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from core.calibration.online import update
from core.calibration.state import RotorSpec, RotorState, blade_posterior
from core.errors import BladetwinError, InputError
from core.life import instants, probit
from core.model import Model
from core.observation import Inspection
from core.prediction import predict
from core.rng import stream
from core.rotor_life import rotor_life
from core.validation.coverage import each_rotor, kept
from core.validation.records import Record
from core.validation.simulate import Simulated, shipped_rotors, simulate
from core.validation.variants import Variant, model_of

Array = NDArray[np.float64]
QUANTITY = "elongation"
FACTORS = (1.0, 1.25, 1.5)
SHARP = 1.4
PARTICLES = 4000
EXPONENTS = (0.05, 3.0)  # of a trend


def curves_of(model: Model, variant: Variant, made: Simulated, rotor: int, seed: int) -> Array:
    """What the blades truly have at `hours_of`, (B, T) [mm]: what a surrogate, or a mesh, is off
    is the same way off at all hours, as predictions take it."""
    rng, time_h = stream(seed, variant.name, "lives", rotor), hours_of(model, variant)
    e1, e2 = rng.standard_normal((2, len(made.local), 1))
    nu = model.network.quantity(QUANTITY).numerical
    if variant.truth == "fe":
        runs = shipped_rotors()
        at = np.searchsorted(runs.time_h, time_h)
        value = runs.elongation[made.cluster][: len(made.local), at]
        return np.asarray(value * (1.0 + nu * e1) if variant.nu else value)
    x = np.array(
        [[{**made.shared, **own}[n] for n in model.input_names] for own in made.local.values()]
    )
    mean, sd = model.part(QUANTITY).predict(x, QUANTITY, time_h)
    return np.asarray(mean * (1.0 + nu * e1) + sd * e2)


def hours_of(model: Model, variant: Variant) -> Array:
    """Hours at which a truth is followed."""
    return np.union1d(instants(model, QUANTITY), [variant.held_out_h])


def reached(time_h: Array, curve: Array, limit: float) -> float:
    """The hour at which a truth (T,) first is at the limit; infinite: it is not.

    >>> hours = np.array([0.0, 10.0, 20.0])
    >>> reached(hours, np.array([0.0, 1.0, 3.0]), 2.0), reached(hours, np.zeros(3), 1.0)
    (15.0, inf)
    """
    there = np.flatnonzero(curve >= limit)
    if not len(there):
        return np.inf
    k = int(there[0])
    if k == 0:
        return float(time_h[0])
    share = (limit - curve[k - 1]) / (curve[k] - curve[k - 1])
    return float(time_h[k - 1] + share * (time_h[k] - time_h[k - 1]))


def trend(readings: Sequence[Inspection], blades: Sequence[str], at: float) -> tuple[Array, Array]:
    """Means and sds (B,) of what blades have at an hour, by a_b t^β through their readings.

    >>> made = [Inspection(f"{b}{t}", b, "y", t, [a * t**0.5]) for b, a in (("P", 1.0), ("Q", 2.0))
    ...     for t in (1.0, 4.0, 9.0)]
    >>> trend(made, ["P", "Q"], 16.0)[0].round(3).tolist()
    [4.0, 8.0]
    """
    t = np.array([r.time_h for r in readings]) / at
    y = np.array([float(r.values[0]) for r in readings])
    row = np.array([blades.index(r.blade) for r in readings])

    def fitted(beta: float) -> tuple[Array, Array, float]:
        powers = t**beta
        square = np.asarray(np.bincount(row, powers**2, len(blades)), float)
        a = np.bincount(row, powers * y, len(blades)) / square
        return a, square, float(np.sum((y - a[row] * powers) ** 2))

    found = minimize_scalar(lambda beta: fitted(beta)[2], bounds=EXPONENTS, method="bounded")
    a, square, left = fitted(float(found.x))
    free = max(len(y) - len(blades) - 1, 1)
    return a, np.sqrt(left / free / square)


def judged(
    model: Model, variant: Variant, made: Simulated, state: RotorState, rotor: int, seed: int
) -> list[Record]:
    """For each limit: chances at the truths' hours, and by the next outage."""
    blades, next_h = list(made.local), variant.held_out_h
    time_h, truth = hours_of(model, variant), curves_of(model, variant, made, rotor, seed)
    get = state.arrays.__getitem__
    ahead = [
        predict(model, blade_posterior(state.meta, get, b), QUANTITY, [next_h]) for b in blades
    ]
    mean = np.array([p.mean[0] for p in ahead])
    sd = np.sqrt([p.sd["total"][0] ** 2 - p.sd["noise"][0] ** 2 for p in ahead])
    by_trend, doubt = trend(made.readings, blades, next_h)
    rng, out = stream(seed, variant.name, "beyond", rotor), list[Record]()
    for factor in FACTORS:
        limit = factor * float(mean.mean())
        hour = np.array([reached(time_h, curve, limit) for curve in truth])
        asked = np.union1d(time_h, hour[np.isfinite(hour)])
        told = rotor_life(model, state, blades, QUANTITY, limit, asked)
        passed = np.array([told.passed[b] for b in blades])
        alone, worst = 1.0 - np.prod(1.0 - passed, axis=0), passed.max(axis=0)
        beyond = rng.random(len(blades) + 1)

        def at(chance: Array, h: float, u: float, hours: Array = asked) -> float:
            if np.isfinite(h):
                return float(chance[np.searchsorted(hours, h)])
            return float(chance[-1] + u * (1.0 - chance[-1]))

        pit = np.array([at(p, h, u) for p, h, u in zip(passed, hour, beyond[:-1], strict=True)])
        first, due = float(hour.min()), int(np.searchsorted(asked, next_h))
        out.append(
            {
                "factor": factor,
                "limit": limit,
                "pit": _short(pit),
                "narrow": _short(ndtr(SHARP * probit(pit))),
                "any": at(told.any, first, beyond[-1]),
                "independent": at(alone, first, beyond[-1]),
                "worst": at(worst, first, beyond[-1]),
                "passes": (hour <= next_h).astype(int).tolist(),
                "twin": _short(passed[:, due]),
                "band": _short(ndtr((mean - limit) / sd)),
                "trend": _short(ndtr((by_trend - limit) / np.maximum(doubt, 1e-12))),
            }
        )
    return out


def _short(values: Array) -> list[float]:
    return [round(float(v), 5) for v in values]


def one(variant: Variant, rotor: int, seed: int, particles: int) -> Record:
    """The record of a rotor; one that cannot be calibrated has an error, and fails the study."""
    start, model = time.monotonic(), model_of(variant)
    made = simulate(model, variant, rotor, seed)
    record: Record = {"rotor": rotor, "cluster": made.cluster}
    spec = RotorSpec(f"{variant.name}-{rotor}", tuple(made.local), particles, seed)
    try:
        state = update(model, spec, made.readings)
        record["limits"] = judged(model, variant, made, state, rotor, seed)
    except BladetwinError as error:
        record["error"] = str(error)
    return record | {"seconds": time.monotonic() - start}


def run(
    variant: Variant,
    *,
    rotors: int,
    seed: int,
    particles: int = PARTICLES,
    processes: int = 1,
    folder: str | Path | None = None,
    commit: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Record]:
    """Rotors 0 … `rotors` − 1 in the order of their numbers; `folder` keeps finished ones.

    Raises InputError for fewer than two rotors, and for kinds whose blades are replaced, or whose
    truths have a discrepancy or do not come from the priors.
    """
    if variant.mixed or variant.wrong or variant.six_locals or variant.truth == "bounds":
        raise InputError(
            "variant",
            variant.name,
            "has no lives to be told",
            "use rotor-20, first-outage, fe or fe-nu",
        )
    file = kept(f"lives-{variant.name}", variant, seed, particles, folder, commit)
    return each_rotor(one, variant, rotors, seed, particles, file, processes, progress)
