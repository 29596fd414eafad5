"""The paper's numerical example (Sec. 4) on the shipped inspection plan, calibrated exactly.

Table 1: elongation of 100 blades at three outages, 3-D deformation of blade 01 at the same ones,
CEEQ of blades 28, 82 and 99, one at each. The readings are finite elements on a mesh that the
surrogate never saw, with noise (`core.builtin.inspection_plan`). Steps as in Sec. 4.3:

    2   elongations of all blades e     p(s | e) ∝ p(s) Π_b m_b(s)
    3   with blade 01's scans d         p(s | e, d) ∝ [p(s) Π_{b≠01} m_b(s)] m_01(s; e, d)
    4   step 2 again, with the CEEQ c   p(s | e, c) ∝ [p(s) Π_{b∉C} m_b(s)] Π_{b∈C} m_b(s; e, c)

for the shared parameters s (T1T, sigma_obs of each quantity, theta1 and theta2 of each discrepancy)
and C the blades cut up; each blade's own ones follow from its message. Where the paper holds one
level and samples the other, these are the joint posteriors. A bracket is step 2 without some
blades: its log density at step 2's nodes, less those blades' columns, is exact; between the nodes
it is a surface with a known error (`core.calibration.stored`).

*Offline* all outages are read at once; *online* outage upon outage, each state starting from the
one before. The target is the same, so the last online state must be the offline one bit for bit;
`Stage.digest` says whether it is. What the paper's own schedule makes of the same readings is
`scheduled`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from core.builtin.inspection_plan import DESTROYED, OUTAGES_H, SCANNED, Plan, blades
from core.calibration.online import Workspace, update
from core.calibration.schedule import Schedule, calibrate
from core.calibration.state import Posterior, RotorSpec, RotorState, blade_posterior
from core.errors import InputError
from core.model import Model
from core.network import Discrepancy
from core.observation import Inspection
from core.prediction import predict
from core.validation.paper_above import LEVELS, Above, above
from core.validation.schedule_rotors import plan_readings
from core.validation.variants import Variant, model_of

Array = NDArray[np.float64]
Strategy = Literal["offline", "online"]
SHOWN = "B090"  # the paper's blade of medium damage
NAMED = (SCANNED, *DESTROYED, SHOWN)
THETA_SD = 0.05  # prior sd of theta1 and theta2; the paper gives none
UPPER = ("scanned", "destroyed")


@dataclass(frozen=True, slots=True)
class Case:
    """One of the four calibrations; `delta`: with the paper's discrepancy, of every quantity."""

    strategy: Strategy
    delta: bool

    @property
    def name(self) -> str:
        """
        >>> Case("online", True).name
        'online, with delta'
        """
        return f"{self.strategy}, {'with' if self.delta else 'without'} delta"


WAYS: tuple[Strategy, ...] = ("offline", "online")
CASES = tuple(Case(s, d) for d in (False, True) for s in WAYS)


@dataclass(frozen=True)
class Stage:
    """What is known after so many outages.

    shown      posterior of blade 90 from elongations (step 2)
    scanned    of blade 01 with its scans (step 3)
    destroyed  of each blade that is cut up by then (step 4)
    held       elongations at the held-out outage: {blade: (reading, mean, sd, probability below)}
    health     of step 2's state, and of the two `Above`
    digest     of step 2's state; cpu_s: processor seconds, of `above` those of its first making
    """

    outages: int
    shown: Posterior
    scanned: Posterior
    destroyed: Mapping[str, Posterior]
    held: Mapping[str, tuple[float, float, float, float]]
    health: Mapping[str, Mapping[str, Any]]
    digest: str
    cpu_s: float


def model_with(delta: bool) -> Model:
    """The built-in model, with the paper's discrepancy of every quantity or without any."""
    if not delta:
        return model_of(Variant("paper"))
    wrong = tuple((quantity, Discrepancy("paper", sd=THETA_SD)) for quantity in LEVELS.values())
    return model_of(Variant("paper", wrong=wrong))


def chosen(count: int = 100) -> tuple[str, ...]:
    """So many of the plan's blades, those that the paper names always, and who replaced them.

    >>> chosen(6)
    ('B001', 'B028', 'B050', 'B082', 'B090', 'B099', 'B028-2', 'B082-2', 'B099-2')
    """
    every = [b for b in blades() if not b.endswith("-2")]
    if not len(NAMED) <= count <= len(every):
        raise InputError(
            "blades", count, "is no part of the plan", f"give {len(NAMED)} … {len(every)}"
        )
    others = [b for b in every if b not in NAMED]
    places = (np.arange(count - len(NAMED)) + 0.5) * len(others) / max(count - len(NAMED), 1)
    taken = {*NAMED, *(others[int(i)] for i in places)}
    return (*(b for b in every if b in taken), *(f"{b}-2" for b in DESTROYED))


