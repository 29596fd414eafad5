"""What a calibration of the paper's example foresees, beside readings and finite elements.

`told` makes plain JSON of one case; a page and its verdicts rest on that alone. What the pictures
need besides (draws, courses, scans) is a `Drawn`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.blade import BOUNDS
from core.builtin.inspection_plan import (
    NOISE,
    SCANNED,
    Plan,
    blades,
)  # fmt: skip
from core.calibration.state import Posterior
from core.diagnosis.densities import quantiles
from core.model import Model
from core.prediction import predict
from core.validation.paper import SHOWN, THETA_SD, Stage, model_with, readings_of
from core.validation.paper_above import LEVELS
from core.validation.paper_scan import Scan
from service.studies.paper.scans import Missed, missed, off

Array = NDArray[np.float64]
Json = dict[str, Any]
DRAWS = 600  # of a posterior, for its picture: about as many as nodes carry it
COURSE = tuple(1000.0 * k for k in range(1, 41))  # hours


@dataclass(frozen=True)
class Course:
    """A scalar over `time_h`: mean, sd of the blade (no reading) and of a reading, all (T,)."""

    time_h: Array
    mean: Array
    blade: Array
    total: Array


@dataclass(frozen=True)
class Drawn:
    """What the pictures of a stage show."""

    outages: int
    shown: Posterior
    scanned: Posterior
    destroyed: Mapping[str, Posterior]
    elongation: Course
    ceeq: Mapping[str, Course]
    scans: Sequence[Missed]


Told = tuple[Json, Drawn]


def truth_of(plan: Plan, blade: str) -> dict[str, float]:
    """What a blade's posterior should hold, by name; a theta that the data lack has none."""
    x = plan.inputs[blades().index(blade)]
    return dict(zip(BOUNDS, x.tolist(), strict=True)) | {
        f"sigma_obs.{q}": sd for q, sd in NOISE.items()
    }


def told(
    delta: bool, stages: Iterable[Stage], plan: Plan, scan: Scan, known: dict[str, Told]
) -> list[Told]:
    """Numbers and picture material of each stage; `known` by digest of step 2's state."""
    model, found = model_with(delta), list[Told]()
    for stage in stages:
        if stage.digest not in known:
            known[stage.digest] = _stage(model, stage, plan, scan)
        numbers, drawn = known[stage.digest]
        found.append((numbers | {"cpu_s": round(stage.cpu_s, 1)}, drawn))
    return found


def _stage(model: Model, stage: Stage, plan: Plan, scan: Scan) -> Told:
    elongation = course(model, stage.shown, LEVELS["multi"], COURSE)
    ceeq = {b: course(model, p, LEVELS["destroyed"], COURSE) for b, p in stage.destroyed.items()}
    scans = [missed(model, stage, plan, scan, k) for k in range(stage.outages + 1)]
    numbers: Json = {
        "outages": stage.outages,
        "shown": parameters(stage.shown, truth_of(plan, SHOWN)),
        "scanned": parameters(stage.scanned, truth_of(plan, SCANNED)),
        "destroyed": {b: parameters(p, truth_of(plan, b)) for b, p in stage.destroyed.items()},
        "ridge": _ridge(stage.scanned),
        "elongation": readings(model, stage.shown, LEVELS["multi"], SHOWN, plan, stage.outages),
        "ceeq": {
            b: readings(model, p, LEVELS["destroyed"], b, plan, stage.outages)
            for b, p in stage.destroyed.items()
        },
        "scans": [off(one) for one in scans],
        "held": held(stage),
        "health": stage.health,
        "digest": stage.digest,
    }
    thin = {b: _thin(p) for b, p in stage.destroyed.items()}
    return numbers, Drawn(
        stage.outages, _thin(stage.shown), _thin(stage.scanned), thin, elongation, ceeq, scans
    )


def _thin(posterior: Posterior) -> Posterior:
    drawn = posterior.particles.resampled(DRAWS, np.random.default_rng(0))
    return Posterior(posterior.names, drawn)


def parameters(posterior: Posterior, truth: Mapping[str, float]) -> dict[str, Json]:
    """Mean, sd and 95 % interval of each parameter, with its truth where it has one."""
    w, out = posterior.particles.w, dict[str, Json]()
    for name in posterior.names:
        x = posterior.column(name)
        mean = float(w @ x)
        low, high = quantiles(x, w, (0.025, 0.975))
        out[name] = {
            "mean": mean,
            "sd": float(np.sqrt(w @ (x - mean) ** 2)),
            "low": low,
            "high": high,
            "truth": truth.get(name),
        }
    return out


