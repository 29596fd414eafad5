"""Our posterior against a reference: means, spreads, correlations, evidence.

For every blade the joint of its local parameters, the shared ones and its predicted elongation at
one later hour is compared, by

    (mean − mean_ref) / sd_ref,   sd / sd_ref,   correlation − correlation_ref,

each beside the Monte-Carlo errors of both sides: that of the reference from its effective sample
sizes, ours as the spread between seeds. Accepted are 0.1, 0.95 … 1.05 and 0.05.

The evidence of a rotor of two shared parameters is integrated a second time, in a way of its own:
Gauss–Legendre nodes over the shared box, scrambled Sobol points over each blade's, the same for
every node; the spread between scrambles is its error.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import qmc

from core.calibration.online import update
from core.calibration.state import Posterior, RotorSpec, RotorState, blade_posterior
from core.calibration.target import DEGREE
from core.errors import InputError, ModelError
from core.model import Model
from core.observation import Inspection
from core.prediction import inputs_of
from core.rng import seed_of
from core.smc.particles import Particles
from core.validation.nuts import Reference, Target, diagnosed

Array = NDArray[np.float64]
MEAN, SPREAD, CORRELATION = 0.1, 0.05, 0.05
AT_H = 32_000.0
SCHEMA = 1


@dataclass(frozen=True)
class Moments:
    """Of each blade's joint (local, shared, predicted elongation [mm]).

    mean, sd (B, P), correlation (B, P, P); error_mean, error_sd (B, P): Monte-Carlo errors in
    units of sd; error_correlation (B, P, P).
    """

    names: tuple[str, ...]
    blades: tuple[str, ...]
    mean: Array
    sd: Array
    correlation: Array
    error_mean: Array
    error_sd: Array
    error_correlation: Array


def _joint(model: Model, posterior: Posterior, known: Mapping[str, float] | None) -> Array:
    """Particles (N, P) with the predicted elongation at AT_H as the last column."""
    response = model.surrogate.response("elongation", np.array([AT_H]), None, degree=DEGREE)
    y = response.evaluate(inputs_of(model, posterior, known))[0]
    return np.concatenate([posterior.particles.psi, y], axis=1)


def _moments(psi: Array, w: Array) -> tuple[Array, Array, Array]:
    mean = w @ psi
    d = psi - mean
    cov = (d * w[:, None]).T @ d
    sd = np.sqrt(np.diag(cov))
    return mean, sd, cov / np.outer(sd, sd)


def of_reference(model: Model, reference: Reference, rotor: RotorSpec) -> Moments:
    """Moments of all draws, with their Monte-Carlo errors."""
    target = reference.target
    names = (*target.local, *target.shared)
    found = []
    for blade in target.blades:
        draws = reference.blade(blade)
        c, n, p = draws.shape
        particles = Particles(draws.reshape(c * n, p), np.zeros(c * n))
        psi = _joint(model, Posterior(names, particles), (rotor.known or {}).get(blade))
        mean, sd, corr = _moments(psi, np.full(c * n, 1 / (c * n)))
        checks = [diagnosed(psi[:, j].reshape(c, n)) for j in range(p + 1)]
        e_mean = np.array([d.error_mean for d in checks])
        e_sd = np.array([d.error_sd for d in checks])
        found.append((mean, sd, corr, e_mean, e_sd, _correlation_error(corr, e_mean)))
    arrays = [np.array(part) for part in zip(*found, strict=True)]
    return Moments((*names, "elongation"), target.blades, *arrays)


def _correlation_error(corr: Array, error_mean: Array) -> Array:
    """(1 − rho²) / sqrt(n), with the worse of two effective sample sizes."""
    return np.asarray((1 - corr**2) * np.maximum(error_mean[:, None], error_mean[None, :]))


def of_posteriors(model: Model, rotor: RotorSpec, found: Mapping[str, Posterior]) -> Moments:
    """Moments of each blade's joint particles; no Monte-Carlo errors, which one set cannot tell."""
    rows = []
    for blade in rotor.blades:
        psi = _joint(model, found[blade], (rotor.known or {}).get(blade))
        rows.append(_moments(psi, found[blade].particles.w))
    mean, sd, corr = (np.array(part) for part in zip(*rows, strict=True))
    names = (*found[rotor.blades[0]].names, "elongation")
    zero = np.zeros_like(mean)
    return Moments(names, rotor.blades, mean, sd, corr, zero, zero, np.zeros_like(corr))


