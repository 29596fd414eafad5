"""What else the readings allow: forecasts by the rivals of what is in the model.

What a cause is can be settled while its course in time is open: a coating that wears and one that
came off at once move three readings of a blade alike, and go on differently. A model has one
course, that with the most evidence, and a forecast by it alone is too sure. The rivals are the sets
of effects that were calibrated from the same readings, as many as are in the model, with the same
causes but for those that are open themselves (`conclude`); where some are open, and others sure,
the sure ones alone are one more. With log evidence L_k against the model as it was, and the prior
weight of each cell i that a set was chosen from (`search.prices`, c_i),

    w_k ∝ exp(L_k − Σ_i c_i)

are their shares. Of blade b's forecasts m_kb ± s_kb, without a reading's noise, together

    m_b = Σ_k w_k m_kb,      s_b² = Σ_k w_k (s_kb² + (m_kb − m_b)²)

over the blades that are on the rotor and concerned by what differs between rivals. What was not
calibrated has no share: the list is of what was looked at, not of all that could be.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import POOL
from core.calibration.state import RotorState
from core.diagnosis.adopt import concerned
from core.diagnosis.case import Case
from core.diagnosis.conclude import Rival, Turn
from core.diagnosis.grammar import Cell, Facts
from core.diagnosis.report import foreseen
from core.model import Model
from core.smc.particles import log_sum_exp

Array = NDArray[np.float64]
LEAST = 0.03  # share below which a rival is left out
MOST = 5


@dataclass(frozen=True, slots=True)
class Alternative:
    """A rival: its effects, its share of the evidence, its forecast and a blade's sd [unit]."""

    effects: tuple[Cell, ...]
    share: float
    mean: float
    sd: float


@dataclass(frozen=True, slots=True)
class Alternatives:
    """Forecasts of the concerned blades' mean at an hour, with the rms of the blades' sds [unit].

    before    by the model without effects; together: by all rivals
    each      by share, largest first; shares add up to one
    """

    quantity: str
    hour_h: float
    blades: tuple[str, ...]
    before: tuple[float, float]
    each: tuple[Alternative, ...]
    together: tuple[float, float]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON."""
        return {
            "quantity": self.quantity,
            "time_h": self.hour_h,
            "blades": list(self.blades),
            "before": _told(*self.before),
            "together": _told(*self.together),
            "each": [
                {
                    "effects": [
                        {"name": c.name, "shape": c.shape, "step_h": c.step_h} for c in one.effects
                    ],
                    "share": one.share,
                    **_told(one.mean, one.sd),
                }
                for one in self.each
            ],
        }


def _told(mean: float, sd: float) -> dict[str, float]:
    return {"mean": mean, "sd": sd}


def shares(
    taken: Rival, known: Sequence[Rival], turns: Sequence[Turn], prices: Mapping[Cell, float]
) -> tuple[tuple[Rival, float], ...]:
    """The rivals of what is in the model, itself among them, with their shares; largest first.

    known   all that was calibrated; prices: what each cell of the grammar had to gain
    """
    if not taken.effects:
        return ()
    claims = {n: turn.claim(n) for turn in turns for n in turn.took}
    settled = Counter(c.cause for c in taken.effects if claims.get(c.name) is not None)

    def fits(one: Rival) -> bool:
        causes = Counter(c.cause for c in one.effects)
        as_many = causes.total() == len(taken.effects) and not settled - causes
        return as_many or bool(settled and causes == settled)

    rivals = [one for one in known if fits(one) and all(c in prices for c in one.effects)]
    if not rivals:
        return ()
    log_w = np.array([one.gained - sum(prices[c] for c in one.effects) for one in rivals])
    w = np.exp(log_w - log_sum_exp(log_w))
    order = [i for i in np.argsort(-w, kind="stable") if w[i] >= LEAST][:MOST]
    return tuple((rivals[i], float(w[i] / w[order].sum())) for i in order)


def alternatives(
    before: tuple[Model, RotorState],
    rivals: Sequence[tuple[Rival, float]],
    case: Case,
    quantity: str,
    hour_h: float,
) -> Alternatives | None:
    """What each of them forecasts; None where there are not two of them.

    before  model and state without effects
    """
    if len(rivals) < 2:
        return None
    facts = {b: case.facts.get(b, Facts()) for b in case.spec.blades}
    blades = _differing([one for one, _ in rivals], facts, case.present)
    # a rival's state is drawn when it is first looked at: here, not by several threads
    models = [before, *((one.model, one.state) for one, _ in rivals)]

    def told_of(one: tuple[Model, RotorState]) -> tuple[Array, Array]:
        return foreseen(*one, case.spec, quantity, hour_h, blades)

    mean, sd = np.array(list(POOL.map(told_of, models))).transpose(1, 0, 2)
    w = np.array([[share] for _, share in rivals])
    middle = np.sum(w * mean[1:], axis=0)
    spread = np.sum(w * (sd[1:] ** 2 + (mean[1:] - middle) ** 2), axis=0)
    told = list(
        zip(mean.mean(axis=1).tolist(), np.sqrt(np.mean(sd**2, axis=1)).tolist(), strict=True)
    )
    return Alternatives(
        quantity,
        hour_h,
        blades,
        told[0],
        tuple(
            Alternative(one.effects, share, *own)
            for (one, share), own in zip(rivals, told[1:], strict=True)
        ),
        (float(middle.mean()), float(np.sqrt(spread.mean()))),
    )


def _differing(
    rivals: Sequence[Rival], facts: Mapping[str, Facts], present: Sequence[str]
) -> tuple[str, ...]:
    """Blades that are concerned by an effect which not all rivals have; all present, if none is."""
    common = frozenset.intersection(*(frozenset(one.effects) for one in rivals))
    found: set[str] = set()
    for cell in {c for one in rivals for c in one.effects} - common:
        own = concerned(cell, facts)
        found |= set(facts if own is None else own)
    return tuple(b for b in present if b in found) or tuple(present)
