"""A diagnosis as data: everything that was tried, what is said, and why; plain JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from core.calibration.state import RotorState, shared_posterior
from core.diagnosis.adopt import amplitude_of
from core.diagnosis.case import Case
from core.diagnosis.diagnose import Diagnosis
from core.diagnosis.grammar import Cell
from core.diagnosis.report import BeforeAfter, Scored
from core.diagnosis.verdict import Verdict, describe

Json = dict[str, Any]


def to_json(
    found: Diagnosis,
    case: Case,
    compared: BeforeAfter | None = None,
    pictures: Json | None = None,
    separating: Json | None = None,
) -> Json:
    """Verdict, effects with amplitudes, evidence, everything tried, before and after.

    pictures    what a report shows of it (`core.diagnosis.pictures`)
    separating  inspections that would split what is not separable (`core.diagnosis.separate`)
    """
    verdict = found.verdict
    return {
        "verdict": verdict.word,
        "names": list(verdict.names),
        "reasons": list(verdict.reasons),
        "p": verdict.p,
        "p_after": verdict.after,
        "effects": [
            {
                **cell_json(e.cell),
                "amplitude": {"mean": e.mean, "sd": e.sd, "of": amplitude_of(e.cell)},
            }
            for e in found.effects
        ],
        "claimed": verdict.word == "effect",
        "gained_nat": found.gained,
        "evidence": verdict.evidence,
        "calibrated": [{"names": list(names), "gained_nat": gain} for names, gain in found.tried],
        "no_room": [{"names": list(names), "why": why} for names, why in found.refused],
        "tried": tried(found.first),
        "holds": [{**asdict(h), "agrees": h.agrees} for h in verdict.held],
        "parameters": {
            "before": shared(found.before[1]),
            "after": shared(found.after[1]),
        },
        "readings": {
            "delivered": len(case.readings),
            "used": int(found.before[1].meta["events"]),
        },
        "models": {"before": found.before[0].digest, "after": found.after[0].digest},
        "before_after": None if compared is None else compared_json(compared),
        "pictures": pictures,
        "separating": separating,
    }


def cell_json(cell: Cell) -> Json:
    """A cell, with what it is called and what happens."""
    return {
        "name": cell.name,
        "words": describe(cell),
        "family": cell.family.name,
        "kind": cell.family.kind,
        "on": cell.family.target,
        "target": cell.family.of,
        "how": cell.family.how,
        "shape": cell.shape,
        "whom": cell.whom,
        "value": cell.value,
        "clock": cell.family.clock,
        "step_h": cell.step_h,
    }


def tried(first: Verdict) -> list[Json]:
    """Every family and whom, by the log of its mean Bayes factor, largest first."""
    order = sorted(first.tried.items(), key=lambda item: (-item[1], item[0]))
    return [{"what": name, "log_bf": gain} for name, gain in order]


def shared(state: RotorState) -> Json:
    """Mean and sd of every shared parameter."""
    found = shared_posterior(state.meta, state.arrays.__getitem__)
    sd = np.sqrt(np.diag(found.particles.covariance))
    return {
        name: {"mean": float(m), "sd": float(s)}
        for name, m, s in zip(found.names, found.particles.mean, sd, strict=True)
    }


def compared_json(compared: BeforeAfter) -> Json:
    """Both models on readings that neither used, and the fleet's forecast."""
    (m0, s0), (m1, s1) = compared.forecast
    return {
        "quantity": compared.quantity,
        "held_out": list(compared.held),
        "before": scored_json(compared.before),
        "after": scored_json(compared.after),
        "forecast": {
            "time_h": compared.horizon_h,
            "before": {"mean": m0, "sd": s0},
            "after": {"mean": m1, "sd": s1},
        },
    }


def scored_json(one: Scored) -> Mapping[str, Any]:
    """Scores on held-out readings."""
    return {**asdict(one), "z": [round(z, 3) for z in one.z]}
