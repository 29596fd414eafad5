"""Dealt sets: residuals as they would be if blades had nothing in common.

The null distribution is made from the residuals themselves: whitened blade vectors are dealt to
other blades with equal rows, with random signs (of a blade with few companions of as many rows, row
by row of any). That keeps what is within a blade, its tails and its memory, and destroys what
blades have in common. The pull of the shared parameters is taken out of what is dealt (leverage:
Bell & McCaffrey, Survey Methodology 28, 2002) and laid on it anew, as a fit to the dealt set
would; where they lie in their priors is drawn.

Two things such a null would hide. One odd blade is dealt as well, and makes the gain of whichever
blade it lands on: it is dealt no larger than t-distributed readings of the others' size are but in
`ODD` of all rotors. And of few blades the signs all agree by chance in 2^(1−B) of the sets: below
`FEW` normal readings of the rotor's own size are drawn instead, and what concerns all blades is
measured by their scatter about it, so that its size does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from core.diagnosis.scatter import LEAST_BLADES
from core.diagnosis.scores import Scores
from core.rng import stream

Array = NDArray[np.float64]
FEW = 6  # blades below which they are not dealt
PULLED = 0.1  # of a residual's variance that the shared parameters leave, at least
WHOLE = 256  # columns up to which sets are held against all of them
ODD, TAIL = 0.05, 4.0  # a blade is dealt no larger than t-distributed readings are but so rarely


@dataclass(frozen=True, slots=True)
class Columns:
    """Signatures g (B, n, C) as sets are held against them: whole where they are few, else by blade
    those that concern it, for most of many are of some other one."""

    g: Array
    there: tuple[tuple[NDArray[np.intp], Array], ...]

    @staticmethod
    def of(g: Array) -> Columns:
        if g.shape[2] <= WHOLE:
            return Columns(g, ())
        there = (np.flatnonzero(np.any(one != 0, axis=0)) for one in g)
        return Columns(g, tuple((at, one[:, at]) for at, one in zip(there, g, strict=True)))

    def along(self, q: Array) -> Array:
        """gᵀ q of a set q (B, n), (B, C).

        >>> g, q = np.arange(12.0).reshape(2, 2, 3), np.ones((2, 2))
        >>> several = tuple((np.arange(3), one) for one in g)
        >>> Columns(g, ()).along(q).tolist() == Columns(g, several).along(q).tolist()
        True
        """
        if not self.there:
            return np.asarray((q[:, None] @ self.g)[:, 0])
        found = np.zeros((self.g.shape[0], self.g.shape[2]))
        for b, (at, own) in enumerate(self.there):
            found[b, at] = q[b] @ own
        return found


def dealt_sets(seen: Scores, count: int, seed: int) -> Array:
    """q (count, B, n) of `count` dealt sets."""
    rng, (root, back) = stream(seed, "dealt"), _roots(seen)
    white = _standard(seen, root, back)
    sets = _dealt(white, seen.real.sum(axis=1), rng, count)
    return seen.refitted(np.einsum("bij,kbj->kbi", root, sets), rng)


def _dealt(white: Array, rows: NDArray[np.int64], rng: np.random.Generator, count: int) -> Array:
    """`count` sets of whitened blades (B, n), (count, B, n); rows: of each blade, (B,)."""
    norm = np.linalg.norm(white, axis=1)
    if len(rows) < FEW:
        size = max(1.0, float(np.sqrt(np.sum(norm**2) / np.sum(rows))))
        there = np.arange(white.shape[1]) < rows[:, None]
        return np.asarray(size * rng.standard_normal((count, *white.shape)) * there)
    if len(rows) >= LEAST_BLADES:
        usual = float(np.median(norm / np.sqrt(np.maximum(rows, 1))))
        most = usual * float(student.ppf(1.0 - 0.5 * ODD / rows.sum(), TAIL))
        white = white * np.minimum(1.0, most / np.maximum(norm, 1e-300))[:, None]
    alike = [np.flatnonzero(rows == n) for n in np.unique(rows)]
    lonely = [int(b) for own in alike if len(own) < FEW for b in own]
    dealt = np.empty((count, *white.shape))
    for k in range(count):
        order = np.arange(len(rows))
        for own in alike:
            order[own] = rng.choice(own, len(own))
        dealt[k] = white[order] * rng.choice([-1.0, 1.0], len(rows))[:, None]
        for b in lonely:
            dealt[k, b, : rows[b]] = _patched(white, rows, int(rows[b]), rng)
    return dealt


def _patched(white: Array, rows: NDArray[np.int64], count: int, rng: np.random.Generator) -> Array:
    """So many whitened rows, of blades drawn one after the other."""
    found = np.empty(0)
    while len(found) < count:
        b = int(rng.integers(len(rows)))
        found = np.r_[found, rng.choice([-1.0, 1.0]) * white[b, : rows[b]]]
    return found[:count]


def _standard(seen: Scores, root: Array, back: Array) -> Array:
    """Whitened residuals (B, n) without the pull of the shared parameters on them.

    Cov[Q^−½ q] = 1 − W Wᵀ, W = Q^½ Z; where less than `PULLED` is left, that counts as left.
    """
    w = np.einsum("bij,bjs->bis", root, seen.imitated)
    value, vector = np.linalg.eigh(np.eye(w.shape[1]) - np.einsum("bis,bjs->bij", w, w))
    along = np.einsum("bij,bi->bj", vector, np.einsum("bij,bj->bi", back, seen.q))
    held = along / np.sqrt(np.clip(value, PULLED, 1.0))
    return np.asarray(np.einsum("bij,bj->bi", vector, held))


def _roots(seen: Scores) -> tuple[Array, Array]:
    """Q^½ and Q^−½ (B, n, n); zero beyond a blade's rows and where Q is not positive."""
    value, vector = np.linalg.eigh(seen.information)
    top = np.maximum(value.max(axis=1, keepdims=True), 1e-300)
    root = np.where(value > 1e-8 * top, np.sqrt(np.maximum(value, 0.0)), 0.0)
    back = np.where(root > 0, 1.0 / np.where(root > 0, root, 1.0), 0.0)
    return (
        np.einsum("bik,bk,bjk->bij", vector, root, vector),
        np.einsum("bik,bk,bjk->bij", vector, back, vector),
    )