def of_state(model: Model, rotor: RotorSpec, state: RotorState) -> Moments:
    """Moments of one of our states."""
    get = state.arrays.__getitem__
    found = {blade: blade_posterior(state.meta, get, blade) for blade in rotor.blades}
    return of_posteriors(model, rotor, found)


def ours(
    model: Model, rotor: RotorSpec, readings: Sequence[Inspection], seeds: Sequence[int] = (0,)
) -> tuple[list[Moments], list[RotorState]]:
    """Our calibration from nothing, once for each seed; the errors are the spread between seeds.

    The errors of each are zero where only one seed is given.
    """
    specs = [RotorSpec(rotor.id, rotor.blades, rotor.particles, s, rotor.known) for s in seeds]
    states = [update(model, spec, readings) for spec in specs]
    found = [of_state(model, spec, state) for spec, state in zip(specs, states, strict=True)]
    if len(found) > 1:
        sd = np.mean([m.sd for m in found], axis=0)
        errors = (
            np.std([m.mean for m in found], axis=0, ddof=1) / sd,
            np.std([m.sd for m in found], axis=0, ddof=1) / sd,
            np.std([m.correlation for m in found], axis=0, ddof=1),
        )
        found = [Moments(m.names, m.blades, m.mean, m.sd, m.correlation, *errors) for m in found]
    return found, states


@dataclass(frozen=True)
class Comparison:
    """Differences per blade and column; errors are those of both sides together."""

    names: tuple[str, ...]
    blades: tuple[str, ...]
    mean: Array
    ratio: Array
    correlation: Array
    error_mean: Array
    error_ratio: Array
    error_correlation: Array

    @staticmethod
    def of(found: Moments, reference: Moments) -> Comparison:
        """Raises InputError where the two do not speak of the same parameters and blades."""
        if found.names != reference.names or found.blades != reference.blades:
            raise InputError(
                "reference", reference.names, f"does not fit {found.names}", "make it anew"
            )
        return Comparison(
            found.names,
            found.blades,
            (found.mean - reference.mean) / reference.sd,
            found.sd / reference.sd,
            found.correlation - reference.correlation,
            np.hypot(found.error_mean, reference.error_mean),
            np.hypot(found.error_sd, reference.error_sd),
            np.hypot(found.error_correlation, reference.error_correlation),
        )

    def beyond(self, errors: float = 0.0) -> dict[str, list[str]]:
        """What lies outside the acceptance by more than so many Monte-Carlo errors."""
        pairs = list(combinations(range(len(self.names)), 2))
        found: dict[str, list[str]] = {"mean": [], "ratio": [], "correlation": []}
        for b, blade in enumerate(self.blades):
            for j, name in enumerate(self.names):
                if abs(self.mean[b, j]) > MEAN + errors * self.error_mean[b, j]:
                    found["mean"].append(f"{blade} {name} {self.mean[b, j]:+.3f}")
                if abs(self.ratio[b, j] - 1) > SPREAD + errors * self.error_ratio[b, j]:
                    found["ratio"].append(f"{blade} {name} {self.ratio[b, j]:.3f}")
            for i, j in pairs:
                difference = self.correlation[b, i, j]
                if abs(difference) > CORRELATION + errors * self.error_correlation[b, i, j]:
                    names = f"{self.names[i]}~{self.names[j]}"
                    found["correlation"].append(f"{blade} {names} {difference:+.3f}")
        return found

    def table(self) -> dict[str, dict[str, float]]:
        """The worst over all blades, by column."""
        return {
            name: {
                "mean": float(np.abs(self.mean[:, j]).max()),
                "ratio_low": float(self.ratio[:, j].min()),
                "ratio_high": float(self.ratio[:, j].max()),
                "correlation": float(np.abs(self.correlation[:, j]).max()),
                "error_mean": float(self.error_mean[:, j].max()),
                "error_ratio": float(self.error_ratio[:, j].max()),
            }
            for j, name in enumerate(self.names)
        }


