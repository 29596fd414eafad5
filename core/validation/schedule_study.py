"""The paper's schedule against the joint posterior: how often it covers, how sharp it claims to be.

On simulated rotors (`core.validation.coverage.simulate`) every arm, a reading of Algorithm 1, sees
the readings that the joint calibration sees. Kept are where each truth falls in its posterior (the
probability integral transform, u), the ratio of posterior standard deviations sd / sd_joint, and
the distance |mean − mean_joint| / sd_joint. No rotor is dropped; sweeps that ran out count.

On the shipped inspection plan the paper's own findings are looked at: whether offline is sharper
than online, what a discrepancy sharpens and widens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from core.builtin.inspection_plan import Plan
from core.calibration.online import update
from core.calibration.schedule import Schedule, Scheduled, calibrate
from core.calibration.state import Posterior, RotorSpec, blade_posterior, shared_posterior
from core.model import Model
from core.observation import Inspection
from core.prediction import inputs_of, noise_of
from core.validation.coverage import pit, simulate

Array = NDArray[np.float64]
JOINT = "joint"
HELD_OUT = "held-out reading"
ARMS: Mapping[str, Schedule] = {
    "offline": Schedule(),
    "online": Schedule(strategy="online"),
    "offline, draws held": Schedule(fix="draws", draws=20, sweeps=20),
    "offline, last sweep as prior": Schedule(prior="last sweep", sweeps=10),
}
ENOUGH = 2000  # particles that a prediction rests on here


@dataclass
class Arm:
    """What was found for one arm: lists over rotors (shared) or over all blades (local), by name.

    pit   u of each truth;  sd   sd / sd_joint;  off   |mean − mean_joint| / sd_joint
    """

    pit: dict[str, list[float]] = field(default_factory=dict)
    sd: dict[str, list[float]] = field(default_factory=dict)
    off: dict[str, list[float]] = field(default_factory=dict)
    sweeps: list[int] = field(default_factory=list)
    converged: list[bool] = field(default_factory=list)

    def share(self, name: str, probability: float) -> float:
        """Share of truths inside the central interval of this probability."""
        return inside(self.pit[name], probability)

    def sd_ratio(self, name: str) -> float:
        """Median of sd / sd_joint."""
        return float(np.median(self.sd[name]))


def inside(u: Sequence[float], probability: float) -> float:
    """Share of u in the central interval of this probability.

    >>> inside([0.01, 0.4, 0.9], 0.9)
    0.6666666666666666
    """
    tail = (1 - probability) / 2
    return float(np.mean([tail <= v <= 1 - tail for v in u]))


def moments(posterior: Posterior, name: str) -> tuple[float, float]:
    """Mean and standard deviation of one parameter."""
    x, w = posterior.column(name), posterior.particles.w
    mean = float(w @ x)
    return mean, float(np.sqrt(w @ (x - mean) ** 2))


def reading_pit(
    model: Model,
    posterior: Posterior,
    quantity: str,
    time_h: float,
    value: float,
    psi: str | None = None,
) -> float:
    """Predictive probability below a reading that was held out.

    Σ w_i Φ((y − c_i Y_m,i) / sd_i) with c = 1 + theta1 − theta2 psi where there is a discrepancy,
    and with the surrogate's, the simulation's and the instrument's variance in sd_i².
    """
    thin = posterior
    if len(posterior.particles.log_w) > ENOUGH:
        cut = posterior.particles.resampled(ENOUGH, np.random.default_rng(0))
        thin = Posterior(posterior.names, cut)
    mean, sd = model.surrogate.predict(inputs_of(model, thin), quantity, np.array([time_h]))
    if psi is not None:
        one, two = (thin.column(f"{t}.{quantity}") for t in ("theta1", "theta2"))
        factor = (1 + one - two * thin.column(psi))[:, None]
        mean, sd = mean * factor, sd * factor
    sd = np.hypot(sd, model.network.quantity(quantity).numerical * mean)
    spread = np.hypot(sd[:, 0], noise_of(model, thin, quantity))
    return float(thin.particles.w @ ndtr((value - mean[:, 0]) / spread))


def run(
    model: Model,
    *,
    rotors: int,
    blades: int,
    times: Sequence[float],
    seed: int,
    particles: int = 1000,
    arms: Mapping[str, Schedule] = ARMS,
    quantity: str = "elongation",
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Arm]:
    """Every arm, and the joint calibration as ``joint``, on `rotors` simulated rotors."""
    found = {name: Arm() for name in (JOINT, *arms)}
    for r in range(rotors):
        shared, local, readings, held = simulate(model, r, blades, times, seed, quantity)
        spec = RotorSpec(f"simulated-{r}", tuple(local), particles, seed)
        state = update(model, spec, readings)
        get = state.arrays.__getitem__
        joint = shared_posterior(state.meta, get)
        own = {b: blade_posterior(state.meta, get, b) for b in local}
        _add(model, found[JOINT], shared, local, held, times[-1], quantity, joint, own, joint, own)
        for name, schedule in arms.items():
            got = calibrate(model, spec, readings, schedule)
            each = {b: got.blade(b) for b in local}
            arm = found[name]
            _add(
                model, arm, shared, local, held, times[-1], quantity, got.shared, each, joint, own
            )  # fmt: skip
            arm.sweeps.append(len(got.trace))
            arm.converged.append(all(got.converged.values()))
        if progress is not None:
            progress(r + 1, rotors)
    return found


def _add(
    model: Model,
    arm: Arm,
    shared: Mapping[str, float],
    local: Mapping[str, Mapping[str, float]],
    held: Array,
    time_h: float,
    quantity: str,
    posterior: Posterior,
    blades: Mapping[str, Posterior],
    joint: Posterior,
    joint_blades: Mapping[str, Posterior],
) -> None:
    """One rotor's truths against one posterior."""

    def compare(name: str, truth: float, one: Posterior, other: Posterior) -> None:
        u = pit(one.column(name), one.particles.w, truth)
        (mean, sd), (true_mean, true_sd) = moments(one, name), moments(other, name)
        arm.pit.setdefault(name, []).append(u)
        arm.sd.setdefault(name, []).append(sd / true_sd)
        arm.off.setdefault(name, []).append(abs(mean - true_mean) / true_sd)

    for name, truth in shared.items():
        compare(name, truth, posterior, joint)
    for b, (blade, values) in enumerate(local.items()):
        for name, truth in values.items():
            compare(name, truth, blades[blade], joint_blades[blade])
        u = reading_pit(model, blades[blade], quantity, time_h, float(held[b]))
        arm.pit.setdefault(HELD_OUT, []).append(u)


