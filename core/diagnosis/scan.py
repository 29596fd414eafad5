"""Which effects would explain the residuals: every cell of the grammar, and pairs of them.

With score U and information I of all cells at their expected sizes (`core.diagnosis.scores`) and
standard-normal amplitudes, the log Bayes factor of a set of cells S against the model as it is is

    log BF = ½ U_Sᵀ (1 + I_SS)⁻¹ U_S − ½ log |1 + I_SS|

to second order in the effects. It weighs fit against the room that an effect takes, so that a
cell which the parameters imitate (I = 0) gains nothing. What a slip could make counts as `misread`
says, and in a set less what it gains by that.

Blades are the replicates. A common effect must be common: where the blades' contributions to U
scatter by more than the noise allows (material that creeps in bursts, readings with heavy tails),
phi = Σ (c_b − a I_b)² / Σ I_b > 1 discounts U and I alike (a quasi-likelihood). For cells of one
blade, phi comes from the other blades.

What no cell names can still be there: `free` sets of columns, such as a misfit of its own for each
visit, count by the log BF of the whole set. They raise the alarm, and never name a cause.

The null distribution is made from the residuals themselves (`dealing`). The mean BF of all families
is compared with that of the dealt sets: family-wise, over everything tried (`chance`).

An effect with a known sign has a half-normal amplitude: log 2 Φ(amplitude / its sd) is added.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from core.calibration.message import POOL
from core.diagnosis.bayes import Grouped, one_by_one, together
from core.diagnosis.chance import family_wise
from core.diagnosis.coherent import discount
from core.diagnosis.dealing import FEW, Columns, dealt_sets
from core.diagnosis.grammar import Cell
from core.diagnosis.misread import Spared, alone_of, spared
from core.diagnosis.scatter import LEAST_BLADES, Scatter
from core.diagnosis.scores import Scores
from core.diagnosis.signature import Signatures

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scan:
    """Cells against a rotor's residuals.

    free    sets of columns that have no name, by what they are: their places among the columns
    g (B, n, C) signatures, those of `free` behind the cells', and h, their covariances with the
    residual (`scores`); u, phi (C,); information (C, C), within: without what shared parameters
    imitate; c, own (B, C): the blades' shares of score and information
    """

    cells: tuple[Cell, ...]
    free: Mapping[str, tuple[int, ...]]
    seen: Scores
    g: Array
    h: Array
    within: Array
    u: Array
    information: Array
    c: Array
    own: Array
    phi: Array

    @staticmethod
    def of(
        cells: Sequence[Cell],
        seen: Scores,
        found: Signatures,
        free: Mapping[str, Signatures] | None = None,
    ) -> Scan:
        """All cells at once, and free sets of columns."""
        places, parts, width = dict[str, tuple[int, ...]](), [found], len(cells)
        for name, columns in (free or {}).items():
            parts.append(columns)
            places[name] = tuple(range(width, width + columns.g.shape[2]))
            width += columns.g.shape[2]
        g, h = (np.concatenate([p.g for p in parts], 2), np.concatenate([p.h for p in parts], 2))
        return Scan._of(tuple(cells), places, seen, g, h)

    @staticmethod
    def _of(
        cells: tuple[Cell, ...],
        free: Mapping[str, tuple[int, ...]],
        seen: Scores,
        g: Array,
        h: Array,
        within: Array | None = None,
    ) -> Scan:
        within = seen.within(g) if within is None else within
        pull = h.sum(axis=1)
        shared = np.tensordot(seen.deviation, g, axes=((0, 1), (0, 1)))
        c, own = seen.shares(g, shared)
        c += pull
        information = np.asarray(within - shared.T @ shared)
        concerned, alone = np.any(g != 0, axis=1), alone_of(cells, g.shape[2])
        u = np.einsum("bic,bi->c", g, seen.q) + pull.sum(axis=0)
        phi = Scatter.of(own, concerned, alone).phi(c, u, np.diag(information))
        phi = phi * discount(seen, g, alone, np.diag(information))
        return Scan(cells, free, seen, g, h, within, u, information, c, own, phi)

    @cached_property
    def _scaled(self) -> tuple[Array, Array]:
        root = np.sqrt(self.phi)
        return self.u / self.phi, self.information / np.outer(root, root)

    @cached_property
    def undiscounted(self) -> Scan:
        """With phi = 1 but for cells of one blade: evidence as the particle filter weighs it."""
        return replace(self, phi=np.where(self._alone, self.phi, 1.0))

    def gain(self, *which: int) -> float:
        """log BF of a set of cells together; −inf where one of several goes against its sign.

        Of several with signs the factors of their sides are multiplied, as if they went apart.
        """
        (u, information), s = self._scaled, list(which)
        a = information[np.ix_(s, s)] + np.eye(len(s))
        covariance = np.linalg.inv(a)
        amplitude, sd = covariance @ u[s], np.sqrt(np.diag(covariance))
        signed = self._signs[s] > 0
        if len(s) > 1 and np.any(signed & (amplitude < 0)):
            return -np.inf
        sides = np.where(signed, np.log(2.0) + log_ndtr(amplitude / sd), 0.0)
        gain = 0.5 * u[s] @ amplitude - 0.5 * np.linalg.slogdet(a)[1] + sides.sum()
        return float(gain - np.sum((self._one_by_one - self.gains)[s]))

    def amplitudes(self, *which: int) -> tuple[Array, Array]:
        """Mean (k,) and covariance (k, k) of a set's amplitudes, in expected sizes."""
        (u, information), s = self._scaled, list(which)
        covariance = np.linalg.inv(information[np.ix_(s, s)] + np.eye(len(s)))
        return np.asarray(covariance @ u[s]), np.asarray(covariance)

    @cached_property
    def gains(self) -> Array:
        """log BF of every single cell, (C,); of some as `misread` counts them."""
        own, gains = np.diag(self.information), self._one_by_one
        return self._spared.least(gains, self.u, self.seen.q, own, self.phi, self._signs)

    @cached_property
    def _one_by_one(self) -> Array:
        return one_by_one(self.u, np.diag(self.information), self.phi, self._signs)

    @cached_property
    def _alone(self) -> NDArray[np.bool_]:
        return alone_of(self.cells, self.g.shape[2])

    @cached_property
    def _discount(self) -> Array:
        return discount(self.seen, self.g, self._alone, np.diag(self.information))

    @cached_property
    def _spared(self) -> Spared:
        return Spared.of(self.seen, self.g, self.h, spared(self.cells, self.g, self.own))

    @cached_property
    def _signs(self) -> NDArray[np.int64]:
        signs = np.zeros(self.g.shape[2], dtype=np.int64)
        signs[: len(self.cells)] = [abs(cell.family.sign) for cell in self.cells]
        return signs

    @cached_property
    def z(self) -> Array:
        """Amplitude over its standard deviation without a prior, (C,)."""
        return self.u / np.sqrt(np.maximum(np.diag(self.information) * self.phi, 1e-300))

    @cached_property
    def families(self) -> dict[str, list[int]]:
        """Cells by family and whom ("coating wear, all", "campaign offset, campaign")."""
        found: dict[str, list[int]] = {}
        for i, cell in enumerate(self.cells):
            found.setdefault(f"{cell.family.name}, {cell.whom}", []).append(i)
        return found

    @cached_property
    def _grouped(self) -> Grouped:
        return Grouped.of(list(self.families.values()))

    def by_family(self, gains: Array, u: Array, phi: Array) -> Array:
        """log of the mean Bayes factor of each family's cells, then log BF of each free set."""
        found = self._grouped.log_means(gains)
        for s in map(list, self.free.values()):
            found.append(together(u[s], self.information[np.ix_(s, s)], phi[s]))
        return np.array(found)

    @property
    def found(self) -> dict[str, float]:
        """`by_family` of the readings, by name."""
        values = self.by_family(self.gains, self.u, self.phi).tolist()
        return dict(zip((*self.families, *self.free), values, strict=True))

    def null(self, count: int, seed: int) -> Array:
        """`by_family` of `count` dealt sets, (count, families and free sets)."""
        return np.array(list(POOL.map(self.of_set, dealt_sets(self.seen, count, seed))))

    def of_set(self, q: Array) -> Array:
        """`by_family` of a dealt set q (B, n)."""
        shared, columns = self._columns
        whole, turned = columns.along(q), np.einsum("bis,bi->bs", self.seen.imitated, q)
        return self._tried(whole - turned @ shared, whole.sum(axis=0), q)

    @cached_property
    def _columns(self) -> tuple[Array, Columns]:
        shared = np.tensordot(self.seen.deviation, self.g, axes=((0, 1), (0, 1)))
        return shared, Columns.of(self.g)

    @cached_property
    def _scatter(self) -> Scatter:
        """For the null; of few blades phi is each cell's own that concerns them all."""
        least = len(self.own) if len(self.own) < FEW else LEAST_BLADES
        return Scatter.of(self.own, np.any(self.g != 0, axis=1), self._alone, least)

    def _tried(self, c: Array, u: Array, q: Array | None = None) -> Array:
        """`by_family` of contributions (B, C) and scores (C,); q (B, n): of a dealt set."""
        own = np.diag(self.information)
        phi = self._scatter.phi(c, u, own) * self._discount
        gains, seen = one_by_one(u, own, phi, self._signs), self.seen.q if q is None else q
        gains = self._spared.least(gains, u, seen, own, phi, self._signs, q is None)
        return self.by_family(gains, u, phi)

    def chance(self, count: int, seed: int) -> float:
        """Family-wise probability of so large a gain, by `count` dealt sets (`chance`)."""
        found, null = self._tried(self.c, self.u), np.atleast_2d(self.null(count, seed))
        return family_wise(found, null, self.of_one_blade)

    @property
    def of_one_blade(self) -> NDArray[np.bool_]:
        """Which of `by_family` concern one blade."""
        return np.array([name.endswith(", blade") for name in (*self.families, *self.free)])

    def by_scores(self, u: Array) -> Array:
        """`by_family` of scores (C,) whose blades scatter as the noise says."""
        own, one = np.diag(self.information), np.ones(len(u))
        return self.by_family(one_by_one(u, own, one, self._signs), u, one)

    def including(self, *which: int) -> Scan:
        """The scan of what is left once these cells' effects are in the model."""
        mean, _ = self.amplitudes(*which)
        taken = self.seen.including(self.g[:, :, list(which)], mean)
        return Scan._of(self.cells, self.free, taken, self.g, self.h, self.within)
