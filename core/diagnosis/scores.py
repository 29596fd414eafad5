"""What the particles say of a shift in the readings: score and information, blade by blade.

Suppose every reading were off by a·g. The derivative of the log evidence is (Fisher's identity) the
posterior mean of the derivative of the log likelihood,

    U = d/da = Σ_b gᵀ q_b,      q_b = E[ V⁻¹ (y − f) ]    over the particles of blade b,

V being the variance of noise and surrogate: exact however skew the posterior is. Where g goes with
the parameters, as gains and effects of physics do, the mean of the product is not that of the
means,

    U = Σ_b gᵀ q_b + Σ_i h_bi,      h_bi = Cov[g_i, r_i],   r_i = (y_i − f_i) / V_i

g is known at `POINTS` particles of each blade; its regression on the answers f over these, g ≈ Σ_j
kappa_ij f_j, and the covariances over all particles give h_bi = Σ_j kappa_ij Cov[f_j, r_i]. For a
gain that is kappa f_i and h < 0,
without which a gain would be found in every clean rotor, as residuals lean to where priors pull
the fit, and accelerating creep, which grows faster than the answer, in most of them even with a
gain's h. How much of a
shift the parameters would imitate is told by the sensitivities J (local) and S (shared), the
regression of f on the inputs over the same particles, and by the priors' covariances P and P_s:

    Q_b = (V + J P Jᵀ)⁻¹
    I   = −d²/da² = Σ_b gᵀ Q_b g − |Dᵀ g|²,     D_b = Q_b S_b A^−½,  A = P_s⁻¹ + Σ_b S_bᵀ Q_b S_b

Louis' identity would give I from the particles as well, E[gᵀV⁻¹g] − Var[gᵀV⁻¹(y − f)]; but
where parameters imitate 99 % of an effect that is a difference of two large numbers, lost in
Monte-Carlo error. An information of zero means that the parameters imitate it altogether.

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

from core.calibration.state import Posterior, RotorState, blade_posterior
from core.calibration.target import BladeRows, assemble, locals_of, nominal, shared_prior
from core.discrepancy import total
from core.errors import InputError
from core.model import Model
from core.network import Parameter
from core.observation import Inspection, digest_of
from core.prior import Prior

Array = NDArray[np.float64]
POINTS = 32  # particles of a blade at which effects of physics are computed
FAINT, CUT = 0.01, 3.0
DIRECTIONS = 5  # of the answers over these, on which an effect is regressed


@dataclass(frozen=True)
class Scores:
    """A rotor's readings as its particles see them; see the module's text.

    blades   with readings, (B,); rows of each as they were assembled
    place    reading of each row within its blade's `rows.readings`, −1 beyond, (B, n)
    q        (B, n); information Q (B, n, n)
    slope    S, (B, n, S), and the prior variances of what it is by, (S,)
    answer   E[f], (B, n); lean: Cov[f_j, r_i] at [b, i, j], (B, n, n)
    points   inputs at K particles, (K,) each, one mapping a blade; answers there, (B, K, n)
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
    def _curvature(self) -> Array:
        """A (S, S)."""
        a = np.einsum("bis,bij,bjt->st", self.slope, self.information, self.slope)
        return np.asarray(np.diag(1.0 / self.prior) + a)

    @cached_property
    def imitated(self) -> Array:
        """Z = S A^−½, (B, n, S)."""
        value, vector = np.linalg.eigh(self._curvature)
        return np.asarray(self.slope @ (vector / np.sqrt(value)))

    def by_chance(self, rng: np.random.Generator, count: int) -> Array:
        """Zᵀ q (count, S) as it would be by chance: where in their priors the shared ones lie.

        Its covariance is A^−½ (P⁻¹ − P⁻¹ A⁻¹ P⁻¹) A^−½.
        """
        value, vector = np.linalg.eigh(self._curvature)
        inverse = np.diag(1.0 / self.prior)
        middle = inverse - inverse @ (vector / value) @ vector.T @ inverse
        turn = (vector / np.sqrt(value)).T
        lengths, axes = np.linalg.eigh(turn @ middle @ turn.T)
        root = axes * np.sqrt(np.maximum(lengths, 0.0))
        return np.asarray(rng.standard_normal((count, len(value))) @ root.T)

    @cached_property
    def deviation(self) -> Array:
        """D = Q Z, (B, n, S)."""
        return np.asarray(self.information @ self.imitated)

    def over(self, values: Array) -> tuple[Array, Array]:
        """Mean g and h of a change that is `values` (B, K, n) at the points, (B, n) each."""
        mean, centred = values.mean(axis=1), values - values.mean(axis=1, keepdims=True)
        left, size, right, spread = self._directions
        kappa = np.einsum("bdj,bd,bkd,bki->bji", right, size, left, centred) / spread[:, :, None]
        return mean, np.einsum("bji,bij->bi", kappa, self.lean)

    def in_proportion(self, share: Array) -> tuple[Array, Array]:
        """Mean g and h of a change of a share (B, n) of the answer, (B, n) each."""
        return share * self.answer, share * np.einsum("bii->bi", self.lean)

    @cached_property
    def _directions(self) -> tuple[Array, Array, Array, Array]:
        """The answers at the points by their few main directions: left vectors (B, K, D),
        reciprocal sizes (B, D), right vectors (B, D, n), and the answers' sds (B, n)."""
        off = self.answers - self.answers.mean(axis=1, keepdims=True)
        spread = off.std(axis=1) + 1e-300
        left, size, right = np.linalg.svd(off / spread[:, None, :], full_matrices=False)
        few = min(DIRECTIONS, size.shape[1])
        sure = size[:, :few] > 1e-3 * np.maximum(size[:, :1], 1e-300)
        back = np.where(sure, 1.0 / np.where(sure, size[:, :few], 1.0), 0.0)
        return left[:, :, :few], back, right[:, :few], spread

    def efficient(self, g: Array) -> Array:
        """g⊥ (B, n, C) of signatures g (B, n, C)."""
        weight = np.einsum("bnk,bnc->kc", self.deviation, g)
        return np.asarray(g - self.imitated @ weight)

    def cross(self, g: Array) -> Array:
        """Information matrix (C, C) of signatures (B, n, C)."""
        shared = np.einsum("bnk,bnc->kc", self.deviation, g)
        own = np.einsum("bic,bid->cd", g, self.information @ g)
        return np.asarray(own - shared.T @ shared)

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
        )


