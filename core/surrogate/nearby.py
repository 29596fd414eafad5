"""Answers at many points that lie near each other, from those at some of them.

A blade's posterior is narrow beside the box of the runs, and over it what a row answers is nearly a
quadratic of the inputs. So with particles x_i, their inputs in their own principal directions and
scales u_i, and the M monomials phi(u) up to degree 2,

    Y(x_i) ~ phi(u_i) beta,    s(x_i) ~ phi(u_i) gamma,    left² = Σ (Y − phi beta)² / (m − M)

from m ≥ `POINTS` M of them that are followed: those of which phi are most unlike each other
(pivots; without them tails are guessed), and others evenly. What is left of a row counts as its
error, so that no variance is lost. Where that is more than `LEFT` of the spread of all rows, or
there are too few points for the others to be worth it, each is followed.

512 draws of four blades of a worn fleet, deformation and CEEQ at 95 nodes: what is left is 2 to
14 % of the spread, the mean errs by 0.01 sd (median over nodes; 0.09 at most), the sd by 1 % (9). A
cubic of one input alone, which has its say in the tails, makes it up to 7 % too wide.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from core.monomials import monomials, multi_indices

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Answered = Callable[[Array], Iterator[tuple[Array, Array]]]
Block = tuple[Index, Array, Array]
POINTS = 3  # for each monomial
LEFT = 0.15  # of the spread
SHARE = 0.5  # of the points: no more are followed for the others' sake
FLAT = 1e-9  # of the widest direction, or of the rows: nothing


def nearby(x: Array, answered: Answered, block: int) -> Iterator[Block]:
    """Which of the points x (n, d), and mean and sd of rows there, `block` of them at a time.

    answered  mean and sd (k, …) of the inputs that it is given, so many at a time, in order
    """
    u = _directions(x)
    count = len(multi_indices(u.shape[1], 2))
    m = -(-POINTS * count // block) * block
    if m > SHARE * len(x):
        yield from _each(np.arange(len(x)), x, answered)
        return
    phi = monomials(u, 2)
    some = _unlike(phi, m)
    known = list(_each(some, x, answered))
    y, sd = (np.concatenate([one[k] for one in known]) for k in (1, 2))
    shape = y.shape[1:]
    y, sd = y.reshape(m, -1), sd.reshape(m, -1)
    inverse = np.linalg.pinv(phi[some])
    beta, gamma = inverse @ y, inverse @ sd
    left = np.sum((y - phi[some] @ beta) ** 2, axis=0) / (m - count)
    if np.sum(left) > LEFT**2 * np.sum(np.var(y, axis=0)) + FLAT**2 * np.sum(y**2):
        yield from known
        yield from _each(np.setdiff1d(np.arange(len(x)), some), x, answered)
        return
    for start in range(0, len(x), block):
        which = np.arange(start, min(start + block, len(x)))
        doubt = np.hypot(phi[which] @ gamma, np.sqrt(left))
        yield which, (phi[which] @ beta).reshape(-1, *shape), doubt.reshape(-1, *shape)


def _each(which: Index, x: Array, answered: Answered) -> Iterator[Block]:
    """These points, each followed."""
    start = 0
    for y, sd in answered(x[which]):
        yield which[start : start + len(y)], y, sd
        start += len(y)


def _directions(x: Array) -> Array:
    """Inputs (n, d) in their own principal directions and scales, (n, e); flat ones left out.

    >>> _directions(np.array([[0.0, 1.0, 5.0], [2.0, 3.0, 5.0], [4.0, 5.0, 5.0]])).shape
    (3, 1)
    """
    sd = x.std(axis=0)
    moved = sd > FLAT * np.maximum(np.abs(x).max(axis=0), 1e-300)
    z = (x[:, moved] - x[:, moved].mean(axis=0)) / sd[moved]
    left, size, _ = np.linalg.svd(z, full_matrices=False)
    return np.asarray(left[:, size > FLAT * size.max(initial=0.0)] * np.sqrt(len(x)))


def _unlike(phi: Array, m: int) -> Index:
    """m of the points of which monomials phi (n, M) are known: pivots, and others evenly."""
    pivots = qr(phi.T, mode="r", pivoting=True)[1][: phi.shape[1]]
    others = np.setdiff1d(np.arange(len(phi)), pivots)
    evenly = others[np.linspace(0, len(others) - 1, m - len(pivots)).astype(np.intp)]
    return np.sort(np.concatenate([pivots, evenly]))
