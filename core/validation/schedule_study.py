"""The paper's schedule against the joint posterior: how often it covers, how sharp it claims to be.

Every rotor, drawn from the priors (`core.validation.simulate`, variant ``mixed``: Table 1 of the
paper with fewer blades), is calibrated jointly and by readings of Algorithm 1, with and without a
discrepancy of the elongation. Kept are, by parameter, the posterior's mean and standard deviation
and whether its intervals hold the truth. No rotor is dropped; sweeps that ran out count.

Three questions of the paper's are answered by ratios of standard deviations: is offline sharper
than online, how sharp is the schedule beside the exact posterior, and what does a discrepancy
sharpen or widen, on data that have one and on data that have none
(`core.validation.schedule_tables`). The joint target is the same offline and online: the sealed
state after the readings came outage by outage is compared bit by bit with that of all at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import update
from core.calibration.schedule import Schedule, calibrate, instants
from core.calibration.state import Posterior, RotorSpec, blade_posterior, shared_posterior
from core.model import Model, rotor_blade
from core.observation import Inspection
from core.prediction import predict
from core.validation.sbc import published_cdf
from core.validation.schedule_rotors import READ, Kind, drawn, model_with, with_delta
from core.validation.simulate import Simulated
from core.validation.variants import Variant

Array = NDArray[np.float64]
HELD_OUT = f"held-out {READ}"
JOINT = "joint"
PROBABILITIES = (0.68, 0.95)
ARMS: Mapping[str, Schedule | None] = {
    JOINT: None,
    "offline": Schedule(),
    "online": Schedule(strategy="online"),
    "offline, draws held": Schedule(fix="draws", draws=20, sweeps=20),
    "offline, last sweep as prior": Schedule(prior="last sweep", sweeps=10),
}


@dataclass(frozen=True, slots=True)
class Case:
    """One calibration: which discrepancy the data have, which the model has, by which arm."""

    data: Kind = "none"
    model: Kind = "none"
    arm: str = JOINT


PLAIN = tuple(Case(arm=arm) for arm in ARMS)
WITH_DISCREPANCY = (
    *(Case("none", kind) for kind in ("constant", "paper")),
    *(Case("constant", kind) for kind in ("none", "constant")),
    *(Case("paper", kind) for kind in ("none", "paper")),
    *(Case("none", "paper", arm) for arm in ("offline", "online")),
    *(Case("paper", kind, arm) for arm in ("offline", "online") for kind in ("none", "paper")),
)
ON_PLAN = tuple(
    Case("none", k, arm) for arm in (JOINT, "offline", "online") for k in ("none", "paper")
)


@dataclass(frozen=True, slots=True)
class Found:
    """One parameter's posterior, or a held-out reading's prediction.

    inside   is the truth in the central interval of each of `PROBABILITIES`?
    """

    mean: float
    sd: float
    inside: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class Outcome:
    """One calibration of one rotor.

    found       by name and blade ("" for what the rotor shares)
    sweeps      of all loops; 0 for the joint calibration
    converged   False where the sweeps of a loop ran out
    plain_ess   particles that one plain weighting would have left in the worst shared step
    """

    found: Mapping[str, Mapping[str, Found]]
    sweeps: int = 0
    converged: bool = True
    plain_ess: float = np.inf


Record = Mapping[Case, Outcome]


def outcome(case: Case, made: Simulated, particles: int, seed: int) -> Outcome:
    """One calibration of one rotor.

    Blades with a reading count; the scanned blade's parameters have names of their own, too. A
    discrepancy that the data lack has theta = 0 for its truth.
    """
    model, schedule = model_with(case.model), ARMS[case.arm]
    spec = RotorSpec(f"rotor-{made.cluster}", tuple(made.local), particles, seed)
    if schedule is None:
        state = update(model, spec, made.readings)
        get = state.arrays.__getitem__
        each = {b: blade_posterior(state.meta, get, b) for b in made.local}
        return Outcome(_found(model, made, shared_posterior(state.meta, get), each))
    got = calibrate(model, spec, made.readings, schedule)
    return Outcome(
        _found(model, made, got.shared, {b: got.blade(b) for b in made.local}),
        len(got.trace),
        all(got.converged.values()),
        min(sweep.plain_ess for sweep in got.trace),
    )


def _found(
    model: Model, made: Simulated, shared: Posterior, each: Mapping[str, Posterior]
) -> dict[str, dict[str, Found]]:
    out: dict[str, dict[str, Found]] = {}
    for name in shared.names:
        out[name] = {"": _one(shared, name, made.shared.get(name, 0.0))}
    scanned = {r.blade for r in made.readings if r.quantity == "deformation"}
    for b in sorted({r.blade for r in made.readings}):
        for name, truth in made.local[b].items():
            for label in (name, *([f"{name}, scanned blade"] if b in scanned else [])):
                out.setdefault(label, {})[b] = _one(each[b], name, truth)
    for held in made.held:
        if held.quantity == READ:
            band = predict(model, each[held.blade], READ, [held.time_h])
            tails = [(1 - p) / 2 for p in PROBABILITIES]
            q = {round(p, 3): float(v[0]) for p, v in band.quantiles.items()}
            inside = tuple(q[round(a, 3)] <= held.reading <= q[round(1 - a, 3)] for a in tails)
            found = Found(float(band.mean[0]), float(band.sd["total"][0]), inside)
            out.setdefault(HELD_OUT, {})[held.blade] = found
    return out


def _one(posterior: Posterior, name: str, truth: float) -> Found:
    x, w = posterior.column(name), posterior.particles.w
    mean = float(w @ x)
    off = abs(published_cdf(x, w, truth) - 0.5)
    inside = tuple(off <= p / 2 for p in PROBABILITIES)
    return Found(mean, float(np.sqrt(w @ (x - mean) ** 2)), inside)


def run(
    variant: Variant,
    *,
    rotors: int,
    disturbed: int,
    seed: int,
    particles: int = 1000,
    progress: Callable[[int], None] | None = None,
) -> list[Record]:
    """Cases of `PLAIN` on all rotors, those with a discrepancy on the first `disturbed` ones."""
    records: list[Record] = []
    model = rotor_blade()
    for r in range(rotors):
        clean = drawn(model, variant, r, seed)
        cases = (*PLAIN, *(WITH_DISCREPANCY if r < disturbed else ()))
        data = {"none": clean}
        data |= {
            k: with_delta(model_with(k), clean, r, seed) for k in {c.data for c in cases} - {"none"}
        }
        records.append({c: outcome(c, data[c.data], particles, seed) for c in cases})
        if progress is not None:
            progress(r + 1)
    return records


def same_in_turn(model: Model, variant: Variant, rotor: int, seed: int, particles: int) -> bool:
    """True where the sealed state after outage upon outage is that of all readings at once."""
    made = drawn(model, variant, rotor, seed)
    spec = RotorSpec(f"rotor-{made.cluster}", tuple(made.local), particles, seed)
    state, seen = None, list[Inspection]()
    for _, own in instants(made.readings):
        seen += own
        state = update(model, spec, seen, state)
    return state is not None and state.digest == update(model, spec, made.readings).digest
