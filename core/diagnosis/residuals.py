"""Every reading predicted before it is used.

Readings are ordered by the rotor's hour at which they were taken (`core.diagnosis.clock`), not by
arrival. Those of one hour, or of hours closer than `SAME` of the longest history, are one *visit*
D_k; each is predicted from the visits before it alone,

    y_i ~ p(y_i | D_1 … D_k−1) = Σ_j w_j N(g_j f_j + o_j, v_j),      i in D_k,

(Dawid's prequential predictive), with the particles j of its blade in the sealed posterior of these
readings: f the surrogate, g and o discrepancies and biases of its reader, v surrogate and noise.
A parameter that nobody has read yet keeps its prior. Then

    z_i = (y_i − mean_i) / sd_i,      PIT_i = P(y < y_i | D_1 … D_k−1),

and PIT is uniform wherever the model holds, from the first visit, which is predicted from the
priors, to the last. As a sealed posterior is a function of readings, seed and algorithm, so is
every z: arrival order, corrections and retractions leave no trace (mark 7).

One calibration a visit is the price: three for three outages, `MOST` at most, as neighbouring
visits are joined beyond that (each reading is then predicted from farther back, honestly). The
cheap way, the final particles weighted by 1 / likelihood of what came later, was measured on 20
blades read at three visits (`core/decisions.md`): of the blade's 2,000 particles a handful counts.

Readings of one visit are not independent: they miss together where the shared parameters do. What
tests need of that is kept with the visit: the covariance C of its z,

    C = between blades: Cov over the shared nodes of E[z | node];   within a blade: over particles,

and `signal`, `noise`: z = signal + noise · e as the predictive draws it, one shared node for all
blades in each of `DRAWS` draws, e of unit variance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from core.calibration.online import Workspace, update
from core.calibration.space import nominal, shared_prior
from core.calibration.state import RotorSpec, RotorState, blade_posterior
from core.calibration.target import BladeRows, assemble
from core.diagnosis.grammar import Facts
from core.discrepancy import total
from core.errors import InputError
from core.model import Model
from core.observation import Inspection
from core.prediction import spread
from core.rng import stream

Array = NDArray[np.float64]
SAME = 0.02  # share of the longest history within which hours are one visit
MOST = 12  # visits; neighbours are joined beyond
DRAWS = 2000


@dataclass(frozen=True, slots=True)
class Residual:
    """A reading against its prediction [unit]; of a scan, one for each of its rows (`part`)."""

    reading: Inspection
    part: int
    visit: int
    hour: float
    y: float
    mean: float
    sd: float
    z: float
    pit: float


@dataclass(frozen=True)
class Visit:
    """Readings that were predicted together; n rows.

    residuals   in the order of (blade, hour, id, part)
    covariance  C of their z, (n, n)
    signal, noise   draws of z: signal + noise · e, (DRAWS, n) each
    health      of the state that predicted them
    """

    residuals: tuple[Residual, ...]
    covariance: Array
    signal: Array
    noise: Array
    health: Mapping[str, object]

    @property
    def z(self) -> Array:
        return np.array([r.z for r in self.residuals])


def visits_of(
    readings: Sequence[Inspection], facts: Mapping[str, Facts], most: int = MOST
) -> list[list[Inspection]]:
    """The readings by visit, in the order of the rotor's hours.

    >>> a, b, c = (Inspection(n, "B", "y", h, [0.0]) for n, h in (("a", 99.0), ("b", 1.0),
    ...     ("c", 100.0)))
    >>> [[r.id for r in visit] for visit in visits_of([a, b, c], {})]
    [['b'], ['a', 'c']]
    """
    hours = np.array([_hour(r, facts) for r in readings])
    apart = SAME * float(hours.max(initial=0.0))
    found: list[list[Inspection]] = []
    began = -np.inf
    for i in np.lexsort((np.array([r.id for r in readings]), hours)):
        if hours[i] - began > apart:
            began = float(hours[i])
            found.append([])
        found[-1].append(readings[int(i)])
    while len(found) > most:
        sizes = [len(a) + len(b) for a, b in pairwise(found)]
        k = int(np.argmin(sizes))
        found[k : k + 2] = [found[k] + found[k + 1]]
    return found


def _hour(reading: Inspection, facts: Mapping[str, Facts]) -> float:
    own = facts.get(reading.blade)
    return reading.time_h + (0.0 if own is None else own.offset_h)


def residuals(
    model: Model,
    spec: RotorSpec,
    readings: Sequence[Inspection],
    facts: Mapping[str, Facts],
    say: Callable[[str, int, int], None] = lambda what, done, total: None,
    workspace: Workspace | None = None,
) -> list[Visit]:
    """Every reading that counts, predicted from the visits before its own.

    say   called with (what, done, visits) before each calibration; what it raises ends the work

    Raises InputError where no reading counts.
    """
    if not readings:
        raise InputError("readings", 0, "count: there is nothing to predict", "post inspections")
    work = workspace or Workspace()
    visits, found = visits_of(readings, facts), list[Visit]()
    before: list[Inspection] = []
    for number, visit in enumerate(visits):
        say(f"visit {number + 1}", number, len(visits))
        state = update(model, spec, before, workspace=work)
        found.append(predicted(model, spec, state, visit, facts, number))
        before += visit
    return found


def predicted(
    model: Model,
    spec: RotorSpec,
    state: RotorState,
    visit: Sequence[Inspection],
    facts: Mapping[str, Facts],
    number: int,
) -> Visit:
    """A visit's readings under a state; prequential where the state rests on those before it."""
    by_blade: dict[str, list[Inspection]] = {}
    for reading in visit:
        by_blade.setdefault(reading.blade, []).append(reading)
    rng = stream(spec.seed, spec.id, "residuals", str(number))
    log_w = state.arrays["shared/log_w"]
    w = np.exp(log_w - log_w.max())
    node = rng.choice(len(w), DRAWS, p=w / w.sum())
    fresh = _Fresh(model, spec.seed)
    parts = []
    for blade in sorted(by_blade):
        rows = assemble(model, by_blade[blade])
        assert rows is not None
        known = (spec.known or {}).get(blade)
        parts.append(_blade(model, state, blade, rows, known, node, fresh, rng))
    found = []
    for part in parts:
        seen: dict[int, int] = {}
        for i, place in enumerate(part.place):
            reading = part.rows.readings[place]
            seen[place] = seen.get(place, -1) + 1
            hour = _hour(reading, facts)
            values = (float(v[i]) for v in (part.y, part.mean, part.sd, part.z, part.pit))
            found.append(Residual(reading, seen[place], number, hour, *values))
    means = np.concatenate([p.by_node for p in parts], axis=1)  # (K, n)
    weight = (w / w.sum())[:, None]
    off = means - np.sum(weight * means, axis=0)
    covariance = off.T @ (weight * off)
    at = 0
    for p in parts:
        end = at + len(p.z)
        covariance[at:end, at:end] = p.covariance
        at = end
    return Visit(
        tuple(found),
        covariance,
        np.concatenate([p.signal for p in parts], axis=1),
        np.concatenate([p.noise for p in parts], axis=1),
        dict(state.meta["health"]),
    )


