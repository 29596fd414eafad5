"""The quick way to a state: on the nodes of the one before, until it is sealed (`online`).

The touched blades' messages move log p at the nodes; every other blade moves through the weights.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.calibration.health import blamed, contradictions
from core.calibration.looked import told_of
from core.calibration.sets import Nodes
from core.calibration.state import RotorState
from core.calibration.step import Step
from core.rng import seed_of
from core.smc.particles import log_sum_exp, tempering_exponent

Array = NDArray[np.float64]
QUICK_ESS = 0.1  # share of the nodes that must carry the weight, tempered if need be
LEAST_TEMPERING = 0.2  # below this exponent the nodes are placed anew at once
MANY = 4  # touched blades above which nothing is tempered
FIRST = 12  # touched blades that are looked at before all, where there are more
MANY_ESS, FIRST_ESS = 0.2, 0.5  # shares of the nodes that they must leave, or all is placed anew
PROVISIONAL = 4000  # draws of a touched blade until its rotor is sealed; bands rest on as many


def tempering(log_w: Array, share: float = QUICK_ESS) -> float:
    """The exponent in [0, 1] that leaves a share of the nodes effective; NaN stays NaN."""
    if np.isnan(log_w).any():
        return float("nan")
    return tempering_exponent(log_w, share * len(log_w))


def reweighted(step: Step, previous: RotorState) -> tuple[Array, dict[str, Array]] | None:
    """log p at the nodes of the state before, and the touched blades' columns.

    log p moves by the difference of these columns: no other blade is looked at. None where
    the shared parameters are others now, a touched blade is `bounded`, or too few nodes would carry
    the weight; where many blades are touched nothing is tempered, and a few of them are looked at
    before all.
    """
    if not step.fits(previous):
        return None
    old, unread = previous.arrays, step.unread(previous)
    unit = old["shared/unit"]
    touched = [b for b in sorted(step.messages) if b not in unread]
    before = [b for b in sorted(previous.meta["readings"]) if b not in unread]
    told = previous.meta["health"].get("contradicted", [])
    if any(one.get("bounded") and one["blade"] not in unread for one in told):
        return None  # its floor was made for other readings
    many = len(touched) > MANY
    looks = [(MANY_ESS if many else QUICK_ESS, touched, before)]
    if len(touched) > FIRST:
        few = sorted(touched, key=lambda blade: seed_of(0, blade))[:FIRST]
        looks.insert(0, (FIRST_ESS, few, [b for b in before if b in few]))
    for share, blades, replaced in looks:
        log_p = old["shared/log_p"].copy()
        for blade in replaced:
            log_p -= old[f"column/{blade}"]
        columns = step.work.columns.all({b: step.messages[b] for b in blades}, unit, "near")
        log_p += sum(columns.values(), np.zeros(len(unit)))
        beta = tempering(log_p - old["shared/log_q"] + old["shared/tilt"], share)
        if not beta >= (1.0 if many else LEAST_TEMPERING):  # or not a number
            return None
    return log_p, columns


def provisional(
    step: Step, previous: RotorState, found: tuple[Array, dict[str, Array]]
) -> RotorState:
    """The state on the nodes of the one before, which keep their tilt (`surface`).

    Touched blades get fewer draws for now.
    """
    (log_p, columns), old, unread = found, previous.arrays, step.unread(previous)
    whole = log_p - old["shared/log_q"] + old["shared/tilt"]
    beta = tempering(whole)
    log_w = beta * whole
    unit, key = old["shared/unit"], bytes.fromhex(previous.meta["placement"])
    own = {"shared/log_p": log_p, "shared/log_w": log_w - log_sum_exp(log_w)}
    kept = {"shared/unit", "shared/x", "shared/log_q", "shared/tilt"}
    count = step.per_node(len(unit), min(step.rotor.particles, PROVISIONAL))
    due = [b for b in step.rotor.blades if b not in unread]
    thin = {b for b in previous.meta["provisional"] if b in unread} | set(due)
    for blade in step.rotor.blades:
        if blade in unread:
            kept |= {f"blade/{blade}/local", f"blade/{blade}/log_w"}
            if blade in step.messages:
                kept.add(f"column/{blade}")
    own |= step.drawn(due, Nodes(unit, key, count), columns)
    arrays = old.over(own, kept)
    best = unit[[int(np.argmax(log_p))]]
    accused = contradictions(step.messages, columns, unit, log_p)
    bad = [one | {"bounded": False} for one in blamed(step.messages, accused, best)]
    before = previous.meta["health"].get("contradicted", [])
    bad += [one for one in before if one["blade"] in unread]
    told = told_of(previous.meta["health"], unread)
    error = step.message_error(unit, previous)
    return step.state(
        own,
        arrays,
        key,
        log_w,
        error,
        bad,
        told,
        step.few_draws(own, previous, unread),
        sealed=False,
        thin=thin,
        tempered=beta,
        untempered=whole,
    )
