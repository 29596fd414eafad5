"""Reference posteriors that are kept: which rotors, how they are made, how they are stored.

A rotor is simulated by `core.validation.simulate`, or from finite-element runs; the list was fixed
by the truths alone, before any comparison: cold to hot, small to large noise, one outage to six,
coatings at both bounds and from a narrowed prior, scans and CEEQ. A file holds the readings, the
moments of all draws, thinned draws, and how they came about. Chains that have not converged to
`ACCEPTED` leave no file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import update
from core.calibration.state import Posterior, RotorSpec
from core.errors import CalibrationError, InputError, ModelError
from core.model import Model
from core.observation import Inspection
from core.rng import stream
from core.smc.particles import Particles
from core.validation.compare import AT_H, PREDICTED, Moments, with_prediction
from core.validation.convergence import Diagnosis, diagnosed, error_of_correlation
from core.validation.evidence import log_evidence
from core.validation.joint import Target
from core.validation.nuts import Reference, sample
from core.validation.simulate import simulate
from core.validation.tubes import Tubes, rough_draws
from core.validation.variants import Variant, model_of, plan

SCHEMA = 2
SEED = 41
KEPT = 300  # draws
# at most: split R-hat, Monte-Carlo errors in sd, share of divergent transitions
ACCEPTED = {"r_hat": 1.01, "mean": 0.03, "sd": 0.02, "correlation": 0.02, "divergent": 0.01}
PARTICLES, ROUGH = 10_000, 200_000  # of each blade: as the service has them; to fit coordinates to
ONE_OUTAGE = replace(plan("rotor-20", 12), name="one-outage", outages_h=(16e3,))
# name: (variant, number of the simulated rotor)
ROTORS: dict[str, tuple[Variant, int]] = {
    "cold": (plan("rotor-20", 10), 6),  # T1T 0.833, sigma 0.011 mm
    "one-outage": (ONE_OUTAGE, 0),  # 0.938, 0.039
    "at-bounds": (plan("coating-at-bounds", 10), 0),  # 0.899, 0.022
    "thin-coating": (plan("thin-coating", 10), 0),  # 0.956, 0.059
    "mixed": (plan("mixed", 8), 0),  # 0.888, 0.010
    "hot-fe": (plan("fe-six-outages", 10), 5),  # 0.978, 0.016
    "quiet": (plan("rotor-20", 8), 0),  # 0.924, 0.0025
    "eight-shared": (plan("eight-shared", 8), 0),
}
ARRAYS = ("mean", "sd", "correlation")


@dataclass(frozen=True)
class Stored:
    """A kept reference: `head` says how it was made; shared (n, S), local (n, B, L) are thinned."""

    head: Mapping[str, Any]
    moments: Moments
    shared: NDArray[np.float32]
    local: NDArray[np.float32]
    readings: tuple[Inspection, ...]

    @property
    def model(self) -> Model:
        """The model that it was made with, in its present version."""
        return model_of(ROTORS[self.head["rotor"]][0])

    @property
    def rotor(self) -> RotorSpec:
        """The rotor that is calibrated against it."""
        return RotorSpec(self.head["rotor"], self.moments.blades, PARTICLES)

    def save(self, folder: Path) -> None:
        """Writes <rotor>.npz (arrays) and <rotor>.json (head and readings)."""
        folder.mkdir(parents=True, exist_ok=True)
        stem = folder / self.head["rotor"]
        arrays = {name: getattr(self.moments, name) for name in ARRAYS}
        readings = []
        for i in self.readings:
            readings.append(i.to_json())
            if i.nodes is not None:
                del readings[-1]["values"], readings[-1]["nodes"]
                arrays |= {f"values/{i.id}": i.values, f"nodes/{i.id}": i.nodes}
        np.savez_compressed(
            stem.with_suffix(".npz"), shared=self.shared, local=self.local, **arrays
        )
        body = {**self.head, "readings": readings}
        stem.with_suffix(".json").write_text(json.dumps(body, indent=1) + "\n")

    @staticmethod
    def load(path: Path) -> Stored:
        """From its JSON file; raises ModelError where it is of another schema."""
        head = json.loads(path.read_text())
        if head.get("schema") != SCHEMA:
            raise ModelError(f"{path.name} is of schema {head.get('schema')}, not {SCHEMA}")
        with np.load(path.with_suffix(".npz")) as kept:
            data = {name: kept[name] for name in kept.files}
        moments = Moments(
            tuple(head["names"]), tuple(head["blades"]), *(data[name] for name in ARRAYS)
        )
        readings = tuple(
            Inspection(
                **i
                if "values" in i
                else {**i, "values": data[f"values/{i['id']}"], "nodes": data[f"nodes/{i['id']}"]}
            )
            for i in head.pop("readings")
        )
        return Stored(head, moments, data["shared"], data["local"], readings)


def make(
    name: str, *, seed: int, draws: int, chains: int, accept: float, made_by: Mapping[str, Any]
) -> Stored:
    """Simulate one rotor, sample its posterior by NUTS, judge the chains.

    accept    rate of acceptance that the step size is adapted to
    made_by   command and commit, kept in the head
    Raises InputError for a name that is not in `ROTORS`, ModelError without the extra,
    CalibrationError for chains that have not converged.
    """
    if name not in ROTORS:
        raise InputError("rotor", name, "is not on the list", f"use one of {', '.join(ROTORS)}")
    variant, number = ROTORS[name]
    model = model_of(variant)
    made = simulate(model, variant, number, SEED)
    rotor = RotorSpec(name, tuple(made.local), ROUGH)
    target = Target.of(model, rotor, made.readings)
    rough = update(model, rotor, made.readings)
    tubes = Tubes.fitted(target, *rough_draws(target, rough, stream(seed, "tubes", name)))
    found = sample(target, seed=seed, tubes=tubes, draws=draws, chains=chains, target_accept=accept)
    every, checks, of_correlations = judged(model, found)
    n = chains * draws
    reached = {
        "r_hat": round(max(d.r_hat for d in checks.values()), 4),
        "mean": round(max(d.error_mean for d in checks.values()), 4),
        "sd": round(max(d.error_sd for d in checks.values()), 4),
        "correlation": round(of_correlations, 4),
        "divergent": round(found.report["divergences"] / n, 4),
    }
    if any(reached[k] > most for k, most in ACCEPTED.items()):
        worst = max(checks, key=lambda key: checks[key].r_hat)
        raise CalibrationError(
            f"chains of {name} have not converged: {reached}, worst {worst}, accepted {ACCEPTED}; "
            "give more draws, or a higher rate of acceptance where transitions diverge"
        )
    evidence = log_evidence(found, seed=seed)
    keep = np.linspace(0, n - 1, KEPT).astype(int)
    local = [d for key, d in checks.items() if key not in target.shared]
    head = {
        "schema": SCHEMA,
        "rotor": name,
        **made_by,
        "model": model.digest,
        "variant": variant.name,
        "number": number,
        "simulation_seed": SEED,
        "truth": made.shared,
        "blades": list(rotor.blades),
        "names": list(every.names),
        "predicted_at_h": AT_H,
        "nuts": dict(found.report),
        "convergence": reached,
        "ess": {
            "shared_bulk": round(min(checks[n].ess_bulk for n in target.shared)),
            "shared_tail": round(min(checks[n].ess_tail for n in target.shared)),
            "local_bulk": round(min(d.ess_bulk for d in local)),
            "local_tail": round(min(d.ess_tail for d in local)),
        },
        "log_evidence": {k: round(v, 4) for k, v in asdict(evidence).items()},
    }
    return Stored(
        head,
        every,
        found.shared.reshape(n, -1)[keep].astype(np.float32),
        found.local.reshape(n, len(rotor.blades), -1)[keep].astype(np.float32),
        made.readings,
    )


def judged(model: Model, found: Reference) -> tuple[Moments, dict[str, Diagnosis], float]:
    """Moments of all draws; convergence of every parameter and prediction by its name.

    The last is the largest Monte-Carlo error of a correlation.
    """
    target = found.target
    names = (*target.local, *target.shared)
    posteriors, checks, worst = {}, {}, 0.0
    for blade in target.blades:
        draws = found.blade(blade)
        c, n, p = draws.shape
        posterior = Posterior(names, Particles(draws.reshape(c * n, p), np.zeros(c * n)))
        psi = with_prediction(model, posterior).reshape(c, n, p + 1)
        posteriors[blade] = posterior
        for j, name in enumerate((*names, PREDICTED)):
            key = name if name in target.shared else f"{blade} {name}"
            if key not in checks:
                checks[key] = diagnosed(psi[:, :, j])
        for i, j in combinations(range(p + 1), 2):
            worst = max(worst, error_of_correlation(psi[:, :, i], psi[:, :, j]))
    spec = RotorSpec("reference", target.blades)
    return Moments.of(model, spec, posteriors), checks, worst
