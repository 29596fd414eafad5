"""Dealt sets: residuals as they would be if blades had nothing in common.

The null distribution is made from the residuals themselves: whitened blade vectors are dealt to
other blades with equal rows, with random signs (of a blade with few companions of as many rows, row
by row of any). That keeps what is within a blade, its tails and its memory, and destroys what
blades have in common. The pull of the shared parameters is taken out of what is dealt (leverage:
Bell & McCaffrey, Survey Methodology 28, 2002) and laid on it anew, as a fit to the dealt set
would; where they lie in their priors is drawn. So is what the simulation errs by in all blades
alike (`coherent`): signs that are dealt blade by blade would not leave it in.

Two things such a null would hide. One odd blade is dealt as well, and makes the gain of whichever
blade it lands on: it is dealt no larger than t-distributed readings of the others' size are but in
`ODD` of all rotors. And of few blades the signs all agree by chance in 2^(1−B) of the sets: below
`FEW` normal readings of the rotor's own size are drawn instead, and what concerns all blades is
measured by their scatter about it, so that its size does not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
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
    return Deck.of(seen, count, seed).sets(seen.q)


@dataclass(frozen=True)
class Deck:
    """What is drawn for dealt sets, so that other residuals of the same rotor are dealt alike.

    root, back    Q^½ and Q^−½ of the blades, (B, n, n)
    vector, held  eigenvectors (B, n, n) of what the shared parameters leave of whitened residuals,
                  and the roots of their eigenvalues, (B, n)
    deal          which blades are dealt to which
    shared        where the shared parameters lie, in prior sds, (count, S)
    alike         what the simulation errs by in all blades alike, in its sds, (count, M)
    """

    seen: Scores
    root: Array
    back: Array
    vector: Array
    held: Array
    deal: Deal
    shared: Array
    alike: Array

    @staticmethod
    def of(seen: Scores, count: int, seed: int) -> Deck:
        """Of `count` sets; `seen` tells the readings' rows and information, not the residuals."""
        rng, (root, back) = stream(seed, "dealt"), _roots(seen)
        deal = Deal.of(seen.real.sum(axis=1), seen.q.shape[1], rng, count)
        shared = rng.standard_normal((count, len(seen.prior)))
        alike = rng.standard_normal((count, 0 if seen.alike is None else seen.alike.shape[2]))
        return Deck(seen, root, back, *_left(root @ seen.imitated), deal, shared, alike)

    def sets(self, q: Array) -> Array:
        """q (count, B, n) of the sets that are dealt from residuals q (B, n)."""
        dealt = self.deal.sets(self._standard(q))
        whole = (self.root @ dealt.transpose(1, 2, 0)).transpose(2, 0, 1)
        if self.seen.alike is not None:
            weighed = self.seen.information @ self.seen.alike
            whole = whole + np.tensordot(self.alike, weighed, axes=(1, 2))
        return self.seen.refitted(whole, self.shared)

    def _standard(self, q: Array) -> Array:
        """Whitened residuals (B, n) without the pull of the shared parameters on them."""
        along = np.swapaxes(self.vector, 1, 2) @ (self.back @ q[:, :, None]) / self.held[:, :, None]
        return np.asarray((self.vector @ along)[:, :, 0])


