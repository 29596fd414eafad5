"""What the particles say of a shift in the readings: score and information, blade by blade.

Suppose every reading were off by a·g. The derivative of the log evidence is (Fisher's identity) the
posterior mean of the derivative of the log likelihood,

    U = d/da = Σ_b gᵀ q_b,      q_b = E[ V⁻¹ (y − f) ]    over the particles of blade b,

V being the variance of noise and surrogate: exact however skew the posterior is. Where g goes with
the parameters, as gains and effects of physics do, the mean of the product is not that of the
means,

    U = Σ_b gᵀ q_b + Σ_i h_bi,      h_bi = Cov[g_i, r_i],   r_i = (y_i − f_i) / V_i

g is known at some particles of each blade; its regression over these on answers f and inputs x, g ≈
Σ_j kappa_ij phi_j, and what is known over all particles give the mean of g, corrected by kappa's
share of what the few are off, and h_bi = Σ_j kappa_ij Cov[phi_j, r_i]. Of a gain g is kappa f_i,
and h < 0, for residuals lean to where priors pull the fit: without h a gain would be found in every
clean rotor. Accelerating creep grows faster than the answer: with a gain's h in place of its own it
would be found in most of them.

How much of a shift the parameters would imitate is told by the sensitivities J (local) and S
(shared), mean derivatives of f over the same particles, and by the priors' covariances P and P_s:

    Q_b = (V + J P Jᵀ)⁻¹
    I   = −d²/da² = Σ_b gᵀ Q_b g − |Dᵀ g|²,     D_b = Q_b S_b A^−½,  A = P_s⁻¹ + Σ_b S_bᵀ Q_b S_b

Louis' identity would give I from the particles as well, E[gᵀV⁻¹g] − Var[gᵀV⁻¹(y − f)]; but
where parameters imitate 99 % of an effect that is a difference of two large numbers, lost in
Monte-Carlo error. It is asked blade by blade where it shows more than this error: there a prior's
bound leaves more than a normal prior would. (Slopes by regression of f over a blade's particles
are too small by far: they lie along a curved ridge on which f hardly changes.) An information of
zero means that the parameters imitate it altogether.

A signature less what shared parameters imitate of it, g⊥ = g − Z (Dᵀ g) with Z_b = S_b A^−½, makes
the blades' contributions c_b = g⊥ᵀ q_b to U independent; their sum is U but for the pull of the
shared priors on the readings, (Dᵀ g)ᵀ Zᵀ q.

Arrays are padded to the blade with most rows: (B, n, …); what is beyond a blade's rows is zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from core.calibration.target import BladeRows
from core.observation import Inspection

Array = NDArray[np.float64]
DIRECTIONS = 8  # of answers and inputs over these, on which an effect is regressed
SURE = 0.03  # of the largest: a direction that is


@dataclass(frozen=True)
class Beside:
    """Inputs on which an effect is regressed besides the answers.

    at    of K particles (…, K, d); mean: over all, (…, d); lean: Cov[x_j, r_i], (…, n, d)
    """

    at: Array
    mean: Array
    lean: Array

    @staticmethod
    def padded(each: Sequence[Beside], rows: int) -> Beside:
        """Of all blades, with zeros where one has fewer inputs or rows."""
        points, width = len(each[0].at), max(len(one.mean) for one in each)
        at = np.zeros((len(each), points, width))
        mean, lean = np.zeros((len(each), width)), np.zeros((len(each), rows, width))
        for b, one in enumerate(each):
            n, d = one.lean.shape
            at[b, :, :d], mean[b, :d], lean[b, :n, :d] = one.at, one.mean, one.lean
        return Beside(at, mean, lean)


@dataclass(frozen=True)
class Scores:
    """A rotor's readings as its particles see them; see the module's text.

    blades   with readings, (B,); rows of each as they were assembled
    place    reading of each row within its blade's `rows.readings`, −1 beyond, (B, n)
    q        (B, n); information Q (B, n, n)
    slope    S, (B, n, S), and the prior variances of what it is by, (S,)
    answer   E[f], (B, n); lean: Cov[f_j, r_i] at [b, i, j], (B, n, n)
    points   inputs at K particles, (K,) each, one mapping a blade; answers there, (B, K, n)
    unsure   sd of what the simulation does not know of each row, (B, n); none: of nothing
    alike    what of it is the same in all blades, by unit causes (B, n, M) (`coherent`); or none
    pull     Cov[df_i/dθ, r_i] for each shared parameter, (B, n, S); none: slopes do not vary
    beside   the inputs, on which effects are regressed as well; none: on the answers alone
    """

    blades: tuple[str, ...]
    rows: tuple[BladeRows, ...]
    place: NDArray[np.int64]
    q: Array
    information: Array
    slope: Array
    prior: Array
    answer: Array
    lean: Array
    points: tuple[Mapping[str, Array], ...]
    answers: Array
    unsure: Array | None = None
    pull: Array | None = None
    beside: Beside | None = None
    alike: Array | None = None

    @property
    def real(self) -> NDArray[np.bool_]:
        return self.place >= 0

    @cached_property
    def hours(self) -> Array:
        """Blades' hours of the rows, (B, n); 0 beyond."""
        out = np.zeros(self.place.shape)
        for b, i in np.argwhere(self.real):
            out[b, i] = self.reading(b, i).time_h
        return out

    def reading(self, b: int, i: int) -> Inspection:
        """The reading of a row."""
        return self.rows[b].readings[int(self.place[b, i])]

    @cached_property
    def curvature(self) -> Array:
        """A (S, S)."""
        a = np.tensordot(self.slope, self.information @ self.slope, axes=((0, 1), (0, 1)))
        return np.asarray(np.diag(1.0 / self.prior) + a)

    @cached_property
    def imitated(self) -> Array:
        """Z = S A^−½, (B, n, S)."""
        value, vector = np.linalg.eigh(self.curvature)
        return np.asarray(self.slope @ (vector / np.sqrt(value)))

    def refitted(self, whole: Array, shared: Array) -> Array:
        """q (count, B, n) once the shared parameters are fitted to sets Q^½ e (count, B, n).

        They lie δ = P^½ `shared`, (count, S) in sds of their priors::

            q = Q^½ e − D (Zᵀ Q^½ e) + D A^−½ᵀ P⁻¹ δ

        For e and `shared` of unit covariance its covariance is Q − D Dᵀ, that of the residuals.
        """
        value, vector = np.linalg.eigh(self.curvature)
        flat, width = whole.reshape(len(whole), -1), len(value)
        moved = shared / np.sqrt(self.prior) @ (vector / np.sqrt(value))
        moved -= flat @ self.imitated.reshape(-1, width)
        return np.asarray((flat + moved @ self.deviation.reshape(-1, width).T).reshape(whole.shape))

    @cached_property
    def deviation(self) -> Array:
        """D = Q Z, (B, n, S)."""
        return np.asarray(self.information @ self.imitated)

    def over(self, values: Array) -> tuple[Array, Array]:
        """Mean g and h of a change that is `values` (B, K, n) at the points, (B, n) each."""
        mean, centred = values.mean(axis=1), values - values.mean(axis=1, keepdims=True)
        left, size, right, spread = self._directions
        along = size[:, :, None] * (np.swapaxes(left, 1, 2) @ centred)
        kappa = np.swapaxes(right, 1, 2) @ along / spread[:, :, None]
        at, middle, lean = self._regressors
        mean = mean + np.einsum("bj,bji->bi", middle - at.mean(axis=1), kappa)
        return mean, np.einsum("bji,bij->bi", kappa, lean)

    @cached_property
    def _regressors(self) -> tuple[Array, Array, Array]:
        """Answers and inputs at the points (B, K, m), their means over all particles (B, m), and
        their covariances with the residuals (B, n, m)."""
        if (more := self.beside) is None:
            return self.answers, self.answer, self.lean
        return (
            np.concatenate([self.answers, more.at], axis=2),
            np.concatenate([self.answer, more.mean], axis=1),
            np.concatenate([self.lean, more.lean], axis=2),
        )

    def in_proportion(self, share: Array) -> tuple[Array, Array]:
        """Mean g and h of a change of a share (B, n) of the answer, (B, n) each."""
        return share * self.answer, share * np.einsum("bii->bi", self.lean)

    @cached_property
    def _directions(self) -> tuple[Array, Array, Array, Array]:
        """Answers and inputs at the points by their few main directions: left vectors (B, K, D),
        reciprocal sizes (B, D), right vectors (B, D, m), and their sds (B, m)."""
        at = self._regressors[0]
        off = at - at.mean(axis=1, keepdims=True)
        spread = off.std(axis=1) + 1e-300
        left, size, right = np.linalg.svd(off / spread[:, None, :], full_matrices=False)
        few = min(DIRECTIONS, size.shape[1])
        sure = size[:, :few] > SURE * np.maximum(size[:, :1], 1e-300)
        back = np.where(sure, 1.0 / np.where(sure, size[:, :few], 1.0), 0.0)
        return left[:, :, :few], back, right[:, :few], spread

    def imitating(self, g: Array) -> Array:
        """By how much shared parameters move for an amplitude of one of signatures g (B, n, C),
        −A⁻¹ Σ_b S_bᵀ Q_b g_b, (S, C)."""
        across = np.tensordot(self.information @ self.slope, g, axes=((0, 1), (0, 1)))
        return np.asarray(-np.linalg.solve(self.curvature, across))

    def efficient(self, g: Array) -> Array:
        """g⊥ (B, n, C) of signatures g (B, n, C)."""
        weight = np.tensordot(self.deviation, g, axes=((0, 1), (0, 1)))
        return np.asarray(g - self.imitated @ weight)

    def cross(self, g: Array, own: Array | None = None) -> Array:
        """Information matrix (C, C) of signatures (B, n, C); own: `within`, if it is known."""
        shared = np.tensordot(self.deviation, g, axes=((0, 1), (0, 1)))
        return np.asarray((self.within(g) if own is None else own) - shared.T @ shared)

    def within(self, g: Array) -> Array:
        """The same if no parameter were shared, Σ_b gᵀ Q_b g, (C, C)."""
        out = np.zeros((g.shape[2], g.shape[2]))
        for own, q in zip(g, self.information, strict=True):
            at = np.flatnonzero(np.any(own != 0, axis=0))  # most cells of one blade are of others
            out[np.ix_(at, at)] += own[:, at].T @ q @ own[:, at]
        return out

    def shares(self, g: Array, shared: Array) -> tuple[Array, Array]:
        """Blades' shares g⊥ᵀ q of score and g⊥ᵀ Q g⊥ of information, (B, C) each.

        shared   Dᵀ g (S, C); g⊥ itself would take as much room as g
        """
        c, own = (np.empty((len(g), g.shape[2])) for _ in range(2))
        for b, one in enumerate(g):
            z, d = self.imitated[b], self.deviation[b]
            c[b] = self.q[b] @ one - (self.q[b] @ z) @ shared
            own[b] = np.einsum("ic,ic->c", one, self.information[b] @ one)
            own[b] -= 2.0 * np.einsum("sc,sc->c", d.T @ one, shared)
            own[b] += np.einsum("sc,sc->c", shared, (z.T @ d) @ shared)
        return c, np.maximum(own, 0.0)

    def including(self, g: Array, amplitude: Array) -> Scores:
        """With effects of signatures g (B, n, C) as shared parameters, at their best amplitudes.

        To second order: q loses Q g⊥ a, and what they imitate is no news any more.
        """
        moved = self.information @ (self.efficient(g) @ amplitude)[:, :, None]
        return replace(
            self,
            q=self.q - moved[:, :, 0],
            slope=np.concatenate([self.slope, g], axis=2),
            prior=np.append(self.prior, np.ones(g.shape[2])),
            pull=None,
        )