def readings_of(plan: Plan, names: Iterable[str], outages: int = 3) -> list[Inspection]:
    """The plan's readings of these blades up to an outage."""
    known = {f"outage-{k + 1}" for k in range(outages)}
    return [r for r in plan_readings(plan, names) if r.campaign in known]


def calibrated(
    delta: bool,
    plan: Plan,
    names: Sequence[str],
    particles: int,
    seed: int,
    ways: Sequence[Strategy] = WAYS,
    tell: Callable[[str], None] | None = None,
) -> dict[Strategy, list[Stage]]:
    """The calibrations with or without delta: a stage of all outages, and one after each.

    Steps 3 and 4 are a function of step 2's state: where the last online state has the digest of
    the offline one, they are not computed again. Nothing else is shared between the two.

    tell   called with the name of each step when it is done
    """
    model, rotor = model_with(delta), RotorSpec("paper", tuple(names), particles, seed)
    last, found = len(OUTAGES_H), dict[Strategy, list[Stage]]()
    known: dict[str, tuple[Above, Above, float]] = {}
    for strategy in ways:
        work, state = Workspace(), None
        for outages in [last] if strategy == "offline" else range(1, last + 1):
            start = time.process_time()
            readings = readings_of(plan, names, outages)
            e = [r for r in readings if r.quantity == LEVELS["multi"]]
            state = update(model, rotor, e, state, workspace=work)
            spent, begun = time.process_time() - start, time.process_time()
            if tell is not None:
                tell(f"{strategy}, {outages}: elongations")
            if state.digest not in known:
                scanned, destroyed = (
                    above(model, rotor, state, readings, level) for level in UPPER
                )
                known[state.digest] = scanned, destroyed, time.process_time() - begun
                if tell is not None:
                    tell(f"{strategy}, {outages}: scans and CEEQ")
            scanned, destroyed, more = known[state.digest]
            stage = Stage(
                outages,
                blade_posterior(state.meta, state.arrays.__getitem__, SHOWN),
                scanned.posterior[SCANNED],
                destroyed.posterior,
                _held(model, state, plan) if outages == last else {},
                {
                    "multi": state.meta["health"],
                    "scanned": scanned.health,
                    "destroyed": destroyed.health,
                },
                state.digest,
                spent + more,
            )
            found.setdefault(strategy, []).append(stage)
    return found


def _held(
    model: Model, state: RotorState, plan: Plan
) -> dict[str, tuple[float, float, float, float]]:
    found = {}
    for blade, (hours, reading) in plan.held_out.items():
        if blade in state.meta["blades"]:
            posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
            band = predict(model, posterior, LEVELS["multi"], [hours])
            mean, sd = float(band.mean[0]), float(band.sd["total"][0])
            p, q = list(band.quantiles), [float(v[0]) for v in band.quantiles.values()]
            found[blade] = reading, mean, sd, float(np.interp(reading, q, p, 0.0, 1.0))
    return found


def scheduled(
    case: Case, plan: Plan, names: Sequence[str], particles: int, seed: int
) -> dict[str, Any]:
    """The paper's own schedule on the same readings: moments of what it arrives at.

    Steps 3 and 4 each go on from step 2 (Sec. 4.3). sd and mean of blade 01's parameters, of those
    it shares, sweeps, and whether they met the threshold.
    """
    start = time.process_time()
    rotor = RotorSpec("paper", tuple(names), particles, seed)
    schedule = Schedule(strategy=case.strategy, single="branches")
    got = calibrate(model_with(case.delta), rotor, readings_of(plan, names), schedule)
    return {
        "scanned": moments(got.blade(SCANNED)),
        "shown": moments(got.blade(SHOWN)),
        "sweeps": len(got.trace),
        "converged": all(got.converged.values()),
        "plain_ess": round(min(sweep.plain_ess for sweep in got.trace), 2),
        "cpu_s": round(time.process_time() - start, 1),
    }


def moments(posterior: Posterior) -> dict[str, dict[str, float]]:
    """Mean and standard deviation of each parameter."""
    w, psi = posterior.particles.w, posterior.particles.psi
    mean = w @ psi
    sd = np.sqrt(w @ (psi - mean) ** 2)
    return {
        n: {"mean": float(m), "sd": float(s)}
        for n, m, s in zip(posterior.names, mean, sd, strict=True)
    }
