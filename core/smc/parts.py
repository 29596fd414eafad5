"""Whether weighted particles agree with themselves: R, without chains.

Gelman & Rubin's R (1992) compares chains. Importance sampling has none; but its nodes, cut into
`PARTS` runs of their order, make as many estimates of each mean, from a `PARTS`-th of them each. (A
run of a Sobol sequence is spread over the whole space; every fourth of its points is not.)
With the parts' weighted means mu_k and variances W_k,

    R = sqrt(1 + Var(mu_k) / mean(W_k))

which is their R for long chains. Nodes that were independent would have Var(mu_k) / W ≈ `PARTS` /
ESS, so that an ESS of 400 shows as 1.005; better spread ones come nearer to 1. Particles that hang
on one node (a blade's local draws) stay together. A part without weight has no mean: R is
infinite, and it is where the parts' variances are zero but not their means.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PARTS = 4


def r_hat(values: Array, log_w: Array, node: NDArray[np.int64]) -> Array:
    """R of each column of values (n, d) with log weights (n,); node (n,) of each row, from 0. (d,)

    >>> rng = np.random.default_rng(1)
    >>> x, nodes = rng.normal(size=(4000, 1)), np.arange(4000)
    >>> float(r_hat(x, np.zeros(4000), nodes)[0].round(2))
    1.0
    >>> stuck = x + (nodes < 1000)[:, None]  # a quarter of them is 1 sd off
    >>> float(r_hat(stuck, np.zeros(4000), nodes)[0].round(2))
    1.11
    """
    w, count = np.exp(log_w - np.max(log_w)), int(node.max()) + 1
    means, variances = [], []
    for part in range(PARTS):
        own = node * PARTS // count == part
        total = float(w[own].sum())
        if total == 0.0:
            return np.full(values.shape[1], np.inf)
        share = w[own] / total
        mean = share @ values[own]
        means.append(mean)
        variances.append(share @ (values[own] - mean) ** 2)
    between, within = np.var(means, axis=0, ddof=1), np.mean(variances, axis=0)
    least = np.finfo(float).eps * np.maximum(1.0, np.abs(np.mean(means, axis=0)))
    still = within <= least**2
    ratio = np.where(still, np.where(between <= least**2, 0.0, np.inf), 0.0)
    ratio[~still] = between[~still] / within[~still]
    return np.asarray(np.sqrt(1.0 + ratio))