@dataclass(frozen=True)
class _Fresh:
    """Values of shared parameters that nobody has read yet: the same for all blades of a draw."""

    model: Model
    seed: int
    drawn: dict[str, Array] = field(default_factory=dict)

    def of_draws(self, name: str) -> Array:
        """(DRAWS,)"""
        if name not in self.drawn:
            uniform = stream(self.seed, "fresh", name).random(DRAWS)
            self.drawn[name] = np.asarray(shared_prior(self.model, name).quantile(uniform))
        return self.drawn[name]


@dataclass(frozen=True)
class _Predicted:
    """A blade's rows: y, mean, sd [unit], z, PIT (n,); by_node (K, n); signal, noise (DRAWS, n)."""

    rows: BladeRows
    place: tuple[int, ...]
    y: Array
    mean: Array
    sd: Array
    z: Array
    pit: Array
    covariance: Array
    by_node: Array
    signal: Array
    noise: Array


def _blade(
    model: Model,
    state: RotorState,
    blade: str,
    rows: BladeRows,
    known: Mapping[str, float] | None,
    node: NDArray[np.int64],
    fresh: _Fresh,
    rng: np.random.Generator,
) -> _Predicted:
    get = state.arrays.__getitem__
    posterior = blade_posterior(state.meta, get, blade)
    w, nodes = posterior.particles.w, len(get("shared/log_w"))
    names, fixed = rows.response.names, nominal(model, rows.response.names, known)
    x = np.stack(
        [posterior.column(n) if n not in fixed else np.full(len(w), fixed[n]) for n in names],
        axis=1,
    )
    place = tuple(p for p in rows.of if p >= 0)
    n = len(place)
    f, deviation = (a[:, :n] for a in rows.response.evaluate(x))
    deviation = deviation / np.sqrt(rows.discount[:n])  # forgetting is of readings that are used
    places: dict[str, int] = {}

    def of_particles(name: str) -> Array:
        if name in posterior.names:
            return posterior.column(name)
        at = places.setdefault(name, len(places)) % 7
        return spread(shared_prior(model, name), len(w), at)

    per = len(w) // nodes
    within = np.exp(get(f"blade/{blade}/log_w") - get(f"blade/{blade}/log_w").max(1, keepdims=True))
    reached = np.cumsum(within, axis=1)[node]
    draw = (reached < (rng.random(DRAWS) * reached[:, -1])[:, None]).sum(axis=1)
    chosen = node * per + np.minimum(draw, per - 1)

    def of_draws(name: str) -> Array:
        if name in posterior.names:
            return np.asarray(posterior.column(name)[chosen])
        return fresh.of_draws(name)

    def seen(value: Callable[[str], Array], answer: Array, sd: Array) -> tuple[Array, Array, Array]:
        """Mean, variance beside the noise, and variance of the noise, of each row."""
        count = len(answer)
        gain, offset, noise = (np.empty((count, n)) for _ in range(3))
        for i, one in enumerate(rows.discrepancy[:n]):
            gain[:, i] = 1.0 + total(one.gain, value)
            offset[:, i] = total(one.offset, value)
            sigma = rows.sigma[i]
            noise[:, i] = np.square(value(sigma) if isinstance(sigma, str) else sigma)
        beside = (gain * sd) ** 2 + (rows.relative[:n] * gain * answer) ** 2 + rows.extra[:n]
        return gain * answer + offset, beside, noise

    centre, beside, noise = seen(of_particles, f, deviation)
    v, y = beside + noise, rows.y[:n]
    mean = w @ centre
    off = centre - mean
    covariance = off.T @ (w[:, None] * off) + np.diag(w @ v)
    sd = np.sqrt(np.diag(covariance))
    drawn, drawn_beside, drawn_noise = seen(of_draws, f[chosen], deviation[chosen])
    drawn = drawn + np.sqrt(drawn_beside) * rng.standard_normal(drawn.shape)
    weight = w.reshape(nodes, per)
    share = weight.sum(axis=1, keepdims=True) + 1e-300
    return _Predicted(
        rows,
        place,
        y,
        mean,
        sd,
        (y - mean) / sd,
        w @ ndtr((y - centre) / np.sqrt(v)),
        covariance / np.outer(sd, sd),
        np.einsum("kj,kjn->kn", weight / share, off.reshape(nodes, per, n)) / sd,
        (drawn - mean) / sd,
        np.sqrt(drawn_noise) / sd,
    )
