"""Reference posteriors by NUTS: the joint target of a rotor, sampled by an independent method.

The target is the one of `core.calibration`, on the very same compiled rows (`core.response`), with
nothing integrated out and the surrogate's variance taken at every point,

    log p(s, l, D) = log p(s) + Σ_b log p(l_b)
                     + Σ_r log N(y_r | a_r e^{b_r}, sigma_r² + extra_r + s_r²) + remainders of scans

in float64. Every parameter lives on its box by u = low + (high − low) · sigmoid(q), with the exact
Jacobian, as numpyro's own transforms do; a log-uniform noise is uniform in its logarithm. All
parameters of all blades are sampled at once by the No-U-Turn Sampler (Hoffman & Gelman 2014) of
numpyro with a dense mass matrix. Needs the extra ``reference`` (numpyro and jax), which nothing
else does.

Posteriors of hot rotors are thin tubes: T1T and TBC thickness act through metal temperature, the
creep deviates follow at fixed readings, and the tube ends at the box. `Tubes` straightens them: a
blade's parameter is sampled as its distance from a cubic in T1T and the blade's parameters before
it, in units of a width that depends on them, too; both are fitted to rough draws. The map's exact
Jacobian is counted, so the target stays exact however good the fit is: a bad one costs gradients.
The study fits it to our own posterior's draws; the chains start far apart, twice as wide.

Convergence is judged by rank-normalised split R-hat and by bulk and tail effective sample sizes
(Vehtari, Gelman, Simpson, Carpenter & Bürkner 2021).
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, rankdata

from core.calibration.state import RotorSpec, RotorState
from core.calibration.target import DEGREE, assemble, locals_of, nominal, shared_space
from core.errors import CalibrationError, InputError, ModelError
from core.model import Model
from core.observation import Inspection
from core.response import Response, multi_indices
from core.rng import seed_of
from core.smc.particles import normalised

Array = NDArray[np.float64]


def jax_and_numpyro() -> tuple[ModuleType, ModuleType]:
    """jax and numpyro in float64, or an error that names the extra."""
    try:
        import jax
        import numpyro
    except ImportError as error:
        raise ModelError(
            f"{error.name} is not installed: reference posteriors need the extra 'reference'; "
            "run: pip install 'bladetwin[reference]'"
        ) from error
    numpyro.enable_x64()
    return jax, numpyro


@dataclass(frozen=True)
class Target:
    """A rotor's joint target as flat arrays.

    shared, local   names; low, high (S + L,) bounds on the working scale, shared ones first
    tables          (p, …, M, 3 U) coefficients of a, b and log v of U distinct rows: powers of
                    the shared inputs, then monomials of the local ones; known inputs collapsed
    exponents       (M, L) of the local monomials
    blade, row      (N,) which blade and which of the U rows a reading belongs to
    noise           (N,) index of its shared sigma, or −1 where `sd` (N,) is known
    remainders      (sigma index, sd, residual sum of squares, degrees of freedom) of scans
    """

    shared: tuple[str, ...]
    local: tuple[str, ...]
    blades: tuple[str, ...]
    low: Array
    high: Array
    logarithmic: NDArray[np.bool_]
    inputs: tuple[int, ...]
    tables: Array
    exponents: NDArray[np.int64]
    ka2: Array
    kb2: Array
    blade: NDArray[np.int64]
    row: NDArray[np.int64]
    y: Array
    extra: Array
    noise: NDArray[np.int64]
    sd: Array
    remainders: tuple[tuple[int, float, float, int], ...]

    @staticmethod
    def of(model: Model, rotor: RotorSpec, readings: Sequence[Inspection]) -> Target:
        """The target of these readings; blades without any are sampled from their prior.

        Raises InputError for a blade that the rotor does not have, and for normal priors.
        """
        by_blade: dict[str, list[Inspection]] = {}
        for reading in readings:
            if reading.blade not in rotor.blades:
                raise InputError("blade", reading.blade, f"is not on {rotor.id}", "install it")
            by_blade.setdefault(reading.blade, []).append(reading)
        found = {b: assemble(model, own) for b, own in sorted(by_blade.items())}
        rows = {b: r for b, r in found.items() if r is not None}
        space, parameters = shared_space(model, rows.values()), locals_of(model)
        physical = [n for n in space.names if n in model.input_names]
        outer = [model.input_names.index(n) for n in physical]
        inner = [model.input_names.index(p.name) for p in parameters]
        index: dict[bytes, int] = {}
        tables: list[Array] = []
        scales: list[tuple[float, float]] = []
        flat: list[tuple[int, int, float, float, int, float]] = []
        remainders = []
        for b, name in enumerate(rotor.blades):
            if name not in rows:
                continue
            own, fixed = rows[name], nominal(model, (rotor.known or {}).get(name))
            table = collapsed(own.response, outer, inner, fixed)
            for r, sigma in enumerate(own.sigma):
                ka, kb = float(own.response.ka[r]), float(own.response.kb[r])
                key = table[r].tobytes() + np.array([ka, kb]).tobytes()
                if key not in index:
                    index[key] = len(tables)
                    tables.append(table[r])
                    scales.append((ka, kb))
                at, sd = _noise(space.names, sigma)
                flat.append((b, index[key], float(own.y[r]), float(own.extra[r]), at, sd))
            for d in own.dense:
                remainders.append((*_noise(space.names, d.sigma), d.rss, d.dof))
        for prior in (*space.priors, *(p.prior for p in parameters)):
            if prior.kind == "normal":
                raise InputError("prior", "normal", "has no reference", "use the exact posterior")
        boxes = [p.box for p in space.priors] + [p.prior.box for p in parameters]
        blade, row, y, extra, noise, sd_ = zip(*flat, strict=True)
        return Target(
            space.names,
            tuple(p.name for p in parameters),
            rotor.blades,
            np.array([low for low, _ in boxes]),
            np.array([high for _, high in boxes]),
            np.array([p.log_scale for p in space.priors] + [False] * len(parameters)),
            tuple(space.names.index(n) for n in physical),
            np.concatenate([np.stack([t[k] for t in tables], axis=-1) for k in range(3)], axis=-1),
            multi_indices(len(inner), DEGREE),
            np.array([ka for ka, _ in scales]) ** 2,
            np.array([kb for _, kb in scales]) ** 2,
            np.array(blade),
            np.array(row),
            np.array(y),
            np.array(extra),
            np.array(noise),
            np.array(sd_),
            tuple(remainders),
        )

    def log_joint(self, jnp: Any, shared: Any, local: Any) -> Any:
        """log p on unit boxes: shared (S,), local (B, L) in 0 … 1; `jnp` is jax.numpy, numpy or
        pytensor.tensor.

        Densities of the shared and local parameters are taken with respect to the unit boxes.
        """
        s = len(self.shared)
        u = self.low[:s] + shared * (self.high[:s] - self.low[:s])
        mean, surrogate = (v[self.blade, self.row] for v in self.rows_at(jnp, shared, local))
        sigma = jnp.where(self.noise < 0, self.sd, jnp.exp(u[self.noise]))
        var = sigma**2 + self.extra + surrogate
        total = -0.5 * jnp.sum((self.y - mean) ** 2 / var + jnp.log(2 * math.pi * var))
        for at, sd, rss, dof in self.remainders:
            log_sigma = math.log(sd) if at < 0 else u[at]
            total += -0.5 * rss * jnp.exp(-2 * log_sigma) - dof * (
                log_sigma + 0.5 * math.log(2 * math.pi)
            )
        return total

    def rows_at(self, jnp: Any, shared: Any, local: Any) -> tuple[Any, Any]:
        """Mean and surrogate variance of every distinct row: local (n, L) → two (n, U)."""
        table = self.tables
        for i in self.inputs:
            table = jnp.tensordot(_powers(jnp, 2 * shared[i] - 1, table.shape[0]), table, 1)
        basis = monomials(jnp, 2 * local - 1, self.exponents)
        answers, u = basis @ table, len(self.ka2)
        a, b, log_v = answers[:, :u], answers[:, u : 2 * u], answers[:, 2 * u :]
        e2, v = jnp.exp(2 * b), jnp.exp(jnp.minimum(log_v, 50.0))
        return a * jnp.exp(b), e2 * v * (self.ka2 + a**2 * self.kb2)

    def natural(self, unit: Array, first: int) -> Array:
        """Unit box → natural values; the last axis starts at parameter `first`."""
        own = slice(first, first + unit.shape[-1])
        u = self.low[own] + unit * (self.high[own] - self.low[own])
        return np.asarray(np.where(self.logarithmic[own], np.exp(u), u))


def _noise(names: Sequence[str], sigma: str | float) -> tuple[int, float]:
    return (names.index(sigma), 1.0) if isinstance(sigma, str) else (-1, float(sigma))


def _powers(jnp: Any, z: Any, n: int) -> Any:
    """1, z, …, z^(n−1) along a new last axis."""
    out = [jnp.ones_like(z)]
    for _ in range(n - 1):
        out.append(out[-1] * z)
    return jnp.stack(out, axis=-1)


def monomials(jnp: Any, z: Any, exponents: NDArray[np.int64]) -> Any:
    """Products of powers: z (n, d), exponents (M, d) → (n, M); products with 0/1 matrices."""
    degree = int(exponents.max())
    out = 1.0
    for j in range(z.shape[1]):
        choice = np.eye(degree + 1)[:, exponents[:, j]]
        out = out * (_powers(jnp, z[:, j], degree + 1) @ choice)
    return out


def collapsed(
    response: Response, outer: Sequence[int], inner: Sequence[int], fixed: Mapping[str, float]
) -> Array:
    """Rows as tables (R, 3, p, …, M): powers of the inputs `outer`, monomials of `inner`.

    All other inputs are fixed. The three are a, b and log v.
    """
    exponents = multi_indices(len(response.names), response.degree)
    factor = np.ones(len(exponents))
    for j, name in enumerate(response.names):
        if j not in outer and j not in inner:
            z = 2 * (fixed[name] - response.low[j]) / (response.high[j] - response.low[j]) - 1
            factor *= z ** exponents[:, j]
    local = multi_indices(len(inner), response.degree).tolist()
    where = np.array([local.index(e) for e in exponents[:, list(inner)].tolist()])
    out = np.zeros((len(response), 3, *[response.degree + 1] * len(outer), len(local)))
    place = (*exponents[:, list(outer)].T, where)
    for r in range(len(response)):
        for k, c in enumerate((response.a[r], response.b[r], response.log_v[r])):
            np.add.at(out[r, k], place, c * factor)
    return out


@dataclass(frozen=True)
class Tubes:
    """Coordinates in which the posterior is roughly a round bell; exact whatever the fit.

    With standardised unconstrained values z (clipped softly to ±4, so that nothing runs away),

        q_shared = mean + sd e,   q_bj = c_bj(z_physical, z_b1 … z_b,j−1) + exp(k_bj) e_bj,

    c cubic, k linear in them and the noises; the Jacobian is Σ k. Parameter j of a blade thus
    follows the shared ones and the local ones before it, as the readings make it.

    mean, sd   (S,) and (B, L) moments of the unconstrained values
    centre     per local parameter: (B, M_j) coefficients of c / sd
    width      per local parameter: (B, 1 + S + j) coefficients of k
    metric     covariance of the coordinates, local first: NUTS's inverse mass matrix
    """

    mean: tuple[Array, Array]
    sd: tuple[Array, Array]
    physical: tuple[int, ...]
    centre: tuple[Array, ...]
    width: tuple[Array, ...]
    metric: Array

    @staticmethod
    def fitted(target: Target, shared: Array, local: Array) -> Tubes:
        """From rough joint draws on the unit boxes, shared (n, S) and local (n, B, L).

        What they miss costs time, not truth.
        """
        q_s, q_l = (_logit(np.clip(unit, 1e-4, 1 - 1e-4)) for unit in (shared, local))
        mean, sd = (tuple(getattr(q, how)(axis=0) for q in (q_s, q_l)) for how in ("mean", "std"))
        e_s = (q_s - mean[0]) / sd[0]
        z_l, z_s = (q_l - mean[1]) / sd[1], _soft(np, e_s)
        e_l, centre, width = np.empty_like(z_l), [], []
        for j in range(z_l.shape[2]):
            c, k = [], []
            for b in range(z_l.shape[1]):
                before, z = _soft(np, z_l[:, b, :j]), z_l[:, b, j]
                basis = _cubic(np, np.concatenate([z_s[:, list(target.inputs)], before], axis=1))
                lines = np.concatenate([np.ones((len(z), 1)), z_s, before], axis=1)
                ridge = 1e-3 * len(z) * np.eye(basis.shape[1])
                c.append(np.linalg.solve(basis.T @ basis + ridge, basis.T @ z))
                left = z - basis @ c[-1]
                log_left = np.log(np.abs(left) + 1e-4) + 0.635  # E log |N(0, 1)| = −0.635
                k.append(np.linalg.lstsq(lines, log_left, rcond=None)[0])
                e_l[:, b, j] = left * np.exp(-lines @ k[-1])
            centre.append(np.array(c))
            width.append(np.array(k))
        # numpyro lays coordinates out by their names in order: local, then shared
        flat = np.concatenate([e_l.reshape(len(e_l), -1), e_s], axis=1)
        cov = np.cov(np.clip(flat, -6, 6).T)
        metric = 0.95 * cov + 0.05 * np.diag(np.diag(cov))
        return Tubes(mean, sd, target.inputs, tuple(centre), tuple(width), metric)

    @staticmethod
    def none(target: Target) -> Tubes:
        """The unconstrained parameters themselves."""
        s, each, b = len(target.shared), len(target.local), len(target.blades)
        terms = [math.comb(3 + len(target.inputs) + j, 3) for j in range(each)]
        return Tubes(
            (np.zeros(s), np.zeros((b, each))),
            (np.ones(s), np.ones((b, each))),
            target.inputs,
            tuple(np.zeros((b, m)) for m in terms),
            tuple(np.zeros((b, 1 + s + j)) for j in range(each)),
            np.eye(s + b * each),
        )

    def straight(self, jnp: Any, e: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        """Coordinates e → unconstrained (q_shared, q_local) and the log Jacobian."""
        q_s = self.mean[0] + self.sd[0] * e["shared"]
        z_s = _soft(jnp, e["shared"])
        many = e["local"].shape[0]
        z_s = jnp.broadcast_to(z_s, (many, len(z_s)))
        found: list[Any] = []
        log_jacobian = 0.0
        for j, (centre, width) in enumerate(zip(self.centre, self.width, strict=True)):
            before = [_soft(jnp, z)[:, None] for z in found]
            basis = _cubic(jnp, jnp.concatenate([z_s[:, list(self.physical)], *before], axis=-1))
            lines = jnp.concatenate([jnp.ones((many, 1)), z_s, *before], axis=-1)
            k = jnp.sum(lines * width, axis=-1)
            found.append(jnp.sum(basis * centre, axis=-1) + jnp.exp(k) * e["local"][:, j])
            log_jacobian += jnp.sum(k)
        q_l = self.mean[1] + self.sd[1] * jnp.stack(found, axis=-1)
        return q_s, q_l, log_jacobian


def joint_draws(
    target: Target, state: RotorState, rng: np.random.Generator, n: int = 3000
) -> tuple[Array, Array]:
    """Joint draws of a state of ours on the unit boxes, for `Tubes.fitted`: (n, S), (n, B, L).

    Given a shared node the blades are independent: one particle each, by its weight there.
    """
    node = rng.choice(
        len(state.arrays["shared/log_w"]), n, p=normalised(state.arrays["shared/log_w"])
    )
    x = [state.arrays["shared/x"][node]]
    for blade in target.blades:
        local, log_w = (state.arrays[f"blade/{blade}/{part}"] for part in ("local", "log_w"))
        below = np.cumsum([normalised(w) for w in log_w], axis=1)[node]
        place = np.minimum((below < rng.random(n)[:, None]).sum(axis=1), local.shape[1] - 1)
        x.append(local[node, place])
    s = len(target.shared)
    shared = np.where(target.logarithmic[:s], np.log(np.maximum(x[0], 1e-300)), x[0])
    width = target.high - target.low
    return (
        (shared - target.low[:s]) / width[:s],
        (np.stack(x[1:], axis=1) - target.low[s:]) / width[s:],
    )


def _logit(unit: Array) -> Array:
    return np.asarray(np.log(unit) - np.log1p(-unit))


def _soft(jnp: Any, z: Any) -> Any:
    return 4 * jnp.tanh(z / 4)


def _cubic(jnp: Any, z: Any) -> Any:
    """Monomials up to total degree three along the last axis."""
    return monomials(jnp, z, multi_indices(z.shape[-1], 3))


def potential(target: Target, tubes: Tubes, jax: ModuleType) -> Any:
    """−log p of the coordinates {"shared": (S,), "local": (B, L)}, every Jacobian included."""

    def value(e: Mapping[str, Any]) -> Any:
        *q, total = tubes.straight(jax.numpy, e)
        total += target.log_joint(jax.numpy, *(jax.nn.sigmoid(part) for part in q))
        for part in q:
            total += jax.numpy.sum(jax.nn.log_sigmoid(part) + jax.nn.log_sigmoid(-part))
        return -total

    return value


@dataclass(frozen=True)
class Reference:
    """Draws of a rotor's posterior by NUTS, in natural units.

    shared (C, N, S), local (C, N, B, L): C chains of N draws; `report` holds the seed, settings,
    versions, divergences, gradient evaluations and seconds.
    """

    target: Target
    shared: Array
    local: Array
    report: Mapping[str, Any]

    def blade(self, blade: str) -> Array:
        """Joint draws of one blade: local, then shared parameters, (C, N, L + S)."""
        own = self.local[:, :, self.target.blades.index(blade)]
        return np.concatenate([own, self.shared], axis=2)


def sample(
    target: Target,
    *,
    seed: int,
    tubes: Tubes,
    chains: int = 8,
    warmup: int = 150,
    draws: int = 500,
    target_accept: float = 0.85,
    depth: int = 8,
) -> Reference:
    """Chains of NUTS, started far apart; one process, chains side by side.

    The mass matrix is that of `tubes`; the warm-up finds the step size. `depth`: a tree doubles at
    most so often.
    Raises ModelError without the extra, CalibrationError where a chain is not a number.
    """
    jax, numpyro = jax_and_numpyro()
    begin, run = jax.random.split(jax.random.PRNGKey(seed_of(seed, "nuts", *target.blades) % 2**63))
    s, (many, each) = len(target.shared), tubes.mean[1].shape
    e = 2.0 * np.asarray(jax.random.normal(begin, (chains, s + many * each)))
    kernel = numpyro.infer.NUTS(
        potential_fn=potential(target, tubes, jax),
        target_accept_prob=target_accept,
        max_tree_depth=depth,
        dense_mass=True,
        inverse_mass_matrix=jax.numpy.asarray(tubes.metric),
        adapt_mass_matrix=False,
    )
    mcmc = numpyro.infer.MCMC(
        kernel,
        num_warmup=warmup,
        num_samples=draws,
        num_chains=chains,
        chain_method="vectorized",
        progress_bar=False,
    )
    wall, cpu = time.monotonic(), time.process_time()
    start = {"local": e[:, s:].reshape(chains, many, each), "shared": e[:, :s]}
    mcmc.run(run, init_params=start, extra_fields=("num_steps", "diverging"))
    found = mcmc.get_samples(group_by_chain=True)
    extra = mcmc.get_extra_fields(group_by_chain=True)
    q = jax.vmap(jax.vmap(lambda at: tubes.straight(jax.numpy, at)[:2]))(found)
    shared, local = (np.asarray(jax.nn.sigmoid(part)) for part in q)
    if not (np.isfinite(shared).all() and np.isfinite(local).all()):
        raise CalibrationError("a chain of NUTS left the numbers; look at the readings")
    steps = np.asarray(extra["num_steps"])
    report = {
        "seed": seed,
        "chains": chains,
        "warmup": warmup,
        "draws": draws,
        "target_accept": target_accept,
        "divergences": int(np.sum(extra["diverging"])),
        "gradients_per_draw": round(float(steps.mean()), 1),
        "trees_at_their_limit": round(float(np.mean(steps >= 2**depth - 1)), 4),
        "seconds": round(time.monotonic() - wall, 2),
        "cpu_seconds": round(time.process_time() - cpu, 2),
        "versions": {name: version(name) for name in ("numpyro", "jax", "numpy")},
    }
    return Reference(target, target.natural(shared, 0), target.natural(local, s), report)


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Convergence of one scalar: R-hat, effective sample sizes, Monte-Carlo errors in sd."""

    r_hat: float
    ess_bulk: float
    ess_tail: float
    error_mean: float
    error_sd: float


