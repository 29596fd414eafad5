"""Residuals behind the `Science` port: `core.diagnosis.residuals` and `omnibus` as plain data.

They are computed from the readings that count, as a diagnosis is, so that they are a function of
readings, seed and algorithm. Imported when it is first needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from core.calibration.state import RotorSpec
from core.diagnosis import Facts
from core.diagnosis.clock import with_offsets
from core.diagnosis.foretold import DRAWS
from core.diagnosis.omnibus import FAMILY, omnibus
from core.diagnosis.residuals import residuals
from core.diagnosis.visits import Residual, Visit
from core.model import Model
from core.observation import Inspection
from core.rng import stream
from service.ports import BladeRecord, Json, Progress

Array = NDArray[np.float64]


def computed(
    model: Model,
    spec: RotorSpec,
    blades: Sequence[BladeRecord],
    readings: Sequence[Inspection],
    progress: Progress,
) -> Json:
    """Every reading's residual, and the tests. Raises InputError where no reading counts."""
    facts = with_offsets({b.id: Facts(b.lot, b.coating_lot) for b in blades}, readings, {})
    return told(residuals(model, spec, readings, facts, progress), facts, spec.seed)


def told(visits: Sequence[Visit], facts: Mapping[str, Facts], seed: int) -> Json:
    """Visits and their tests as plain data."""
    found = omnibus(visits, facts, seed)
    return {
        "residuals": [_residual(r) for visit in visits for r in visit.residuals],
        "visits": [_visit(k, visit) for k, visit in enumerate(visits)],
        "tests": [
            {
                "grouping": t.grouping,
                "value": t.value,
                "statistic": t.statistic,
                "count": t.count,
                "score": t.score,
                "p": t.p,
                "p_family": t.p_family,
                "alarm": t.alarms,
            }
            for t in found.tests
        ],
        "alarms": len(found.alarms),
        "family_wise_error": FAMILY,
        "draws": found.draws,
        "freedom": found.freedom,
    }


def _residual(r: Residual) -> Json:
    return {
        "inspection": r.reading.id,
        "blade": r.reading.blade,
        "quantity": r.reading.quantity,
        "campaign": r.reading.campaign,
        "instrument": r.reading.instrument,
        "time_h": float(r.reading.time_h),
        "rotor_h": float(r.hour),
        "visit": r.visit + 1,
        "part": r.part,
        "y": r.y,
        "mean": r.mean,
        "sd": r.sd,
        "z": r.z,
        "pit": r.pit,
    }


def _visit(number: int, visit: Visit) -> Json:
    hours = [r.hour for r in visit.residuals]
    return {
        "visit": number + 1,
        "readings": len({r.reading.id for r in visit.residuals}),
        "from_h": float(min(hours)),
        "to_h": float(max(hours)),
        "health": visit.health.get("status"),
        "reasons": visit.health.get("reasons", []),
    }


def exact_visit(
    readings: Sequence[Inspection],
    number: int,
    mean: Array,
    signal: Array,
    noise: Array,
    seed: int,
) -> Visit:
    """A visit whose predictive is normal: covariance `signal` (n, n) and the noise's sd (n,)."""
    covariance = signal + np.diag(noise**2)
    sd = np.sqrt(np.diag(covariance))
    y = np.array([float(r.values[0]) for r in readings])
    z = (y - mean) / sd
    rows = tuple(
        Residual(
            r, 0, number, float(r.time_h), *map(float, (y[i], mean[i], sd[i], z[i], ndtr(z[i])))
        )
        for i, r in enumerate(readings)
    )
    rng = stream(seed, "residuals", str(number))
    drawn = rng.multivariate_normal(np.zeros(len(y)), signal, DRAWS, method="eigh") / sd
    spread = np.broadcast_to(noise / sd, drawn.shape)
    return Visit(rows, covariance / np.outer(sd, sd), drawn, spread, {"status": "ok"})