def scores(
    model: Model,
    state: RotorState,
    readings: Sequence[Inspection],
    known: Mapping[str, Mapping[str, float]] | None = None,
) -> Scores:
    """Of the readings that count, under the posterior that they made.

    Raises InputError where there is no reading, or the state rests on others.
    """
    by_blade: dict[str, list[Inspection]] = {}
    for reading in readings:
        by_blade.setdefault(reading.blade, []).append(reading)
    if not by_blade:
        raise InputError("readings", 0, "cannot be diagnosed", "post inspections first")
    blades = tuple(sorted(by_blade))
    rows = tuple(r for b in blades if (r := assemble(model, by_blade[b])) is not None)
    if state.meta["events_digest"] != digest_of(readings):
        raise InputError(
            "state", state.meta["events"], "rests on other readings than these", "update it first"
        )
    made = [
        _blade(model, state, b, r, (known or {}).get(b)) for b, r in zip(blades, rows, strict=True)
    ]
    shape = (len(made), max(len(one.q) for one in made))
    place, filled = np.full(shape, -1), [np.zeros(shape) for _ in range(2)]
    information, lean = (np.zeros((*shape, shape[1])) for _ in range(2))
    answers = np.zeros((shape[0], POINTS, shape[1]))
    priors = shared_priors_of(model, state)
    slope = np.zeros((*shape, len(priors)))
    for b, one in enumerate(made):
        n = len(one.q)
        place[b, :n] = rows[b].of[:n]
        own = (one.q, one.answer)
        for array, value in zip(filled, own, strict=True):
            array[b, :n] = value
        information[b, :n, :n] = one.information
        lean[b, :n, :n] = one.lean
        answers[b, :, :n] = one.answers
        slope[b, :n] = one.shared
    q, answer = filled
    return Scores(
        blades,
        rows,
        place,
        q,
        information,
        slope,
        np.array(priors),
        answer,
        lean,
        tuple(one.points for one in made),
        answers,
    )


def shared_priors_of(model: Model, state: RotorState) -> list[float]:
    """Prior variances of the shared parameters that are no noise, in the state's order."""
    names = [n for n in state.meta["shared"] if not n.startswith("sigma_obs.")]
    return [variance(shared_prior(model, n)) for n in names]


