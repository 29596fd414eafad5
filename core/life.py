"""When a quantity passes a limit: the distribution of the time to it.

The blade has passed a limit L by the hour t if y(u) >= L at any u <= t. With the curves m_i(t) ±
s_i(t) of the particles (`core.curves`: parameters, surrogate and discrepancy, without a reading's
noise)

    P(T <= t) = Σ w_i Φ(max_{u <= t} (m_i(u) − L) / s_i(u))

for what the surrogate is off is the same way off at all hours. It is no bell: where a blade may run
hot or cool it is skewed, and its early tail, which decides on an outage, lies elsewhere than mean ±
sd of the curves would have it. Elongation, strain and damage of creep only grow, and the largest is
the last. What shrinks for a while stays passed in each particle that has passed it, whichever the
others do: of particles that peak one after the other each passes, and never a large share at once.

Of a quantity that is at or above the limit at hour 0 and lower at the model's horizon (a heat
transfer that fouls away) the limit is passed from above: y(u) <= L takes the place of y(u) >= L.
One that is above it and does not fall has passed it at hour 0, and so has one that begins exactly
at the limit, whether it rises, falls or stays: with the probability with which it is there, or
beyond it, at hour 0.

The hour at which the sum reaches p is the p-quantile of the time to the limit. What lies beyond the
model's hours has none: the model says nothing of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from core.calibration.state import Posterior
from core.curves import checked_times, curves, spans, thinned
from core.errors import InputError
from core.model import Model
from core.prediction import QUANTILES

Array = NDArray[np.float64]
Places = NDArray[np.intp]
Margins = Callable[[Array], Array]
EVEN = 51  # hours of a model without runs
TURNS = 30  # between two of the hours; three or four where the share is smooth
EXACT = 1e-5  # of a probit
NARROW_H = 0.1  # or so near in hours
ROUNDING = 1e-9  # of a mean at hour 0: so near it is at the limit, and so little is no fall
LEAST = 1e-12  # shares are kept this far from 0 and 1 where their probits are taken


@dataclass(frozen=True, slots=True)
class Life:
    """The time until `quantity` passes `limit` [unit], in operating hours.

    time_h     hours (T,); passed: share of belief that it has passed it by then (T,)
    quantiles  {p: hour by which it has passed it with probability p}; None: not in the model's
    """

    quantity: str
    unit: str
    limit: float
    time_h: Array
    passed: Array
    quantiles: Mapping[float, float | None]
    particles: int


def life(
    model: Model,
    posterior: Posterior,
    quantity: str,
    limit: float,
    times: Sequence[float] | Array,
    node: int | None = None,
    *,
    component: int | None = None,
    known: Mapping[str, float] | None = None,
    levels: Sequence[float] = QUANTILES,
) -> Life:
    """The distribution of the time to a limit, from a blade's posterior.

    times      hours at which `passed` is told; quantiles are looked for over all the model's hours
    component  for 3-D deformation: 0, 1, 2 for x, y, z

    Raises InputError for a limit that is no number, and what `predict` raises.
    """
    asked = np.unique(checked_times(model, quantity, times))
    time = np.union1d(asked, instants(model, quantity))
    thin = thinned(posterior)
    w = thin.particles.w
    beyond = margins(model, thin, quantity, limit, node, component=component, known=known)

    def share(z: Array) -> Array:
        return np.asarray(np.clip(w @ ndtr(z) / w.sum(), 0.0, 1.0))

    wanted, parts = np.array(levels, float), list[Array]()
    most = np.full((len(w), len(wanted)), -np.inf)
    for z in peaks(beyond, time, len(w)):
        parts.append(share(z))
        reached = np.searchsorted(np.maximum.accumulate(parts[-1]), wanted)
        inside = (reached > 0) & (reached < z.shape[1])
        most[:, inside] = z[:, reached[inside] - 1]  # before the hour at which a level is reached
    passed = np.maximum.accumulate(np.concatenate([part[1:] for part in parts]))

    def within(at: Array, which: Places) -> Array:
        return share(np.maximum(beyond(at), most[:, which]))

    hours = crossings(time, passed, wanted, within)
    found = {
        float(p): None if np.isnan(h) else float(h) for p, h in zip(levels, hours, strict=True)
    }
    unit = model.network.quantity(quantity).unit
    at_asked = passed[np.isin(time, asked)]
    return Life(quantity, unit, float(limit), asked, at_asked, found, len(w))


def margins(
    model: Model,
    posterior: Posterior,
    quantity: str,
    limit: float,
    node: int | None = None,
    *,
    component: int | None = None,
    known: Mapping[str, float] | None = None,
) -> Margins:
    """(m − L) / s of each particle at any hours (T,), (N, T); ± infinite where s is zero.

    Its sign is turned where the limit is passed from above. Raises as `life` does.
    """
    if not math.isfinite(limit):
        raise InputError("limit", limit, "is no number", "give it in the quantity's unit")
    w = posterior.particles.w

    def middle(at: float) -> float:
        one = curves(model, posterior, quantity, np.array([at]), node, component, known)
        return float(w @ one.mean[:, 0] / w.sum())

    begun = middle(0.0)
    little = ROUNDING * abs(begun)
    falls = begun + little >= limit and middle(model.part(quantity).horizon_h) < begun - little
    side = -1.0 if falls else 1.0

    def beyond(at: Array) -> Array:
        one = curves(model, posterior, quantity, at, node, component, known)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            z = side * (one.mean - limit) / one.width
        there = side * (one.mean - limit) >= 0
        return np.where(one.width > 0, z, np.where(there, np.inf, -np.inf))

    return beyond


def peaks(beyond: Margins, time: Array, n: int) -> Iterator[Array]:
    """The largest margin of each of n particles so far, by `spans` of hours: (n, 1 + T), with the
    one before the span in front (−∞ at first)."""
    last = np.full((n, 1), -np.inf)
    for at in spans(time):
        z = np.maximum.accumulate(np.concatenate([last, beyond(at)], axis=1), axis=1)
        yield z
        last = z[:, -1:]


def instants(model: Model, quantity: str) -> Array:
    """Hours from 0 to the model's last, no further apart than its curves bend: those of its runs,
    or `EVEN` where it has none."""
    part = model.part(quantity)
    own = getattr(getattr(part, "base", part), "time_h", np.linspace(0.0, part.horizon_h, EVEN))
    return np.append(own[own < part.horizon_h], part.horizon_h)


def crossings(
    time: Array, passed: Array, levels: Array, share: Callable[[Array, Places], Array]
) -> Array:
    """Hours at which `passed` (T,), which does not fall, reaches each level; nan: it does not.

    share  the same at any hours, each between the two hours about the level of a number: probits
           there are nearly straight, and are made exact

    >>> hours = np.array([0.0, 10.0, 20.0])
    >>> def share(t, which): return ndtr((t - 12.0) / 3.0)
    >>> crossings(hours, share(hours, hours), np.array([0.5, 0.9999]), share).round(6)
    array([12., nan])
    """
    after = np.searchsorted(passed, levels)
    out = np.where(after == 0, time[0], np.nan)
    inside = np.flatnonzero((after > 0) & (after < len(time)))
    if not len(inside):
        return out
    i, goal = after[inside], probit(levels[inside])
    low, high, floor = time[i - 1], time[i], passed[i - 1]
    below, above = probit(floor) - goal, probit(passed[i]) - goal
    stayed, found = np.zeros(len(i), int), high.copy()
    left = np.arange(len(i))  # of them, those that are still looked for
    for turn in range(TURNS):
        a, b = below[left], above[left]
        straight = low[left] - a * (high[left] - low[left]) / (b - a)
        halved = turn > 2 and turn % 2  # where straight does not lead on: a step, say
        at = 0.5 * (low[left] + high[left]) if halved else straight
        here = probit(np.maximum(share(at, inside[left]), floor[left])) - goal[left]
        reached, before = here >= 0, stayed[left]
        # Illinois: an end that stays for a second time counts half
        below[left] = np.where(reached, np.where(before > 0, 0.5, 1.0) * a, here)
        above[left] = np.where(reached, here, np.where(before < 0, 0.5, 1.0) * b)
        low[left], high[left] = np.where(reached, low[left], at), np.where(reached, at, high[left])
        stayed[left] = np.where(reached, 1, -1)
        near = np.abs(here) < EXACT
        found[left] = np.where(near, at, high[left])
        left = left[~near & (high[left] - low[left] > NARROW_H)]
        if not len(left):
            break
    out[inside] = found
    order = np.argsort(levels)
    out[order] = np.maximum.accumulate(out[order])  # where levels lie nearer than `NARROW_H`
    return out


def probit(share: Array) -> Array:
    """Φ⁻¹, of shares that are not quite 0 or 1."""
    return np.asarray(ndtri(np.clip(share, LEAST, 1.0 - LEAST)))