def plan_readings(plan: Plan, blades: Iterable[str]) -> list[Inspection]:
    """The shipped plan's readings of these blades."""
    wanted = set(blades)
    return [
        Inspection(
            body["id"],
            body["blade"],
            body["quantity"],
            body["time_h"],
            np.array(body["values"] if "values" in body else [body["value"]]),
            np.array(body["nodes"]) if "nodes" in body else None,
            unit=body["unit"],
            campaign=body["campaign"],
        )
        for body in plan.inspections
        if body["blade"] in wanted
    ]


def describe(
    model: Model,
    plan: Plan,
    shared: Posterior,
    blades: Mapping[str, Posterior],
    psi: str | None = None,
) -> dict[str, Any]:
    """Mean and sd of every shared parameter and, over blades, of local ones; held-out coverage.

    ``sd`` of a local parameter is the median over blades; ``blades`` has B001 (scanned) and B090
    (the paper's) by themselves.
    """
    local = [p.name for p in model.network.of_level("local")]
    each = {b: {n: moments(p, n) for n in local} for b, p in blades.items()}
    u = [
        reading_pit(model, blades[b], "elongation", t, y, psi)
        for b, (t, y) in plan.held_out.items()
        if b in blades
    ]
    return {
        "shared": {n: moments(shared, n) for n in shared.names},
        "sd": {n: float(np.median([e[n][1] for e in each.values()])) for n in local},
        "blades": {b: each[b] for b in ("B001", "B090") if b in each},
        "held_out_68": inside(u, 0.68),
        "held_out_95": inside(u, 0.95),
    }


def on_plan(
    model: Model,
    plan: Plan,
    blades: Sequence[str],
    schedule: Schedule | None,
    *,
    particles: int,
    seed: int,
) -> tuple[dict[str, Any], Scheduled | None]:
    """The shipped plan by one reading of the schedule, or jointly (None)."""
    spec = RotorSpec("plan", tuple(blades), particles, seed)
    readings = plan_readings(plan, blades)
    if schedule is None:
        state = update(model, spec, readings)
        get = state.arrays.__getitem__
        each = {b: blade_posterior(state.meta, get, b) for b in blades}
        return describe(model, plan, shared_posterior(state.meta, get), each), None
    got = calibrate(model, spec, readings, schedule)
    each = {b: got.blade(b) for b in blades}
    told = describe(model, plan, got.shared, each, schedule.discrepancy)
    told["sweeps"], told["converged"] = len(got.trace), dict(got.converged)
    told["plain_ess"] = min(s.plain_ess for s in got.trace)
    return told, got