@dataclass(frozen=True)
class Stored:
    """A reference that is kept: `head` says how it was made, `draws` are thinned."""

    head: Mapping[str, Any]
    moments: Moments
    shared: NDArray[np.float32]
    local: NDArray[np.float32]
    readings: tuple[Inspection, ...]

    @property
    def rotor(self) -> RotorSpec:
        """The rotor that is calibrated against it."""
        return RotorSpec(self.head["rotor"], tuple(self.head["blades"]), self.head["particles"])

    def save(self, folder: Path) -> None:
        """Writes <rotor>.npz (arrays) and <rotor>.json (head and readings)."""
        folder.mkdir(parents=True, exist_ok=True)
        m = self.moments
        arrays = {name: getattr(m, name) for name in ARRAYS}
        stem = folder / self.head["rotor"]
        np.savez_compressed(
            stem.with_suffix(".npz"), shared=self.shared, local=self.local, **arrays
        )
        body = {**self.head, "readings": [_written(i) for i in self.readings]}
        stem.with_suffix(".json").write_text(json.dumps(body, indent=1) + "\n")

    @staticmethod
    def load(path: Path) -> Stored:
        """From its JSON file; raises ModelError where it is of another schema."""
        head = json.loads(path.read_text())
        if head.get("schema") != SCHEMA:
            raise ModelError(f"{path.name} is of schema {head.get('schema')}, not {SCHEMA}")
        readings = _read(head.pop("readings"))
        with np.load(path.with_suffix(".npz")) as kept:
            arrays = [kept[name].astype(float) for name in ARRAYS]
            shared, local = kept["shared"], kept["local"]
        moments = Moments(tuple(head["names"]), tuple(head["blades"]), *arrays)
        return Stored(head, moments, shared, local, readings)


def _written(reading: Inspection) -> dict[str, Any]:
    """A scan by its name in the shipped inspection plan, everything else in full."""
    return reading.to_json() if reading.values.size == 1 else {"plan": reading.id}


def _read(found: Sequence[Mapping[str, Any]]) -> tuple[Inspection, ...]:
    if any("plan" in i for i in found):
        plan = {i.id: i for i in of_plan()}
        return tuple(plan[i["plan"]] if "plan" in i else Inspection(**i) for i in found)
    return tuple(Inspection(**i) for i in found)


def of_plan() -> list[Inspection]:
    """The readings of the shipped inspection plan."""
    from core.builtin import inspection_plan

    found = []
    for i in inspection_plan.load().inspections:
        values = i["values"] if "values" in i else [i["value"]]
        rest = {k: v for k, v in i.items() if k not in ("value", "values", "nodes")}
        nodes = np.array(i["nodes"]) if "nodes" in i else None
        found.append(Inspection(**rest, values=np.array(values), nodes=nodes))
    return found


