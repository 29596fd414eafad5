"""Is a state to be trusted, and if not, why: stated with the state, never silent.

    ok            the nodes carry the posterior, and every blade fits the rotor
    degenerate    they do not: too few effective nodes, messages that are too rough, or tempered
                  until the state is sealed; or too few draws carry a blade's own (`few`)
    contradicted  a blade's readings cannot be what the rotor's best parameters give, those of two
                  blades look exchanged (`exchanged`), or all scatter more than their noise says
                  (`noisier`)

A blade contradicts where even its best local parameters, at the best shared node s*, leave
residuals that noise does not: with chi² the least Σ (y − Y_m)² / var over the box of local
parameters and R rows, where P(chi²_R > chi²) < e^−20. As m_b(s*) is an average of exp(−chi²/2) over
that box, times the density of residuals of zero, most blades are cleared by their message alone,
without a fit. For the others a second fit, the shared parameters free and the noise as it is, tells
whether the blade contradicts the rotor or the model altogether (or itself). Of up to `ACCUSED` of
them, those that miss most, the readings are told without which the others fit (`misfit.suspects`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from core.calibration import exchanged, few, noisier
from core.calibration.looked import TOLD, Told
from core.calibration.message import BladeMessage
from core.calibration.misfit import best_fit, suspects

Array = NDArray[np.float64]
FLOOR = 0.3  # share of the nodes that carries a sealed posterior
QUICK_FLOOR = 0.1  # and a provisional one
TILT = 0.3  # nat of error in a sealed posterior's differences between nodes that is too much
IMPROBABLE = -20.0  # log probability below which residuals are no noise
TRUSTED = 0.5  # nat of error in the log density of a stored posterior that is the prior
ACCUSED = 10  # blades whose readings are left out in turn


def contradictions(
    messages: Mapping[str, BladeMessage], columns: Mapping[str, Array], unit: Array, log_p: Array
) -> list[dict[str, Any]]:
    """Blades whose readings no noise explains at the best of the nodes `unit` (K, d).

    Each with misfit_nat, chi²/2 at that node; own_nat, the same with the shared parameters free;
    and the number of rows. Of a blade whose rows fit, the worst remainder of a scan.
    """
    at = unit[[int(np.argmax(log_p))]]
    found = []
    for blade in sorted(columns):
        message = messages[blade]
        y, s2, rest = message.readings(at)
        density = columns[blade][np.argmax(log_p)] - rest[0] - message.offset
        bound = -(density + 0.5 * float(np.sum(np.log(2 * np.pi * s2))))
        if improbable(bound, y.shape[1]):
            misfit, _ = best_fit(message, at, "local")
            if improbable(misfit, y.shape[1]):
                own = min(best_fit(message, at, "local", "shared")[0], misfit)
                found.append(_told(blade, misfit, own, y.shape[1]))
                continue
        beyond = [one for one in _remainders(message, at) if improbable(one[0], one[2])]
        if beyond:
            found.append(_told(blade, *max(beyond)))
    return found


def blamed(
    messages: Mapping[str, BladeMessage], accused: Sequence[Mapping[str, Any]], at: Array
) -> list[dict[str, Any]]:
    """The accused, with the readings without which all others of their blade fit (`suspects`)."""
    worst = sorted(accused, key=lambda one: -float(one["misfit_nat"]))[:ACCUSED]
    told = {
        one["blade"]: suspects(messages[one["blade"]], at, improbable)
        for one in worst
        if one["rows"] == len(messages[one["blade"]].rows.y)  # else a scan's remainder
    }
    return [{**one, "suspects": told.get(one["blade"], [])} for one in accused]


def _told(blade: str, misfit: float, own: float, rows: int) -> dict[str, Any]:
    nats = {"misfit_nat": round(misfit, 1), "own_nat": round(own, 1)}
    return {"blade": blade, **nats, "rows": rows}


def _remainders(message: BladeMessage, at: Array) -> list[tuple[float, float, int]]:
    """Of each scan's remainder: chi²/2 at the node, the same with the offset free, and its rows."""
    x, space = message.space.to_x(at), message.space

    def value(name: str | float) -> Array:
        return x[:, space.names.index(name)] if isinstance(name, str) else np.full(1, name)

    found = []
    for one in message.rows.dense:
        if one.dof > 0:
            offset = [value(name) for name in one.offset]
            c = np.stack(offset, axis=1) if offset else x[:, :0]
            misfit, own = one.misfit(value(one.sigma), c)
            found.append((float(misfit[0]), float(own[0]), one.dof))
    return found


