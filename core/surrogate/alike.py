"""How much a surrogate errs alike at different inputs: in the blades of a rotor, say.

What a Gaussian process does not know at z and at z' goes together as its posterior covariance has
it (`core.surrogate.kernel`; the nugget is each run's own),

    R(z, z') = c(z, z') / sqrt(v(z) v(z')).

Of inputs that run in time it is asked at their means from the start to an hour. Anchored
(`core.surrogate.anchor`), the error is that of the wide surrogate's change between the inputs as
they run and those of the start, and the fine one's own there,

    c_D(z, z') = c(m, m') − c(m, s') − c(s, m') + c(s, s'),

each by its share of the variance of the answer. What is told is the mean of R over pairs: of a
hundred blades over the priors of `rotor-blade` 0.1, of what accelerating creep changes of them
about a half.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.answers import Answers, Stacked
from core.surrogate.driven import MANY, Driven
from core.surrogate.in_time import from_start
from core.surrogate.kernel import SharedGP
from core.surrogate.model import Surrogate

Array = NDArray[np.float64]
ELONGATION = "elongation"
TINY = 1e-300


def alike(answers: Answers | Stacked, x: Array, time_h: float) -> float:
    """Mean correlation of the errors at inputs x (n, d) of each other, 0 to 1.

    time_h   the hour until which inputs run, and of whose elongation shares of variance are asked
    1 of one input, at hour 0, and of what is no surrogate of simulation runs.
    """
    few = x[:: -(-len(x) // (MANY - 1))]
    if len(few) < 2 or time_h <= 0:
        return 1.0
    if isinstance(answers, Driven):
        return _driven(answers, few, time_h)
    return _same(answers.process, answers.scaled(few)) if isinstance(answers, Surrogate) else 1.0


def _driven(answers: Driven, x: Array, time_h: float) -> float:
    base, anchor, times = answers.base, answers.anchor, np.array([time_h])
    edges, held, at = answers.in_time.until(x, times)
    middle = base.scaled(from_start(edges, held, times, at)[:, 0])
    if anchor is None or ELONGATION not in base.parts:
        return _same(base.process, middle)
    fine, start = anchor.fine, answers.in_time.start(x, anchor.asleep)
    own = start[:, [[i.name for i in base.inputs].index(i.name) for i in fine.inputs]]
    still, c = base.scaled(start), base.process.cross_covariance
    changed = c(middle, middle) - c(middle, still) - c(still, middle) + c(still, still)
    v0, v, both = base.process.covariance(still, middle[:, None])
    variance = np.maximum(v[:, 0] + v0 - 2.0 * both[:, 0], 0.0)
    y, sd = answers.predict(x, ELONGATION, times)
    y1, sd1 = fine.predict(own, ELONGATION, np.minimum(times, fine.horizon_h))
    shares = (sd1 / np.abs(y1)) ** 2 / np.maximum((sd / np.abs(y)) ** 2, TINY)
    of_fine = float(np.mean(np.clip(shares, 0.0, 1.0)))
    change = _mean(changed, variance)
    return of_fine * _same(fine.process, fine.scaled(own)) + (1.0 - of_fine) * change


def _same(process: SharedGP, z: Array) -> float:
    """Of one process at z (n, d)."""
    return _mean(process.cross_covariance(z, z), process.mean_and_variance(z, ())[1])


def _mean(covariance: Array, variance: Array) -> float:
    """Mean correlation of different ones of n.

    >>> round(_mean(np.array([[1.0, 0.6], [0.6, 4.0]]), np.array([1.0, 4.0])), 9)
    0.3
    """
    sd = np.sqrt(np.maximum(variance, TINY))
    r = covariance / np.outer(sd, sd)
    n = len(r)
    return float(np.clip((np.sum(r) - np.trace(r)) / (n * (n - 1)), 0.0, 1.0))
