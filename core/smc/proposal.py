"""Proposals of the shared level's nodes: normal on the unit box, cut coordinate by coordinate.

q is a product of normal distributions, each conditional on the coordinates before it and cut at
the box (so that a posterior leaning on a bound is proposed exactly there),

    u_i = m_i + Σ_{j<i} C_ij z_j + C_ii z_i,      0 ≤ u_i ≤ 1,
    log q(u) = Σ_i log φ(z_i) − log C_ii − log(mass of φ inside the box).

Where a coordinate is known to have long tails φ is the density of a t-distribution in place of the
normal's: the logarithm of a noise that n readings tell falls off as exp(−n log sigma), and with
three readings half of its variance in natural units lies beyond its 99 % quantile, where a normal
has no node. Where all coordinates have them they have them together: z has the d-dimensional
t-distribution of nu degrees, whose coordinates given those before are

    z_i | z_<i ~ sqrt((nu + Σ_{j<i} z_j²) / (nu + i)) t(nu + i),      i = 0, 1, …

so that nodes in one's tail are spread in all others (a funnel: what noise is large tells nothing).
Moments become a proposal on a lattice, coarse (`rounded`) or fine (`finely_rounded`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, log_ndtr, ndtr, ndtri, ndtri_exp, stdtr, stdtrit

Array = NDArray[np.float64]
WIDEN = 1.4  # proposals are wider than what they propose for: tails are longer than a normal's
POOLED_WIDEN = 1.2  # where the moments are those of many more nodes
FAR = (
    6.0  # sds from the middle of a normal to the box from which on its tail is taken by logarithms
)
FREEDOM = 4.0  # of the t-distribution of coordinates with long tails


@dataclass(frozen=True, slots=True)
class Proposal:
    """Normal on the unit box: u = mean + chol z, cut coordinate by coordinate.

    mean (d,), chol (d, d) lower triangular. A `chol` of None stands for the uniform box.
    heavy  coordinates in which z has a t-distribution; a joint one, where it is all of them
    """

    mean: Array
    chol: Array | None
    heavy: tuple[int, ...] = ()

    def nodes(self, base: Array) -> tuple[Array, Array]:
        """Nodes (n, d) from points of the unit cube (n, d), and log q at each."""
        return self._walk(base, base)

    def log_density(self, u: Array) -> Array:
        """log q at places of the unit box (n, d)."""
        return self._walk(None, u)[1]

    def _walk(self, base: Array | None, u: Array) -> tuple[Array, Array]:
        """Coordinate by coordinate: places from points `base`, or given ones, and log q there."""
        n, d = u.shape
        if self.chol is None:
            return u.copy(), np.zeros(n)
        u, z, log_q = u.copy(), np.empty((n, d)), np.zeros(n)
        joint = len(self.heavy) == d
        for i in range(d):
            sd = np.full(n, self.chol[i, i])
            centre = self.mean[i] + z[:, :i] @ self.chol[i, :i]
            shape = _heavy(FREEDOM) if i in self.heavy else _NORMAL
            if joint and i > 0:
                shape = _heavy(FREEDOM + i)
                sd *= np.sqrt((FREEDOM + np.sum(z[:, :i] ** 2, axis=1)) / (FREEDOM + i))
            ends = (0.0 - centre) / sd, (1.0 - centre) / sd
            f0, f1 = shape.below(ends[0]), shape.below(ends[1])
            mass = np.maximum(f1 - f0, 1e-300)
            log_mass = np.log(sd * mass)
            far = (ends[0] > FAR) | (ends[1] < -FAR)
            if far.any():
                tail = _Tail.of(shape, ends[0][far], ends[1][far])
                log_mass[far] = np.log(sd[far]) + tail.log_mass
            if base is not None:
                step = shape.quantile(f0 + base[:, i] * mass)
                if far.any():
                    step[far] = tail.quantile(base[far, i])
                u[:, i] = np.clip(centre + sd * step, 0.0, 1.0)
            z[:, i] = (u[:, i] - centre) / self.chol[i, i]
            log_q += shape.log_density((u[:, i] - centre) / sd) - log_mass
        return u, log_q

    def spread(self, factor: float) -> Proposal:
        """So many times as wide."""
        return replace(self, chol=None if self.chol is None else factor * self.chol)

    def told(self) -> dict[str, Any]:
        """As JSON, from which `of` makes it again bit by bit.

        >>> one = Proposal(np.array([0.1, 1 / 3]), np.diag([0.1, 0.2]), (1,))
        >>> Proposal.of(one.told()).key == one.key
        True
        """
        chol = None if self.chol is None else self.chol.tolist()
        return {"mean": self.mean.tolist(), "chol": chol, "heavy": list(self.heavy)}

    @staticmethod
    def of(told: Mapping[str, Any]) -> Proposal:
        """The proposal that was told."""
        chol = None if told["chol"] is None else np.array(told["chol"], dtype=np.float64)
        return Proposal(np.array(told["mean"], dtype=np.float64), chol, tuple(told["heavy"]))

    @property
    def key(self) -> bytes:
        """Equal for equal nodes."""
        shape = b"" if self.chol is None else self.chol.tobytes() + bytes(self.heavy)
        return self.mean.tobytes() + shape


@dataclass(frozen=True, slots=True)
class _Shape:
    """A standard distribution of z, symmetric about 0.

    below, log_below        P(z' < z) and its logarithm
    quantile, log_quantile  z of a probability, and of the logarithm of one
    """

    below: Callable[[Array], Array]
    quantile: Callable[[Array], Array]
    log_density: Callable[[Array], Array]
    log_below: Callable[[Array], Array]
    log_quantile: Callable[[Array], Array]


@dataclass(frozen=True, slots=True)
class _Tail:
    """What a box holds of a distribution whose middle lies far aside, as of the tail below.

    A box above the middle is turned about it: seen from 0, 1 − P(z' < a) has no digits left. With
    P(z' < a) = e^A for the end a that is farther out, and e^B for the nearer one,

        log mass = B + log(1 − e^(A − B)),    z(p) = quantile of e^B (1 − (1 − p)(1 − e^(A − B))).
    """

    shape: _Shape
    above: NDArray[np.bool_]
    far: Array
    near: Array
    log_near: Array
    share: Array

    @staticmethod
    def of(shape: _Shape, low: Array, high: Array) -> _Tail:
        """Of boxes [low, high] (n,) in z."""
        above = low > 0
        far, near = np.where(above, -high, low), np.where(above, -low, high)
        log_near = shape.log_below(near)
        share = -np.expm1(shape.log_below(far) - log_near)
        return _Tail(shape, above, far, near, log_near, share)

    @property
    def log_mass(self) -> Array:
        return np.asarray(self.log_near + np.log(self.share))

    def quantile(self, p: Array) -> Array:
        """z in the boxes at points p (n,) of the unit interval."""
        out = np.where(self.above, p, 1.0 - p)
        z = self.shape.log_quantile(self.log_near + np.log1p(-out * self.share))
        z = np.clip(z, self.far, self.near)
        return np.where(self.above, -z, z)


_NORMAL = _Shape(
    ndtr,
    lambda p: np.clip(ndtri(p), -9.0, 9.0),
    lambda z: -0.5 * z**2 - np.log(np.sqrt(2 * np.pi)),
    log_ndtr,
    ndtri_exp,
)


@lru_cache(maxsize=16)
def _heavy(freedom: float) -> _Shape:
    """The t-distribution of so many degrees of freedom."""
    peak = gammaln((freedom + 1) / 2) - gammaln(freedom / 2) - 0.5 * np.log(freedom * np.pi)
    return _Shape(
        lambda z: stdtr(freedom, z),
        lambda p: stdtrit(freedom, p),
        lambda z: peak - 0.5 * (freedom + 1) * np.log1p(z**2 / freedom),
        lambda z: np.log(stdtr(freedom, z)),
        lambda log_p: stdtrit(freedom, np.exp(log_p)),
    )


def rounded(mean: Array, covariance: Array, heavy: tuple[int, ...] = ()) -> Proposal:
    """The proposal for these moments on the coarse lattice.

    Spreads are rounded to powers of sqrt 2, centres to half a spread, correlations to quarters, of
    two parameters to halves: single readings move those back and forth, and hardly any weight.
    """
    d = len(mean)
    parts = 2 if d <= 2 else 4
    covariance = covariance + 1e-14 * np.eye(d)
    chol = np.linalg.cholesky(covariance)
    out = np.zeros((d, d))
    for i in range(d):
        spread = 2.0 ** (np.round(2 * np.log2(WIDEN * chol[i, i])) / 2)
        out[i, i] = min(spread, 1.0)
        for j in range(i):
            turn = np.round(parts * chol[i, j] / chol[i, i]) / parts + 0.0  # never -0
            out[i, j] = turn * out[i, i]
    total = np.sqrt(np.sum(out**2, axis=1))
    step = 2.0 ** np.floor(np.log2(total)) / 2
    return Proposal(np.clip(np.round(mean / step) * step, 0.0, 1.0), out, heavy)


def finely_rounded(mean: Array, covariance: Array, heavy: tuple[int, ...]) -> Proposal:
    """The proposal for these moments, but for last bits that differ between machines."""
    chol = POOLED_WIDEN * np.linalg.cholesky(covariance + 1e-18 * np.eye(len(mean)))
    step = 2.0 ** np.floor(np.log2(np.diag(chol))) / 64
    return Proposal(
        np.clip(np.round(mean / step) * step, 0.0, 1.0),
        np.round(chol / step[:, None]) * step[:, None],
        heavy,
    )