def diagnosed(x: Array) -> Diagnosis:
    """Of draws (C, N) of one scalar; errors are in units of its standard deviation.

    >>> ok = diagnosed(np.random.default_rng(0).standard_normal((4, 1000)))
    >>> ok.r_hat < 1.01, ok.ess_bulk > 3000, 0.014 < ok.error_mean < 0.018
    (True, True, True)
    """
    low, high = np.quantile(x, [0.05, 0.95])
    z, folded = _ranks(x), _ranks(np.abs(x - np.median(x)))
    d2 = (x - x.mean()) ** 2
    return Diagnosis(
        max(_r_hat(z), _r_hat(folded)),
        effective(z),
        min(effective((x <= low).astype(float)), effective((x <= high).astype(float))),
        1 / math.sqrt(effective(x)),
        float(d2.std() / d2.mean() / 2 / math.sqrt(effective(d2))),
    )


def _ranks(x: Array) -> Array:
    """Normal scores of the ranks, chains pooled."""
    ranks = rankdata(x).reshape(x.shape)
    return np.asarray(norm.ppf((ranks - 0.375) / (x.size + 0.25)))


def _halves(x: Array) -> Array:
    n = x.shape[1] // 2
    return np.concatenate([x[:, :n], x[:, -n:]])


def _r_hat(x: Array) -> float:
    x = _halves(x)
    n = x.shape[1]
    within = x.var(axis=1, ddof=1).mean()
    between = x.mean(axis=1).var(ddof=1)
    return float(math.sqrt((n - 1) / n + between / within))


def effective(x: Array) -> float:
    """Effective sample size of split chains (C, N), Geyer's initial monotone sequence."""
    x = _halves(x)
    c, n = x.shape
    d = x - x.mean(axis=1, keepdims=True)
    size = 2 ** math.ceil(math.log2(2 * n))
    power = np.abs(np.fft.rfft(d, size, axis=1)) ** 2
    cov = np.fft.irfft(power, size, axis=1)[:, :n].mean(axis=0) / n
    within = cov[0] * n / (n - 1)
    total = within * (n - 1) / n + x.mean(axis=1).var(ddof=1)
    rho = 1 - (within - cov * n / (n - 1)) / total
    pairs = rho[: n - n % 2].reshape(-1, 2).sum(axis=1)
    pairs[0] = 1 + rho[1]
    below = np.flatnonzero(pairs < 0)
    pairs = np.minimum.accumulate(pairs[: below[0] if below.size else len(pairs)])
    return float(
        min(c * n / max(2 * pairs.sum() - 1, 1 / math.log10(c * n)), c * n * math.log10(c * n))
    )