def stored(
    model: Model,
    rotor: RotorSpec,
    readings: Sequence[Inspection],
    reference: Reference,
    truth: Mapping[str, float],
) -> Stored:
    """What is kept of a reference: moments of all draws, thinned draws, diagnostics."""
    target, n = reference.target, reference.shared.shape[0] * reference.shared.shape[1]
    shared = reference.shared.reshape(n, -1)
    local = reference.local.reshape(n, len(target.blades), -1)
    size = shared.shape[1] + local[0].size
    keep = np.linspace(0, n - 1, min(n, 1000, 65_000 // size)).astype(int)
    checks = {name: diagnosed(reference.shared[..., j]) for j, name in enumerate(target.shared)}
    checks |= {
        f"{blade} {name}": diagnosed(reference.local[:, :, b, j])
        for b, blade in enumerate(target.blades)
        for j, name in enumerate(target.local)
    }
    local_checks = [d for name, d in checks.items() if name not in target.shared]
    head = {
        "schema": SCHEMA,
        "rotor": rotor.id,
        "blades": list(rotor.blades),
        "particles": rotor.particles,
        "model": model.digest,
        "truth": dict(truth),
        "names": [*target.local, *target.shared, "elongation"],
        "predicted_at_h": AT_H,
        "nuts": dict(reference.report),
        "worst_r_hat": round(max(d.r_hat for d in checks.values()), 4),
        "least_ess_of_blades": round(min(d.ess_bulk for d in local_checks)),
        "least_tail_ess": round(min(d.ess_tail for d in checks.values())),
        "shared": {
            name: {k: round(v, 4) for k, v in asdict(checks[name]).items()}
            for name in target.shared
        },
    }
    return Stored(
        head,
        of_reference(model, reference, rotor),
        shared[keep].astype(np.float32),
        local[keep].astype(np.float32),
        tuple(readings),
    )


ARRAYS = ("mean", "sd", "correlation", "error_mean", "error_sd", "error_correlation")


def log_evidence(
    target: Target, *, seed: int, points: int = 2**15, nodes: int = 40, scrambles: int = 4
) -> tuple[float, float, dict[str, tuple[float, float]]]:
    """log p(D) by dense quadrature: value, standard error, shared (mean, sd) on working scales.

    For two shared parameters, one of them the noise of every reading, and no scan. Work grows
    with points · nodes² · readings.
    """
    if len(target.shared) != 2 or target.inputs != (0,) or target.remainders:
        raise InputError("target", target.shared, "is too wide for this", "use a small rotor")
    x, w = np.polynomial.legendre.leggauss(nodes)
    unit, weight = 0.5 * (x + 1), 0.5 * w
    log_sigma = target.low[1] + unit * (target.high[1] - target.low[1])
    tables = []
    for k in range(scrambles):
        total = np.zeros((nodes, nodes))
        for b in map(int, np.unique(target.blade)):
            own = np.flatnonzero(target.blade == b)
            rng = np.random.default_rng(seed_of(seed, "evidence", k, int(b)))
            local = qmc.Sobol(len(target.local), rng=rng).random(points)
            for i, rate in enumerate(unit):
                mean, var = target.rows_at(np, np.array([rate, 0.5]), local)
                mean, var = mean[:, target.row[own]], var[:, target.row[own]] + target.extra[own]
                for j, log_s in enumerate(log_sigma):
                    v = var + np.exp(2 * log_s)
                    fit = -0.5 * ((target.y[own] - mean) ** 2 / v + np.log(2 * np.pi * v))
                    total[i, j] += logsumexp(fit.sum(axis=1)) - np.log(points)
        tables.append(total + np.log(weight)[:, None] + np.log(weight)[None])
    values = np.array([logsumexp(t) for t in tables])
    p = np.exp(logsumexp(tables, axis=0) - logsumexp(tables))
    low, high = target.low[:2], target.high[:2]
    moments = {}
    for j, name in enumerate(target.shared):
        at, mass = low[j] + unit * (high[j] - low[j]), p.sum(axis=1 - j)
        centre = float(mass @ at)
        moments[name] = (centre, float(np.sqrt(mass @ (at - centre) ** 2)))
    error = float(values.std(ddof=1) / np.sqrt(scrambles))
    return float(logsumexp(values) - np.log(scrambles)), error, moments
