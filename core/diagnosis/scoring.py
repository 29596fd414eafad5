"""Scores from a rotor's state: what each blade's particles say of its readings (`scores`).

A row's residual over its variance, averaged over the particles (`core.diagnosis.stein`); the
sensitivities of the answers to local and shared parameters; and answers and inputs at a few of the
particles, for effects of physics.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import POOL
from core.calibration.space import locals_of, nominal, shared_prior
from core.calibration.state import Posterior, RotorState, blade_posterior
from core.calibration.target import BladeRows
from core.calibration.workspace import Workspace
from core.diagnosis.answering import Answering
from core.diagnosis.coherent import joined, loadings
from core.diagnosis.information import bounded, given, information, made_by_ends
from core.diagnosis.scores import Beside, Scores
from core.diagnosis.stein import fields, steadied
from core.errors import InputError
from core.model import Model
from core.network import Parameter
from core.observation import Inspection
from core.prior import Prior
from core.readings import digest_of
from core.surrogate.alike import alike

Array = NDArray[np.float64]
POINTS = 64  # particles of a blade at which effects of physics are computed
SLOPES = 256  # particles of a blade at which slopes by its own parameters are taken
STEP = 0.05  # of a prior's sd, for them


def scores(
    model: Model,
    state: RotorState,
    readings: Sequence[Inspection],
    known: Mapping[str, Mapping[str, float]] | None = None,
    workspace: Workspace | None = None,
    without: Collection[str] = (),
) -> Scores:
    """Of the readings that count, under the posterior that they made.

    workspace  of the update that made it, where its rows are already
    without    blades of which nothing is scored
    Raises InputError where there is no reading, or the state rests on others.
    """
    by_blade: dict[str, list[Inspection]] = {}
    for reading in readings:
        if reading.blade in without:
            continue
        by_blade.setdefault(reading.blade, []).append(reading)
    if not by_blade:
        raise InputError("readings", 0, "cannot be diagnosed", "post inspections first")
    blades = tuple(sorted(by_blade))
    work = workspace or Workspace()
    rows = tuple(work.rows_of(model, by_blade[b]) for b in blades)
    if state.meta["events_digest"] != digest_of(readings):
        raise InputError(
            "state", state.meta["events"], "rests on other readings than these", "update it first"
        )
    made = list(
        POOL.map(lambda b, r: _blade(model, state, b, r, (known or {}).get(b)), blades, rows)
    )
    shape = (len(made), max(len(one.q) for one in made))
    place, filled = np.full(shape, -1), [np.zeros(shape) for _ in range(3)]
    information, lean = (np.zeros((*shape, shape[1])) for _ in range(2))
    answers = np.zeros((shape[0], POINTS, shape[1]))
    priors = shared_priors_of(model, state)
    slope, pull = (np.zeros((*shape, len(priors))) for _ in range(2))
    for b, one in enumerate(made):
        n = len(one.q)
        place[b, :n] = rows[b].of[:n]
        own = (one.q, one.answer, one.unsure)
        for array, value in zip(filled, own, strict=True):
            array[b, :n] = value
        information[b, :n, :n] = one.information
        lean[b, :n, :n] = one.lean
        answers[b, :, :n] = one.answers
        slope[b, :n], pull[b, :n] = one.shared, one.pull
    q, answer, unsure = filled
    middle = [[np.mean(one.points.get(n, 0.0)) for n in model.input_names] for one in made]
    rho = alike(model.surrogate, np.array(middle), max(r.time_h for r in readings))
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
        unsure,
        pull,
        Beside.padded([one.beside for one in made], shape[1]),
        np.sqrt(rho) * joined([one.alike for one in made], shape[1]),
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
    """q (n,), Q (n, n), S (n, s), Cov[df_i/dθ, r_i] (n, s), E[f] (n,), Cov[f_j, r_i] (n, n), inputs
    and answers (K, n), sd of what the simulation does not know (n,), and what of it is alike."""

    q: Array
    information: Array
    shared: Array
    pull: Array
    answer: Array
    lean: Array
    points: Mapping[str, Array]
    answers: Array
    unsure: Array
    beside: Beside
    alike: Mapping[str, Array]


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
    own_rows = Answering(posterior, rows, names, x)

    def answered(moved: str, to: Array, of: NDArray[np.int64] | None = None) -> Array:
        return own_rows.at(moved, to, of)[0][:, :count]

    f, sd = own_rows.at()
    v, f, sd = own_rows.spread(sd)[:, :count], f[:, :count], sd[:, :count]
    locals_ = [p for p in locals_of(model) if p.name in names]
    others = [n for n in state.meta["shared"] if not n.startswith("sigma_obs.")]
    columns = np.array([posterior.column(n) for n in others]).reshape(len(others), len(w)).T
    answer, off = w @ f, columns - w @ columns
    size = np.sqrt(w @ off**2) + 1e-300
    typical, r = 1.0 / (w @ (1.0 / v)), (rows.y[:count] - f) / v
    slope, each = np.zeros((count, len(others))), np.zeros((len(w), count, len(others)))
    for k, name in enumerate(others):
        own = shared_prior(model, name)
        ends = tuple(np.clip(columns[:, k] + e * size[k], own.low, own.high) for e in (1, -1))
        apart = np.maximum(ends[0] - ends[1], 1e-300)
        each[:, :, k] = (answered(name, ends[0]) - answered(name, ends[1])) / apart[:, None]
        slope[:, k] = w @ each[:, :, k]
    u, toward = own_rows.slopes(locals_)
    boxes = np.array([p.prior.box for p in locals_]).reshape(-1, 2)
    better, middle = steadied(fields(u, boxes, toward, w), w), w @ x
    told = better[:, None] * r
    q, lean, leaning = told.sum(axis=0), told.T @ (f - answer), told.T @ (x - middle)
    pull = np.einsum("ki,kis->is", told, each - slope)
    some = _evenly(w, f, SLOPES)
    spread = np.zeros((count, len(locals_)))
    for k, p in enumerate(locals_):
        at, sd_ = posterior.column(p.name)[some], np.sqrt(_own_variance(p, posterior))
        ends = tuple(np.clip(at + e * STEP * sd_, p.prior.low, p.prior.high) for e in (1, -1))
        change = answered(p.name, ends[0], some) - answered(p.name, ends[1], some)
        by_own = np.mean(change / (ends[0] - ends[1])[:, None], axis=0)
        spread[:, k] = sd_ * by_own
        if (mean := f"mean.{p.name}") in others:  # it moves the blades with it
            slope[:, others.index(mean)] = by_own
    some = _evenly(w, f, POINTS)
    scanned = np.array([rows.readings[o].values.size > 1 for o in rows.of[:count]])
    mesh = (rows.relative[:count] * rows.y[:count]) ** 2 + rows.extra[:count] * scanned
    box = any(made_by_ends(p.prior) for p in locals_ if p.population is None)
    seen = information(typical, spread, given(off, f - answer, w), w)
    unsure = np.sqrt(w @ sd**2 + mesh)
    return _Blade(
        q,
        bounded(seen, typical, q, box),
        slope,
        pull,
        answer,
        lean,
        dict(zip(names, x[some].T, strict=True)),
        f[some],
        unsure,
        Beside(x[some], middle, leaning),
        loadings(model, rows, unsure),
    )


def _evenly(w: Array, f: Array, count: int) -> NDArray[np.int64]:
    """So many particles of equal weight, evenly along the sum of the answers f (P, n)."""
    spread = np.sqrt(w @ (f - w @ f) ** 2) + 1e-300
    order = np.argsort(np.sum(f / spread, axis=1), kind="stable")
    levels = (np.arange(count) + 0.5) / count
    places = np.searchsorted(np.cumsum(w[order]), levels)
    return np.asarray(order[np.minimum(places, len(w) - 1)])


def _own_variance(parameter: Parameter, posterior: Posterior) -> float:
    """Prior variance of a local parameter; with a population, of the blades about its mean."""
    if parameter.population is None:
        return variance(parameter.prior)
    return float(posterior.particles.w @ posterior.column(f"sd.{parameter.name}") ** 2)
