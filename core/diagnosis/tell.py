"""A diagnosis as data: everything that was tried, what is said, and why; plain JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from core.calibration.state import RotorState, shared_posterior
from core.diagnosis import noticed
from core.diagnosis.adopt import amplitude_of, frees
from core.diagnosis.alternatives import Alternatives
from core.diagnosis.case import Case
from core.diagnosis.densities import amplitude_unit
from core.diagnosis.diagnose import Diagnosis, Effect
from core.diagnosis.grammar import Cell
from core.diagnosis.noticed import Noticed
from core.diagnosis.report import BeforeAfter, Scored
from core.diagnosis.verdict import Verdict, describe
from core.diagnosis.widen import EARNED, Widened
from core.model import Model
from core.quantity import Discrepancy

Json = dict[str, Any]


def to_json(
    found: Diagnosis,
    case: Case,
    compared: BeforeAfter | None = None,
    pictures: Json | None = None,
    separating: Json | None = None,
    wide: Widened | None = None,
    others: Alternatives | None = None,
    unseen: Sequence[Noticed] | None = None,
) -> Json:
    """Verdict, effects with amplitudes, evidence, everything tried, before and after.

    pictures    what a report shows of it (`core.diagnosis.pictures`)
    separating  inspections that would split what is not separable, or too many names to claim one
                (`core.diagnosis.separate`)
    wide        what a lack without a name makes of the bands (`core.diagnosis.widen`)
    others      forecasts by the rivals of what is in the model (`core.diagnosis.alternatives`)
    unseen      where nothing was found, from which size on it would have been
    """
    verdict = found.verdict
    after = found.after
    if wide is not None and wide.borne_out:
        after = wide.model, wide.state
    return {
        "verdict": verdict.word,
        "names": list(verdict.names),
        "beside": list(verdict.beside),
        "several": list(verdict.several),
        "reasons": [
            *verdict.reasons,
            *([] if wide is None else [in_words(wide)]),
            *([] if unseen is None else noticed.in_words(unseen)),
        ],
        "p": verdict.p,
        "dealt": case.dealt,
        "p_after": verdict.after,
        "effects": [effect_json(e, found.before[0]) for e in found.effects],
        "claimed": verdict.word == "effect",
        "gained_nat": found.gained,
        "evidence": verdict.evidence,
        "calibrated": [_calibrated(cells, gain) for cells, gain in found.tried],
        "no_room": [{"names": list(names), "why": why} for names, why in found.refused],
        "tried": tried(found.first),
        "holds": [h.to_json() for h in verdict.held],
        "concerns": [c.to_json() for c in verdict.concerns],
        "placebos": [p.to_json() for p in found.placebos],
        "parameters": {
            "before": shared(found.before[1]),
            "after": shared(after[1]),
        },
        "readings": {
            "delivered": len(case.readings),
            "used": int(found.before[1].meta["events"]),
        },
        "models": {"before": found.before[0].digest, "after": after[0].digest},
        "before_after": None if compared is None else compared_json(compared),
        "pictures": pictures,
        "separating": separating,
        "alternatives": None if others is None else others.to_json(),
        "widened": None if wide is None else widened_json(wide),
        "noticed": None if unseen is None else noticed.noticed_json(unseen, found.before[0]),
    }


def widened_json(wide: Widened) -> Json:
    """A discrepancy without a name, and how much of the bands it is."""
    return {
        "quantity": wide.quantity,
        "discrepancy": discrepancy_json(wide.discrepancy),
        "gained_nat": wide.gained,
        "borne_out": wide.borne_out,
        "time_h": wide.hour_h,
        "share": wide.share,
        "sd": {"before": wide.sds[0], "after": wide.sds[1]},
    }


def discrepancy_json(declared: Discrepancy) -> Json:
    """As a network tells it: what is given, and no more."""
    return {k: v for k, v in asdict(declared).items() if v is not None and (k, v) != ("sigma", 0.0)}


def in_words(wide: Widened) -> str:
    """What a discrepancy without a name means."""
    what = f"a discrepancy of {wide.quantity} over operating hours, the same in all blades,"
    if not wide.settled:
        return f"{what} could not be calibrated: too few nodes carry its posterior"
    gains = f"{what} gains {wide.gained:z.1f} nat"
    if not wide.borne_out:
        return f"{gains}, where {EARNED:g} are asked for: it is left out"
    share = f"{wide.share:.0%} of the variance at {wide.hour_h:,.0f} h"
    return f"{gains} and is {share}; it names no cause"


def _calibrated(cells: Sequence[Cell], gained: float) -> Json:
    """A calibrated hypothesis: of one name several courses, or hours of a step, may be."""
    return {
        "names": [c.name for c in cells],
        "effects": [{"name": c.name, "shape": c.shape, "step_h": c.step_h} for c in cells],
        "gained_nat": gained,
    }


def effect_json(effect: Effect, before: Model) -> Json:
    """An effect that was calibrated, with its amplitude in the model that it went into."""
    of = amplitude_of(effect.cell, woken=frees(effect.cell, before.network))
    unit = amplitude_unit(effect.cell, before)
    return {
        **cell_json(effect.cell),
        "amplitude": {"mean": effect.mean, "sd": effect.sd, "of": of, "unit": unit},
    }


def cell_json(cell: Cell) -> Json:
    """A cell, with what it is called and what happens."""
    return {
        "name": cell.name,
        "words": describe(cell),
        "cause": cell.cause,
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
        "reference_h": cell.reference_h,
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
    """Both models on readings that neither calibration used (`report`), and the forecast."""
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
    found = {**asdict(one), "z": [round(z, 3) for z in one.z]}
    del found["means"]  # the page tells scores, not predictions
    return found
