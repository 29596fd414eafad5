"""How often chance alone would gain as much: one probability over everything that was tried.

What counts is the mean Bayes factor of all families, not the largest one. Causes in physics are
alike: coatings that wear, coolant that declines and creep that accelerates move readings in much
the same way, so that a lack which is none of them exactly raises them all. With equal prior weights
the mean is the Bayes factor of "something is missing" against the model as it is, which no other
statistic beats on average over that prior (Neyman & Pearson).

Families of one blade and all others are counted apart, each by its own null: a blade that is odd
widens the null of the former. A mean Bayes factor has a tail of e^−x at most (Markov), so that a
surprise, minus the log of a tail's probability, is counted by the dealt sets up to what is usual in
them and goes on from there nat by nat; each group has its share of the false alarms, by the number
of its families. The larger surprise of the two is held against that of the dealt sets.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
USUAL = 0.95  # of dealt sets


def family_wise(found: Array, null: Array, alone: NDArray[np.bool_]) -> float:
    """Probability of so large a gain by chance, (1 + those of K dealt sets) / (1 + K).

    found  log Bayes factors of F families (F,); null: of dealt sets, (K, F); alone (F,): families
    of one blade

    >>> null = np.log(np.linspace(0.05, 2.0, 99))[:, None] * [1.0, 1.0]
    >>> family_wise(np.array([3.0, 0.0]), null, np.array([False, True]))
    0.01
    """
    together = np.vstack([null, found])
    most = np.full(len(together), -np.inf)
    for own in (alone, ~alone):
        if np.any(own):
            mean = np.logaddexp.reduce(together[:, own], axis=1)
            most = np.maximum(most, _surprise(mean, float(np.mean(own))))
    return float(np.mean(most >= most[-1]))


def _surprise(values: Array, share: float) -> Array:
    """−log of the tail's probability over a group's share of all, of each of K + 1 values.

    All of them tell what is usual, the readings' own among them: where readings are as the dealt
    sets are, none of the K + 1 is told from the others.
    """
    ordered, least = np.sort(values), (1.0 - USUAL) * share
    usual = float(np.quantile(ordered, 1.0 - least))
    above = len(values) - np.searchsorted(ordered, np.minimum(values, usual), side="left")
    tail = np.maximum(above / len(values), least)
    return np.asarray(np.maximum(values - usual, 0.0) - np.log(tail / share))
