"""Questions to the twin: a diagnosis, a plan, residuals.

A diagnosis asks by chi-square whether each blade's elongations lie on a line through zero; it knows
no effects, so that what it finds is unattributed. A plan conditions on each blade's elongation
exactly. Residuals are those of each hour's elongations, predicted from the hours before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, MutableMapping, Sequence
from typing import Any

import numpy as np
from scipy.special import chdtrc

from core.errors import InputError
from core.observation import Inspection
from service.fake.conjugate import HORIZON_H, SIGMA, FakeState, moments
from service.ports import BladeRecord, Get, Json, ModelCard, PlanTarget, Progress, RotorSpec

ALARM = 0.05


def diagnosed(
    card: ModelCard,
    rotor: RotorSpec,
    readings: Sequence[Inspection],
    progress: Progress,
    delay_s: float,
    kept: MutableMapping[str, Any],
) -> Json:
    """Chi-square of the residuals of each blade's line, n - 1 degrees of freedom each.

    kept  blades that an earlier attempt had looked at: they cost no time
    """
    chi2, freedom = 0.0, 0
    for done, blade in enumerate(rotor.blades):
        progress(f"blade {blade}", done, len(rotor.blades))
        if kept.setdefault(blade, False) is False:
            time.sleep(delay_s)
            kept[blade] = True
        own = [r for r in readings if (r.blade, r.quantity) == (blade, "elongation")]
        h = np.array([r.time_h / HORIZON_H for r in own])
        y = np.array([float(r.values[0]) for r in own])
        w = np.array([1.0 / (r.sigma or SIGMA) ** 2 for r in own])
        n, s = float(w @ h**2), float(w @ (h * y))
        if len(own) > 1 and n > 0:
            chi2 += float(w @ (y - s / n * h) ** 2)
            freedom += len(own) - 1
    p = float(chdtrc(freedom, chi2)) if freedom else 1.0
    why = f"chi-square {chi2:.1f} of {freedom} degrees of freedom: p = {p:.3g}"
    return {
        "verdict": "adequate" if p > ALARM else "unattributed",
        "names": [],
        "reasons": [why],
        "p": p,
        "p_after": None,
        "effects": [],
        "claimed": False,
        "gained_nat": 0.0,
        "evidence": {},
        "calibrated": [],
        "no_room": [],
        "tried": [],
        "holds": [],
        "parameters": {"before": {}, "after": {}},
        "readings": {"delivered": len(readings), "used": len(readings)},
        "models": {"before": card.digest, "after": card.digest},
        "before_after": None,
        "adds": None,
    }


def planned(
    get: Get, blades: Sequence[BladeRecord], readings: Sequence[Inspection], target: PlanTarget
) -> Json:
    """Each blade's elongation at its latest hour, singly, by exact conditioning."""
    latest = {b.id: HORIZON_H / 2 for b in blades}
    latest |= {r.blade: r.time_h for r in sorted(readings, key=lambda r: r.time_h)}
    own = {b.id: moments(get, b.id) for b in blades}
    aim = np.ones(2) if target.parameter is None else np.array([1.0, 0.0])
    if target.parameter == "offset":
        aim = np.array([0.0, 1.0])
    hour = 1.0 if target.time_h is None else target.time_h / HORIZON_H
    mean, covariance = moments(get, target.blade or blades[0].id)
    variance = float(aim @ covariance @ aim) * hour**2
    single = []
    for b in blades:
        h = max(latest[b.id], 1.0) / HORIZON_H
        of_blade = own[b.id][1]
        seen = float(of_blade.sum()) * h**2 + SIGMA**2
        if b.id == target.blade:
            shared = float(aim @ covariance @ np.ones(2))
        else:
            shared = float((aim @ covariance)[0] * of_blade[0].sum() / covariance[0, 0])
        left = float(np.sqrt(max(variance - (shared * hour * h) ** 2 / seen, 0.0)))
        told = {"blade": b.id, "quantity": "elongation", "time_h": h * HORIZON_H}
        told |= {"ahead_h": 0.0, "instrument": None, "sigma": None, "sd_after": left}
        single.append(told | {"narrower": 1 - left / variance**0.5 if variance else 0.0})
    single.sort(key=lambda one: (one["sd_after"], one["blade"]))
    centre = float(aim @ mean) * hour
    return {
        "unit": "mm",
        "mean": centre,
        "sd": variance**0.5,
        "single": single,
        "set": single[:1],
    }


def residuals_of(
    update: Callable[[Sequence[Inspection]], FakeState],
    rotor: RotorSpec,
    facts: Sequence[BladeRecord],
    readings: Sequence[Inspection],
    progress: Progress,
) -> Json:
    """Elongations of each hour, predicted exactly from those of the hours before.

    update  gives the posterior of the readings before a visit
    """
    from core.diagnosis.grammar import Facts
    from core.diagnosis.visits import visits_of
    from service.residuals import exact_visit, told

    own = [r for r in readings if r.quantity == "elongation"]
    if not own:
        raise InputError("readings", 0, "of elongation count", "post inspections")
    lots = {b.id: Facts(b.lot, b.coating_lot) for b in facts}
    visits, before, found = visits_of(own, lots), list[Inspection](), []
    for number, visit in enumerate(visits):
        progress(f"visit {number + 1}", number, len(visits))
        state = update(before)
        h = np.array([r.time_h / HORIZON_H for r in visit])
        one = [moments(state.arrays.__getitem__, r.blade) for r in visit]
        variance = state.arrays["shared/moments"][1]
        lean = np.array([1.0 + covariance[0, 1] / variance for _, covariance in one])
        signal = variance * np.outer(h * lean, h * lean)
        for i, r in enumerate(visit):
            for j, other in enumerate(visit):
                if r.blade == other.blade:
                    signal[i, j] = one[i][1].sum() * h[i] * h[j]
        mean = np.array([m.sum() for m, _ in one]) * h
        noise = np.array([r.sigma or SIGMA for r in visit])
        found.append(exact_visit(visit, number, mean, signal, noise, rotor.seed))
        before += visit
    return told(found, lots, rotor.seed)