@dataclass(frozen=True)
class Deal:
    """Which of the whitened blades each set has, and with which signs.

    rows     of each blade, (B,)
    order    the blade whose rows are dealt to each, (count, B); signs, (count, B)
    patched  of a blade with few companions of as many rows: blade, row and sign of each of its own,
             (count, rows) each
    normal   standard normal ones in place of dealt ones, (count, B, n); none: they are dealt
    """

    rows: NDArray[np.int64]
    order: NDArray[np.intp]
    signs: Array
    patched: Mapping[int, tuple[NDArray[np.intp], NDArray[np.intp], Array]]
    normal: Array | None = None

    @staticmethod
    def of(rows: NDArray[np.int64], width: int, rng: np.random.Generator, count: int) -> Deal:
        """Drawn for `count` sets of blades that have so many rows, (B,), of `width` at most."""
        order, signs = np.tile(np.arange(len(rows)), (count, 1)), np.ones((count, len(rows)))
        if len(rows) < FEW:
            return Deal(rows, order, signs, {}, rng.standard_normal((count, len(rows), width)))
        alike = [np.flatnonzero(rows == n) for n in np.unique(rows)]
        lonely = [int(b) for own in alike if len(own) < FEW for b in own]
        taken: dict[int, list[tuple[list[int], list[int], list[float]]]] = {b: [] for b in lonely}
        for k in range(count):
            for own in alike:
                order[k, own] = rng.choice(own, len(own))
            signs[k] = rng.choice([-1.0, 1.0], len(rows))
            for b in lonely:
                taken[b].append(_patch(rows, int(rows[b]), rng))
        patched = {}
        for b, each in taken.items():
            blades, places, along = zip(*each, strict=True)
            patched[b] = np.array(blades), np.array(places), np.array(along)
        return Deal(rows, order, signs, patched)

    def sets(self, white: Array) -> Array:
        """The sets (count, B, n) of whitened blades (B, n)."""
        norm = np.linalg.norm(white, axis=1)
        if self.normal is not None:
            size = max(1.0, float(np.sqrt(np.sum(norm**2) / np.sum(self.rows))))
            return np.asarray(size * self.normal * (np.arange(white.shape[1]) < self.rows[:, None]))
        if len(self.rows) >= LEAST_BLADES:
            usual = float(np.median(norm / np.sqrt(np.maximum(self.rows, 1))))
            most = usual * float(student.ppf(1.0 - 0.5 * ODD / self.rows.sum(), TAIL))
            white = white * np.minimum(1.0, most / np.maximum(norm, 1e-300))[:, None]
        dealt = white[self.order] * self.signs[:, :, None]
        for b, (blades, places, signs) in self.patched.items():
            dealt[:, b, : self.rows[b]] = signs * white[blades, places]
        return np.asarray(dealt)


def _patch(
    rows: NDArray[np.int64], count: int, rng: np.random.Generator
) -> tuple[list[int], list[int], list[float]]:
    """So many rows of blades that are drawn one after the other: blades, rows and signs."""
    blades, places, signs = list[int](), list[int](), list[float]()
    while len(blades) < count:
        b = int(rng.integers(len(rows)))
        sign, own = float(rng.choice([-1.0, 1.0])), int(rows[b])
        blades += [b] * own
        places += range(own)
        signs += [sign] * own
    return blades[:count], places[:count], signs[:count]


def _left(w: Array) -> tuple[Array, Array]:
    """What the shared parameters leave of whitened residuals: eigenvectors, roots of eigenvalues.

    Cov[Q^−½ q] = 1 − W Wᵀ, W = Q^½ Z; where less than `PULLED` is left, that counts as left.
    """
    value, vector = np.linalg.eigh(np.eye(w.shape[1]) - w @ np.swapaxes(w, 1, 2))
    return vector, np.sqrt(np.clip(value, PULLED, 1.0))


def _roots(seen: Scores) -> tuple[Array, Array]:
    """Q^½ and Q^−½ (B, n, n); zero beyond a blade's rows and where Q is not positive."""
    value, vector = np.linalg.eigh(seen.information)
    top = np.maximum(value.max(axis=1, keepdims=True), 1e-300)
    root = np.where(value > 1e-8 * top, np.sqrt(np.maximum(value, 0.0)), 0.0)
    back = np.where(root > 0, 1.0 / np.where(root > 0, root, 1.0), 0.0)
    turned = np.swapaxes(vector, 1, 2)
    return (vector * root[:, None]) @ turned, (vector * back[:, None]) @ turned
