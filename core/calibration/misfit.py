"""How far a blade's readings stay from every parameter, with all of them and without each.

The misfit of R rows at a shared node s* is the least of

    chi²/2 = ½ Σ_i (y_i − Y_i(l, s*))² / var_i        over the box of the local parameters l

in nats, noise as it is there; where more levels are free, over their boxes as well. Where a blade
contradicts (`health`), somebody has to find the reading that is wrong. So each reading is left out
in turn: a *suspect* is one without which the others are noise. A slip of one value leaves one; of
two readings that contradict each other both are, for nothing else tells which. None is left where
no reading alone is to blame: then it is the blade, or the model.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from core.calibration.message import BladeMessage
from core.smc.placement import sobol

Array = NDArray[np.float64]
STARTS = 256
LEFT_OUT = 12  # readings of a blade that are left out in turn, those that fit worst


def best_fit(
    message: BladeMessage, at: Array, *free: str, without: int | None = None
) -> tuple[float, Array]:
    """Least chi²/2 of a blade's rows over its parameters of levels `free`, the others at the node
    `at` (1, d) of the unit box; and each row's part of it, (R,).

    without  place of a reading whose rows count for nothing
    """
    response, space = message.rows.response, message.space
    y, s2, _ = message.readings(at)
    counts = np.ones(y.shape[1]) if without is None else np.array(message.rows.of) != without
    x0 = 0.5 * (response.low + response.high)
    moved = []
    for j, name in enumerate(response.names):
        if name in message.fixed:
            x0[j] = message.fixed[name]
        elif name in space.names:
            x0[j] = space.to_x(at)[0, space.names.index(name)]
        if message.model.network.parameter(name).level in free:
            moved.append(j)

    def residuals(share: Array) -> Array:
        x = np.tile(x0, (len(share), 1))
        x[:, moved] = response.low[moved] + share * (response.high - response.low)[moved]
        mean, sd = response.evaluate(x)
        return np.asarray(counts * (mean - y) / np.sqrt(s2 + sd**2))

    if not moved:
        parts = 0.5 * residuals(np.zeros((1, 0)))[0] ** 2
        return float(np.sum(parts)), parts
    starts = sobol(STARTS, len(moved), 0)
    order = np.argsort(np.sum(residuals(starts) ** 2, axis=1))
    fits = [
        least_squares(lambda u: residuals(u[None])[0], starts[i], bounds=(0, 1), max_nfev=60)
        for i in order[:3]
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    return float(best.cost), np.asarray(0.5 * best.fun**2)


def suspects(
    message: BladeMessage, at: Array, improbable: Callable[[float, int], bool]
) -> list[dict[str, Any]]:
    """Readings without which the others are noise, each with their misfit then; the least first.

    improbable  whether a misfit of so many rows is no noise
    """
    rows = message.rows
    _, parts = best_fit(message, at, "local")
    of = np.array(rows.of)
    places = sorted(set(of[of >= 0].tolist()))
    if len(places) < 2:
        return []
    worst = sorted(places, key=lambda place: -float(np.sum(parts[of == place])))[:LEFT_OUT]
    found = []
    for place in worst:
        left, _ = best_fit(message, at, "local", without=place)
        if not improbable(left, int(np.sum(of != place))):
            reading = rows.readings[place]
            told = {"reading": reading.id, "time_h": reading.time_h, "misfit_nat": round(left, 1)}
            found.append(told)
    return sorted(found, key=lambda one: (one["misfit_nat"], str(one["reading"])))