def improbable(nats: float, rows: int) -> bool:
    """True where chi² = 2 nats of `rows` rows is no noise, or not a number.

    >>> improbable(15.0, 2), improbable(30.0, 2), improbable(30.0, 40)
    (False, True, False)
    """
    return not 2 * nats < most_of(rows)


def most_of(rows: int) -> float:
    """chi² of so many rows from which on it is no noise."""
    return _most(rows, IMPROBABLE)


@lru_cache(maxsize=1024)
def _most(rows: int, log_p: float) -> float:
    """chi² that `rows` rows of noise exceed with this log probability."""
    return float(chi2.isf(np.exp(log_p), rows))


def verdict(
    health: Mapping[str, Any],
    contradicted: Sequence[Mapping[str, Any]],
    told: Told | None = None,
    thinned: Sequence[Mapping[str, Any]] = (),
    *,
    sealed: bool,
) -> dict[str, Any]:
    """`health` with its outcome: status, reasons, met_floor, the blades that contradict and, where
    there are any, what looks at all visits told (`looked`) and those of whose draws too few count
    (`few`)."""
    looked = {name: list((told or {}).get(name, ())) for name in TOLD}
    floor = FLOOR if sealed else QUICK_FLOOR
    reasons = []
    if not health["ess_ratio"] >= floor:
        reasons.append(
            f"{health['ess']:g} of {health['nodes']} nodes carry the posterior, "
            f"less than {floor:g} of them: its spread is not to be trusted"
        )
    if health["tempered"] < 1:
        reasons.append(f"tempered to {health['tempered']:g}: wider than the readings say")
    if sealed and not health["message_tilt_nat"] <= TILT:
        reasons.append(
            f"the blades' messages are known to {health['message_tilt_nat']:g} nat between nodes, "
            f"{TILT:g} is allowed: too many local parameters for the readings' noise"
        )
    if sealed and not health.get("prior_error_nat", 0.0) <= TRUSTED:
        reasons.append(
            f"the stored posterior that is the prior is known to {health['prior_error_nat']:g} "
            f"nat, {TRUSTED:g} is allowed"
        )
    reasons += [few.in_words(one) for one in thinned]
    met = not reasons
    for one in contradicted:
        explained = not improbable(one["own_nat"], one["rows"])
        other = (
            f"its own best fit by {one['own_nat']:g}: it contradicts the rotor"
            if explained
            else f"any shared parameters by {one['own_nat']:g}: it contradicts the model or itself"
        )
        miss = f"the rotor's best fit by {one['misfit_nat']:g} nat"
        apart = "; no other blade follows it" if one.get("bounded") else ""
        reasons.append(f"blade {one['blade']} misses {miss}, {other}{apart}{_to_look_at(one)}")
    reasons += [noisier.in_words(one) for one in looked["noisier"]]
    reasons += [exchanged.in_words(one) for one in looked["exchanged"]]
    wrong = contradicted or any(looked.values())
    out = {
        **health,
        "status": "contradicted" if wrong else "ok" if met else "degenerate",
        "reasons": reasons,
        "met_floor": met,
        "contradicted": [dict(one) for one in contradicted],
    }
    there = looked | {"few_draws": thinned}
    return out | {name: [dict(one) for one in which] for name, which in there.items() if which}


def _to_look_at(one: Mapping[str, Any]) -> str:
    """Which reading is rather wrong, in words; none is told of states of before.

    >>> _to_look_at({"suspects": [{"reading": "r7", "time_h": 19000.0, "misfit_nat": 2.1}]})
    '; without reading r7 (19,000 h) all others fit: look at that one'
    """
    told = [f"{s['reading']} ({s['time_h']:,.0f} h)" for s in one.get("suspects", ())]
    if not told:
        return ""
    if len(told) == 1:
        return f"; without reading {told[0]} all others fit: look at that one"
    return f"; without one of the readings {', '.join(told)} all others fit: look at these"
