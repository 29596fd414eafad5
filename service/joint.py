"""Joint draws of many blades from a rotor's state.

Given the shared parameters s, blades are independent, and a state holds for each blade b local
values l_ki with weights w_ki at every shared node s_k of weight W_k (`core.calibration.state`).
So a draw of the rotor is

    k ~ W,    then for each blade on its own    i_b ~ w_b,k·        →  (s_k, l_b,k,i_b for all b)

with the same s_k in all blades, hence with the correlation between blades that the posterior has;
draws of single blades put side by side have none. Nodes are drawn by systematic resampling, within
a node a blade's values are as well, and then shuffled, so that neither the order within a node nor
the order of nodes ties blades or draws together. The streams are fixed: the same state gives the
same draws.

At each node a blade's weights are normalised by their own sum. A blade's own particle set
(`blade_posterior`) is not: its weights sum to one on average over all nodes. The two differ by the
Monte-Carlo error of one node's sum, of the order of 1/m for m values a node.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.rng import stream
from core.smc.particles import normalised
from service.ports import Get, JointDraws

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def joint_draws(meta: Mapping[str, Any], get: Get, blades: Sequence[str], count: int) -> JointDraws:
    """`count` equally weighted draws of all `blades`, in random order."""
    w = normalised(np.asarray(get("shared/log_w")))
    rng = stream(0, "joint draws", count)
    places = (np.arange(count) + rng.random()) / count
    node = np.minimum(np.searchsorted(np.cumsum(w), places), len(w) - 1)
    order = rng.permutation(count)
    names = tuple(meta["local"])
    local = np.empty((count, len(blades), len(names)))
    of = 0
    for i, blade in enumerate(blades):
        values, log_w = get(f"blade/{blade}/local"), get(f"blade/{blade}/log_w")
        index = within(node, np.asarray(log_w), stream(0, "joint draws", count, blade))
        local[:, i] = values[node, index]
        of = max(of, log_w.size)
    shared = np.asarray(get("shared/x"))[node]
    return JointDraws(tuple(meta["shared"]), shared[order], names, tuple(blades), local[order], of)


def within(node: Index, log_w: Array, rng: np.random.Generator) -> Index:
    """For draws at the nodes `node` (n,), ascending: which of each node's values, by log_w (K, m).

    Of n_k draws at a node a value of weight w is drawn n_k w times, rounded up or down.

    >>> log_w = np.log([[0.5, 0.5], [0.25, 0.75]])
    >>> drawn = within(np.repeat([0, 1], [4, 8]), log_w, np.random.default_rng(0))
    >>> np.bincount(drawn[:4]).tolist(), np.bincount(drawn[4:]).tolist()
    ([2, 2], [2, 6])
    """
    k, m = log_w.shape
    top = log_w.max(axis=1, keepdims=True)
    w = np.exp(log_w - np.where(np.isfinite(top), top, 0.0))
    reached = np.cumsum(w, axis=1)
    reached /= np.where(reached[:, -1:] > 0, reached[:, -1:], 1.0)
    held = np.bincount(node, minlength=k)
    first = np.concatenate([[0], np.cumsum(held)[:-1]])
    # a rank of its own for each draw of a node, in random order
    shuffled = np.lexsort((rng.random(len(node)), node))
    rank = np.empty(len(node), np.int64)
    rank[shuffled] = np.arange(len(node)) - first[node]
    place = (rank + np.asarray(rng.random(k))[node]) / held[node]
    flat = (reached + np.arange(k)[:, None]).ravel()
    found = np.searchsorted(flat, node + np.minimum(place, 1 - 1e-12), side="right")
    return np.asarray(np.minimum(found - m * node, m - 1))
