"""What a report shows of a diagnosis beside its numbers; plain JSON, computed with the particles.

readings     each as both models predict it from all the others (`core.diagnosis.left_out`)
courses      each blade that is on the rotor itself (no reading's noise) over the hours, by both
             models: 2.5, 50 and 97.5 % of the posterior, mean and sd; and the hours at which it was
             read last, by whatever quantity (0: never)
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
from core.calibration.state import Posterior, RotorState, blade_posterior
from core.diagnosis.case import Case
from core.diagnosis.densities import LEVELS, amplitude_picture, parameter_pictures, short
from core.diagnosis.diagnose import Diagnosis
from core.diagnosis.grammar import Facts
from core.diagnosis.left_out import left_out
from core.model import Model
from core.observation import Inspection
from core.prediction import Prediction, predict
from core.rng import stream

Array = NDArray[np.float64]
Json = dict[str, Any]
SCHEMA = 1
HOURS = 33  # of a course, from its beginning on in steps that grow: creep is fast at first
ENOUGH = 512  # equally weighted particles of a blade for its course: the sd errs by 3 %


def pictures(found: Diagnosis, case: Case) -> Json:
    """All of it; readings of several values are counted, not shown."""
    (model, state), (model_after, state_after) = found.before, found.after
    changed = state_after is not state
    before = left_out(case.seen(model, state, whole=True))
    after = left_out(case.seen(model_after, state_after, whole=True)) if changed else before
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
        "amplitudes": [amplitude_picture(e.cell, model, *found.after) for e in found.effects],
        "parameters": parameter_pictures(found),
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
    return {"mean": short(mean), "sd": short(sd), "z": round(float(z), 3)}


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
    hours = model.part(quantity).horizon_h * np.linspace(0.0, 1.0, HOURS) ** 2
    before = _courses(model, state, case, quantity, hours)
    same = found.after[1] is state
    return {
        "quantity": quantity,
        "unit": model.network.quantity(quantity).unit,
        "time_h": hours.tolist(),
        "blades": list(case.present),
        "now_h": [float(case.read_h.get(blade, 0.0)) for blade in case.present],
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
    first = {id(model.for_blade(b)): b for b in reversed(case.present)}.values()
    made = {b: course(b) for b in first}
    rest = [b for b in case.present if b not in made]
    made |= zip(rest, POOL.map(course, rest), strict=True)
    for blade in case.present:
        got = made[blade]
        rows = (got.mean, got.sd["total"], got.lower, got.quantiles[LEVELS[1]], got.upper)
        for name, row in zip(told, rows, strict=True):
            told[name].append([short(v) for v in row])
    return told
