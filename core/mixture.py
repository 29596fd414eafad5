"""Quantiles of a mixture of normals, Σ w_i N(m_i, s_i²).

A posterior leaves thousands of components. Those that are nearly as wide and lie side by side are
merged into one of their common weight, mean and variance; then F(q) = p is solved by Newton steps
inside a bracket. What is merged has to be alike in *both*: components of like mean and unlike
width make a distribution with heavy tails and a sharp middle (a noise that three readings tell
has them), and a normal of their variance has neither.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

Array = NDArray[np.float64]
GROUPS = 360  # of equal weight, before they are cut where widths change
WIDTHS = 40  # classes of width, from NARROW of the mixture's sd upwards, each WIDER than the last
WIDER = 1.28
NARROW = 1e-3
TURNS = 60
EXACT = 1e-11  # of the mixture's sd
NOTHING = 1e-10  # of the mixture's sd: a component without width


def mixture_quantiles(mean: Array, sd: Array, w: Array, p: Array) -> Array:
    """Quantiles of Σ w_i N(mean_i, sd_i²), shape (len(p), T); mean and sd (n, T), w (n,), Σ w = 1.

    >>> one = mixture_quantiles(np.zeros((1, 1)), np.ones((1, 1)), np.ones(1), np.array([0.975]))
    >>> round(float(one[0, 0]), 4)
    1.96
    >>> middles, half = np.array([[1.0], [3.0]]), np.array([0.5, 0.5])
    >>> sure = mixture_quantiles(middles, np.zeros((2, 1)), half, np.array([0.9]))
    >>> round(float(sure[0, 0]), 9)
    3.0
    """
    n, t = mean.shape
    hours = np.tile(np.arange(t), n)

    def summed(values: Array) -> Array:
        """Σ w_i values_i (T,), each hour by itself: the same bits whatever others are asked for."""
        return np.asarray(np.bincount(hours, (w[:, None] * values).ravel(), t), float)

    centre = summed(mean)
    whole = np.sqrt(np.maximum(summed(sd**2 + (mean - centre) ** 2), 1e-300))
    if n > GROUPS + WIDTHS:
        mass, mean, sd = merged(mean, sd, w, whole)
    else:
        mass = np.repeat(w[:, None], t, axis=1)
    # the sums below run over the last axis: (T, quantiles, components)
    mass, mean, sd = (np.ascontiguousarray(part.T)[:, None, :] for part in (mass, mean, sd))
    centre, whole = centre[:, None], whole[:, None]
    sd = np.maximum(sd, NOTHING * whole[:, :, None])
    here = mass > 0
    low = np.min(np.where(here, mean - 9 * sd, np.inf), axis=2) + np.zeros(len(p))
    high = np.max(np.where(here, mean + 9 * sd, -np.inf), axis=2) + np.zeros(len(p))
    at = np.clip(centre + whole * ndtri(p), low, high)
    moving, peak = np.ones(at.shape, bool), mass / (np.sqrt(2 * np.pi) * sd)
    for _ in range(TURNS):
        z = (at[:, :, None] - mean) / sd
        f = np.sum(mass * ndtr(z), axis=2) - p
        density = np.sum(peak * np.exp(-0.5 * z**2), axis=2)
        low, high = np.where(f < 0, at, low), np.where(f < 0, high, at)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            further = at - f / density
        further = np.where((further >= low) & (further <= high), further, 0.5 * (low + high))
        moved, at = np.abs(further - at), np.where(moving, further, at)
        moving &= moved > EXACT * whole
        if not moving.any():
            break
    return np.ascontiguousarray(at.T)


def merged(mean: Array, sd: Array, w: Array, whole: Array) -> tuple[Array, Array, Array]:
    """Mass, mean and sd (GROUPS + WIDTHS, T) of groups; an empty one has no mass.

    whole   the mixture's sd (T,)
    """
    rows, t = GROUPS + WIDTHS, mean.shape[1]
    with np.errstate(divide="ignore"):
        width = np.log(sd / (NARROW * whole)) / np.log(WIDER)
    width = np.clip(width, 0, WIDTHS - 1).astype(np.int16)
    order = np.lexsort((mean, width), axis=0)
    share, width = w[order], np.take_along_axis(width, order, axis=0)
    part = np.minimum((np.cumsum(share, axis=0) * GROUPS).astype(np.int64), GROUPS - 1)
    flat = ((part + width) * t + np.arange(t)).ravel()
    m = np.take_along_axis(mean, order, axis=0)
    second = m**2 + np.take_along_axis(sd, order, axis=0) ** 2

    def gathered(values: Array) -> Array:
        sums = np.bincount(flat, values.ravel(), rows * t)
        return np.asarray(sums.reshape(rows, t), float)

    mass = gathered(share)
    safe = np.maximum(mass, 1e-300)
    middle = gathered(share * m) / safe
    return mass, middle, np.sqrt(np.maximum(gathered(share * second) / safe - middle**2, 0.0))