def variance(prior: Prior) -> float:
    """Of a prior, by 2,000 of its quantiles.

    >>> round(variance(Prior("uniform", 0.0, 1.0)), 4)
    0.0833
    """
    return float(np.var(prior.quantile((np.arange(2000) + 0.5) / 2000)))


@dataclass(frozen=True)
class _Blade:
    """q (n,), Q (n, n), S (n, s), E[f] (n,), Cov[f_j, r_i] (n, n), inputs and answers (K, n)."""

    q: Array
    information: Array
    shared: Array
    answer: Array
    lean: Array
    points: Mapping[str, Array]
    answers: Array


def _blade(
    model: Model,
    state: RotorState,
    blade: str,
    rows: BladeRows,
    known: Mapping[str, float] | None,
) -> _Blade:
    posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
    w = posterior.particles.w
    count = sum(1 for o in rows.of if o >= 0)
    names, fixed = rows.response.names, nominal(model, rows.response.names, known)
    x = np.stack(
        [posterior.column(n) if n not in fixed else np.full(len(w), fixed[n]) for n in names],
        axis=1,
    )
    f, sd = (a[:, :count] for a in rows.response.evaluate(x))
    noise = [posterior.column(s) if isinstance(s, str) else s for s in rows.sigma[:count]]
    sigma2 = np.stack([np.broadcast_to(np.square(s), len(w)) for s in noise], axis=1)
    for i, one in enumerate(rows.discrepancy[:count]):
        if one.gain or one.offset:
            gain = 1.0 + total(one.gain, posterior.column)
            f[:, i] = gain * f[:, i] + total(one.offset, posterior.column)
            sd[:, i] = gain * sd[:, i]
    v = sigma2 + rows.extra[:count] + (rows.relative[:count] * rows.y[:count]) ** 2
    v = v * rows.discount[:count] + sd**2  # the surrogate's scale holds the discount already
    locals_ = [p for p in locals_of(model) if p.name in names]
    others = [n for n in state.meta["shared"] if not n.startswith("sigma_obs.")]
    columns = np.stack([posterior.column(n) for n in (*(p.name for p in locals_), *others)], axis=1)
    mean, answer = w @ columns, w @ f
    off = columns - mean
    size = np.sqrt(w @ off**2) + 1e-300
    weighted = (off / size) * np.sqrt(w)[:, None]
    slope = np.linalg.lstsq(weighted, (f - answer) * np.sqrt(w)[:, None], rcond=1e-6)[0].T / size
    own = np.array([_own_variance(p, posterior) for p in locals_])
    j = slope[:, : len(own)]
    typical = 1.0 / (w @ (1.0 / v))
    c = np.diag(typical) + (j * own) @ j.T
    r = (rows.y[:count] - f) / v
    some = _evenly(w, f)
    q = w @ r
    return _Blade(
        q,
        _bounded(np.linalg.inv(c), q),
        slope[:, len(own) :],
        answer,
        (w[:, None] * r).T @ (f - answer),
        dict(zip(names, x[some].T, strict=True)),
        f[some],
    )


def _bounded(information: Array, q: Array) -> Array:
    """Q (n, n), but along a direction in which it is faint, at least what `CUT` sds of q say.

    There the blade's own parameters imitate nearly all, by their priors' variances; one that leans
    on a bound cannot, and q along it is many sds of what Q says (7 in one blade of a hundred, which
    looked like an effect of that blade, and made the null of all others wide).
    """
    value, vector = np.linalg.eigh(information)
    along = vector.T @ q
    faint = value < FAINT * value[-1]
    value = np.where(faint, np.maximum(value, (along / CUT) ** 2), value)
    return np.asarray((vector * value) @ vector.T)


def _evenly(w: Array, f: Array) -> NDArray[np.int64]:
    """`POINTS` particles of equal weight, evenly along the sum of the answers f (P, n)."""
    spread = np.sqrt(w @ (f - w @ f) ** 2) + 1e-300
    order = np.argsort(np.sum(f / spread, axis=1), kind="stable")
    levels = (np.arange(POINTS) + 0.5) / POINTS
    places = np.searchsorted(np.cumsum(w[order]), levels)
    return np.asarray(order[np.minimum(places, len(w) - 1)])


def _own_variance(parameter: Parameter, posterior: Posterior) -> float:
    """Prior variance of a local parameter; with a population, of the blades about its mean."""
    if parameter.population is None:
        return variance(parameter.prior)
    return float(posterior.particles.w @ posterior.column(f"sd.{parameter.name}") ** 2)