def _ridge(posterior: Posterior) -> Json | None:
    """theta1 and theta2 of the elongation: their correlation, and the sd of the combination that
    the data tell best and of the one they tell least, over the prior's."""
    names = [f"theta{i}.{LEVELS['multi']}" for i in (1, 2)]
    if not set(names) <= set(posterior.names):
        return None
    at = [posterior.names.index(n) for n in names]
    cov = posterior.particles.covariance[np.ix_(at, at)]
    sd = np.sqrt(np.diag(cov))
    best, least = np.sqrt(np.linalg.eigvalsh(cov)) / THETA_SD
    return {
        "correlation": float(cov[0, 1] / (sd[0] * sd[1])),
        "best_told": float(best),
        "least_told": float(least),
    }


def course(model: Model, posterior: Posterior, quantity: str, hours: Sequence[float]) -> Course:
    """A scalar or a field at its node over the hours."""
    got = predict(model, posterior, quantity, hours)
    blade = np.sqrt(got.sd["total"] ** 2 - got.sd["noise"] ** 2)
    return Course(np.array(hours), got.mean, blade, got.sd["total"])


def readings(
    model: Model, posterior: Posterior, quantity: str, blade: str, plan: Plan, outages: int
) -> list[Json]:
    """A blade's readings up to the held-out one, each with what is foreseen and the truth.

    used   whether the posterior rests on it
    """
    clean = {"elongation": plan.elongation, "ceeq": plan.ceeq}[quantity][blades().index(blade)]
    told = [
        (r.time_h, float(r.values[0]), int(str(r.campaign)[-1]) <= outages)
        for r in readings_of(plan, [blade])
        if r.quantity == quantity
    ]
    if quantity == LEVELS["multi"] and blade in plan.held_out:
        told.append((*plan.held_out[blade], False))
    got = course(model, posterior, quantity, [t for t, _, _ in told])
    return [
        {
            "time_h": t,
            "reading": y,
            "used": used,
            "truth": float(np.interp(t, plan.time_h, clean)),
            "mean": float(got.mean[i]),
            "sd_blade": float(got.blade[i]),
            "sd": float(got.total[i]),
        }
        for i, (t, y, used) in enumerate(told)
    ]


def held(stage: Stage) -> Json | None:
    """All blades' elongations at the held-out outage."""
    if not stage.held:
        return None
    y, mean, sd, below = np.array(list(stage.held.values())).T
    return {
        "readings": len(y),
        "rmse_mm": float(np.sqrt(np.mean((y - mean) ** 2))),
        "bias_mm": float(np.mean(y - mean)),
        "sd_mm": float(np.sqrt(np.mean(sd**2))),
        "inside_68": float(np.mean(np.abs(below - 0.5) <= 0.34)),
        "inside_95": float(np.mean((below >= 0.025) & (below <= 0.975))),
    }


def surrogate(plan: Plan) -> Json:
    """The surrogate at the true inputs against finite elements it never saw: Sec. 4.2.

    r2 of elongation and of CEEQ at the critical node, over all blades and instants from 1,000 h;
    contest: what the regressors left at the model's making.
    """
    model = model_with(False)
    part = model.part("ceeq")
    late = plan.time_h >= 1000.0
    hours, found = plan.time_h[late], Json()
    nodes = {"elongation": None, "ceeq": [part.named["critical"]]}
    for quantity, truth in (("elongation", plan.elongation), ("ceeq", plan.ceeq)):
        mean = part.predict(plan.inputs, quantity, hours, nodes[quantity])[0]
        mean, clean = mean.reshape(len(mean), -1), truth[:, late]
        found[quantity] = {
            "r2": float(1 - np.sum((clean - mean) ** 2) / np.sum((clean - clean.mean()) ** 2)),
            "rmse": float(np.sqrt(np.mean((clean - mean) ** 2))),
            "median_percent": float(100 * np.median(np.abs(mean / clean - 1))),
        }
    manifest = getattr(model.surrogate, "manifest", {})
    found["contest"] = manifest.get("contest", [])
    found["runs"] = manifest.get("runs", {}).get("training")
    return found
