"""Which blades of a rotor pass a limit by an hour, and how surely any does.

Blades share parameters (their gas temperature, say), so their chances are not independent: where
the shared ones are hardly known, either many blades pass or none. Given the shared node s_k they
are independent (`core.calibration.state`). With the peaks z_m(t) of the particles m of node k of
blade b, each with weight w_m (`core.life`), and the nodes' weights W_k

    P_b(t | k)   = Σ_{m of k} w_m Φ(z_m(t)) / Σ_{m of k} w_m
    passed_b(t)  = Σ_k W_k P_b(t | k)
    expected(t)  = Σ_b passed_b(t)
    any(t)       = 1 − Σ_k W_k Π_b (1 − P_b(t | k))

`expected` needs no word about dependence, `any` does: 1 − Π_b (1 − passed_b), which takes blades
for independent, is too high where they run hot together. What a surrogate is off is one error of
each blade and particle, independent between blades given the node, as the calibration takes it.

A node's weights sum to one on average only. To divide by their own sum is off by the order of one
over the node's particles (0.009 of 0.026 with ten); `core.life` divides by the sum over all nodes,
which is not. So its number is told as passed_b, and P_b(· | k) is drawn towards 0, or towards 1, by
the same factor at all nodes, so that its mean over them is that number. Then `any` of one blade is
what `core.life` tells of it.

A blade that was never read has the rotor's prior of it: the state has draws of each.

Hours are of each blade's own operation, and one outage is another hour of each blade where some
came later. With `ages` the hours count from now on, the same for all: blade b's own are its age and
as many more. What is past the limit by now has passed it by any later hour, so that hour 0 tells
how much of a chance is of the past.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from core.calibration.state import RotorState
from core.curves import ENOUGH, checked_times
from core.life import Margins, instants, margins, peaks
from core.model import Model
from core.planning.ahead import Drawn
from core.smc.particles import normalised

Array = NDArray[np.float64]
LEAST = 1e-300  # of a sum that is divided by


@dataclass(frozen=True, slots=True)
class RotorLife:
    """How a rotor's blades pass `limit` [unit] of `quantity`, by hours.

    time_h    hours (T,), from now on where ages were given; passed: by blade, chance that it has
              passed it by then (T,)
    expected  number of blades that have (T,); any: chance that at least one has (T,)
    """

    quantity: str
    unit: str
    limit: float
    time_h: Array
    passed: Mapping[str, Array]
    expected: Array
    any: Array


def rotor_life(
    model: Model,
    state: RotorState,
    blades: Sequence[str],
    quantity: str,
    limit: float,
    times: Sequence[float] | Array,
    node: int | None = None,
    *,
    component: int | None = None,
    known: Mapping[str, Mapping[str, float]] | None = None,
    ages: Mapping[str, float] | None = None,
    most: int | None = ENOUGH,
) -> RotorLife:
    """The chances that these blades of a state have passed a limit, alone and together.

    known  values of known parameters, by blade
    ages   operating hours of each blade at hour 0 of `times`; none: 0, and times are its own
    most   particles of a blade that are used, as many of each node; None: all

    Raises what `core.life.life` raises.
    """
    asked = np.unique(checked_times(model, quantity, times))
    hours = instants(model, quantity)
    node_w = normalised(state.arrays["shared/log_w"])
    passed, none = dict[str, Array](), np.ones((len(node_w), len(asked)))
    for blade in blades:
        own, drawn = model.for_blade(blade), Drawn.of(state, blade, most)
        age = (ages or {}).get(blade, 0.0)
        ends, back = np.unique(checked_times(model, quantity, asked + age), return_inverse=True)
        time = np.union1d(ends, hours[hours < ends[-1]])  # what comes later has no part in it
        beyond = margins(
            own,
            drawn.posterior,
            quantity,
            limit,
            node,
            component=component,
            known=(known or {}).get(blade),
        )
        told, given = chances(drawn, beyond, time, np.isin(time, ends))
        passed[blade] = told[back]  # hours that are one at its age
        none *= 1.0 - given[:, back]
    expected = np.sum([np.zeros(len(asked)), *passed.values()], axis=0)
    at_all = np.maximum.accumulate(np.clip(node_w @ (1.0 - none), 0.0, 1.0))
    unit = model.network.quantity(quantity).unit
    return RotorLife(quantity, unit, float(limit), asked, passed, expected, at_all)


def chances(
    drawn: Drawn, beyond: Margins, time: Array, shown: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Of one blade passed_b (T,) and P_b(t | k) (K, T), at those of the hours that are `shown`."""
    w = drawn.w.reshape(len(drawn.node_w), -1)
    sums = np.maximum(w.sum(axis=1), LEAST)[:, None]
    parts, before = [], 0
    for z in peaks(beyond, time, w.size):
        here = shown[before : before + z.shape[1] - 1]
        before += len(here)
        share = ndtr(z[:, 1:][:, here]).reshape(*w.shape, -1)
        parts.append(np.einsum("km,kmt->kt", w, share))
    told = np.concatenate(parts, axis=1)
    passed = np.maximum.accumulate(np.clip(told.sum(axis=0) / w.sum(), 0.0, 1.0))
    return passed, drawn_to(passed, np.clip(told / sums, 0.0, 1.0), drawn.node_w)


def drawn_to(mean: Array, given: Array, node_w: Array) -> Array:
    """Chances (K, T) at nodes, drawn towards 0 or 1 until their mean over the nodes is `mean` (T,).

    >>> given = np.array([[0.2, 0.2], [0.6, 0.6]])
    >>> drawn_to(np.array([0.2, 0.7]), given, np.array([0.5, 0.5])).round(3).tolist()
    [[0.1, 0.6], [0.3, 0.8]]
    """
    now = node_w @ given
    down = np.minimum(mean / np.maximum(now, LEAST), 1.0)
    up = np.minimum((1.0 - mean) / np.maximum(1.0 - now, LEAST), 1.0)
    return np.where(mean <= now, given * down, 1.0 - (1.0 - given) * up)
