"""What the particles say of a shift in the readings: score and information, blade by blade.

Suppose every reading were off by a·g. The derivative of the log evidence is (Fisher's identity) the
posterior mean of the derivative of the log likelihood,

    U = d/da = Σ_b gᵀ q_b,      q_b = E[ V⁻¹ (y − f) ]    over the particles of blade b,

V being the variance of noise and surrogate: exact however skew the posterior is. Where g grows with
the blade's answer, g = kappa f, the mean of the product is not that of the means,

    U = Σ_b gᵀ q_b + Σ_i kappa_i h_bi,      h_bi = Cov[f_i, (y_i − f_i) / V_i] < 0,

without which a gain would be found in every clean rotor, as residuals lean to where priors pull
the fit. How much of a
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


@dataclass(frozen=True)
class Scores:
    """A rotor's readings as its particles see them; see the module's text.

    blades   with readings, (B,); rows of each as they were assembled
    place    reading of each row within its blade's `rows.readings`, −1 beyond, (B, n)
    q        (B, n); information Q (B, n, n)
    slope    S, (B, n, S), and the prior variances of what it is by, (S,)
    answer   E[f], (B, n); lean: h, (B, n)
    x        mean inputs of the surrogate, one mapping a blade
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
    x: tuple[Mapping[str, float], ...]

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

    def pull(self, g: Array, grows: NDArray[np.bool_]) -> Array:
        """What `lean` adds to the score of each blade, (B, C).

        grows  whether a column goes with the answer, (C,)
        """
        answer = np.where(self.answer == 0, np.inf, self.answer)
        return np.asarray(np.einsum("bic,bi->bc", g, self.lean / answer) * grows)

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
    place, filled = np.full(shape, -1), [np.zeros(shape) for _ in range(3)]
    information = np.zeros((*shape, shape[1]))
    priors = shared_priors_of(model, state)
    slope = np.zeros((*shape, len(priors)))
    for b, one in enumerate(made):
        n = len(one.q)
        place[b, :n] = rows[b].of[:n]
        own = (one.q, one.answer, one.lean)
        for array, value in zip(filled, own, strict=True):
            array[b, :n] = value
        information[b, :n, :n] = one.information
        slope[b, :n] = one.shared
    q, answer, lean = filled
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
        tuple(one.x for one in made),
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
    """q (n,), Q (n, n), S (n, s), E[f] (n,), h (n,), mean inputs."""

    q: Array
    information: Array
    shared: Array
    answer: Array
    lean: Array
    x: Mapping[str, float]


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
    return _Blade(
        w @ r,
        np.linalg.inv(c),
        slope[:, len(own) :],
        answer,
        w @ ((f - answer) * r),
        dict(zip(names, (w @ x).tolist(), strict=True)),
    )


def _own_variance(parameter: Parameter, posterior: Posterior) -> float:
    """Prior variance of a local parameter; with a population, of the blades about its mean."""
    if parameter.population is None:
        return variance(parameter.prior)
    return float(posterior.particles.w @ posterior.column(f"sd.{parameter.name}") ** 2)
