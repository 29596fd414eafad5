"""Studies of simulated rotors: calibrate many, see where the truths fall.

`calibrated` does one rotor, `run` many, in spawned processes if asked, each finished rotor a line
of a file, so that a study which was cut goes on where it was. `core.validation.verdict` turns the
lines into tables. No rotor is dropped: one that cannot be calibrated fails the study.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from core.calibration.online import update
from core.calibration.state import Posterior, RotorSpec, blade_posterior, shared_posterior
from core.curves import corrected, inputs_of, noise_of
from core.errors import BladetwinError, InputError
from core.model import Model
from core.prediction import predict
from core.prior import Prior
from core.rng import stream
from core.validation.records import Record, code_digest, records
from core.validation.sbc import Rank, node_pit, published_cdf, randomised_pit, wrong_pits
from core.validation.simulate import Held, simulate
from core.validation.variants import COATING, Variant, model_of

Array = NDArray[np.float64]
PARTICLES = 4000
EDGE, HELD_BY_EDGE = 0.1, 0.5
AT_BOUND = f"{COATING}, posterior at a bound"


def calibrated(model: Model, variant: Variant, rotor: int, seed: int, particles: int) -> Record:
    """One rotor: by name, its truths' PITs, right and deliberately wrong, and its predictions.

    Blades whose posterior holds half of its mass in the outer tenths of the coating's range count
    a second time, under a name of their own: they are chosen by their data alone, so that their
    truths' PITs are uniform, too. So do the few blades of a mixed rotor with a scan or a CEEQ.
    """
    start = time.monotonic()
    made = simulate(model, variant, rotor, seed)
    record: Record = {"rotor": rotor, "cluster": made.cluster, "truths": {}, "held": {}}
    spec = RotorSpec(f"{variant.name}-{rotor}", tuple(made.local), particles, seed)
    try:
        state = update(model, spec, made.readings)
    except BladetwinError as error:
        return record | {"error": str(error), "seconds": time.monotonic() - start}
    rng = stream(seed, variant.name, "ranks", rotor)

    def count(
        name: str, values: Array, w: Array, truth: float, rank: Rank = randomised_pit
    ) -> None:
        u = float(rng.random())
        found = {
            "pit": rank(values, w, truth, u),
            "cdf": published_cdf(values, w, truth),
            **wrong_pits(values, w, truth, u, rank),
        }
        for key, value in found.items():
            record["truths"].setdefault(name, {}).setdefault(key, []).append(round(value, 5))

    get = state.arrays.__getitem__
    rotor_wide = shared_posterior(state.meta, get)
    for name in rotor_wide.names:
        column, w = rotor_wide.column(name), rotor_wide.particles.w
        count(name, column, w, made.shared[name], node_pit)
    special = {
        kind: {r.blade for r in made.readings if r.quantity == quantity}
        for kind, quantity in (("scanned blade", "deformation"), ("CEEQ read", "ceeq"))
    }
    held: dict[str, list[Held]] = {}
    for one in made.held:
        held.setdefault(one.blade, []).append(one)
    for blade, truths in made.local.items():
        posterior = blade_posterior(state.meta, get, blade)
        w = posterior.particles.w
        kinds = [kind for kind, which in special.items() if blade in which]
        for name, truth in truths.items():
            for label in (name, *(f"{name}, {kind}" for kind in kinds)):
                count(label, posterior.column(name), w, truth)
        if COATING in truths:
            coating = posterior.column(COATING)
            if _edge_mass(coating, w, model.network.parameter(COATING).prior) > HELD_BY_EDGE:
                count(AT_BOUND, coating, w, truths[COATING])
        for one in held.get(blade, []):
            for key, value in judged(model, posterior, one).items():
                kept = record["held"].setdefault(f"held-out {one.quantity}", {})
                kept.setdefault(key, []).append(None if np.isnan(value) else round(value, 5))
    health = state.meta["health"]
    return record | {"ess_ratio": health["ess_ratio"], "seconds": time.monotonic() - start}


def _edge_mass(values: Array, w: Array, prior: Prior) -> float:
    edge = EDGE * (prior.high - prior.low)
    return float(w @ ((values < prior.low + edge) | (values > prior.high - edge)))


def judged(model: Model, posterior: Posterior, held: Held) -> dict[str, float]:
    """PIT of a held-out reading, whether published intervals hold it, and the squares by source."""
    p = predict(model, posterior, held.quantity, [held.time_h], probability=0.5)
    q = {key: float(value[0]) for key, value in p.quantiles.items()}
    ends = {
        0.5: (p.lower[0], p.upper[0]),
        0.68: (q[0.16], q[0.84]),
        0.9: (q[0.05], q[0.95]),
        0.95: (q[0.025], q[0.975]),
    }
    mean, square = float(p.mean[0]), {name: float(sd[0]) ** 2 for name, sd in p.sd.items()}
    out = {f"in {c}": float(low <= held.reading <= high) for c, (low, high) in ends.items()}
    out["pit"] = _mixture_cdf(model, posterior, held)
    out["parameters"] = (held.model - mean) ** 2 / square["parameters"]
    out["value"] = (held.value - mean) ** 2 / (square["total"] - square["noise"])
    out["reading"] = (held.reading - mean) ** 2 / square["total"]
    return out


def _mixture_cdf(model: Model, posterior: Posterior, held: Held) -> float:
    """Σ w_i Φ((y − m_i) / sd_i) over all particles, without the shortcuts of a prediction."""
    declared, w = model.network.quantity(held.quantity), posterior.particles.w
    surrogate = model.part(held.quantity)
    node = None if declared.kind == "scalar" else [declared.node_among(surrogate.named)]
    x = inputs_of(model, posterior, held.quantity)
    mean, sd = surrogate.predict(x, held.quantity, np.array([held.time_h]), node)
    mean, sd = mean.reshape(len(w)), sd.reshape(len(w))
    sigma = noise_of(model, posterior, held.quantity)
    gain, offset, sigma_delta, left = (
        part[..., 0]
        for part in corrected(model, posterior, declared, np.array([held.time_h]), None)
    )
    own = (gain * sd) ** 2 + (gain * np.hypot(declared.numerical, left) * mean) ** 2
    total = np.sqrt(own + sigma_delta**2 + sigma**2)
    return float(w @ ndtr((held.reading - gain * mean - offset) / total))


def run(
    variant: Variant,
    *,
    rotors: int,
    seed: int,
    particles: int = PARTICLES,
    processes: int = 1,
    folder: str | Path | None = None,
    commit: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Record]:
    """Simulate and calibrate rotors 0 … `rotors` − 1, in the order of their numbers.

    folder   keeps a file of finished rotors, named by all that a record rests on: the variant, the
             seed, the particles, the commit and the code. What it holds is not computed again.
    """
    file = kept(variant.name, variant, seed, particles, folder, commit)
    return each_rotor(_spawned, variant, rotors, seed, particles, file, processes, progress)


def kept(
    name: str,
    variant: Variant,
    seed: int,
    particles: int,
    folder: str | Path | None,
    commit: str | None,
) -> Path | None:
    """The file of a study's finished rotors, named by all that a record rests on."""
    if folder is None:
        return None
    text = repr((variant, seed, particles, commit, code_digest(), model_of(variant).digest))
    return Path(folder) / f"{name}-{sha256(text.encode()).hexdigest()[:12]}.jsonl"


def each_rotor(
    work: Callable[[Variant, int, int, int], Record],
    variant: Variant,
    rotors: int,
    seed: int,
    particles: int,
    file: Path | None,
    processes: int,
    progress: Callable[[int, int], None] | None,
) -> list[Record]:
    """`work` of each of so many rotors, in the order of their numbers. InputError: too few."""
    if rotors < 2:
        raise InputError("rotors", rotors, "are too few for a study", "give two or more")
    return records(
        {r: (variant, r, seed, particles) for r in range(rotors)},
        work,
        lambda record: int(record["rotor"]),
        file=file,
        processes=processes,
        progress=progress,
    )


_models: dict[Variant, Model] = {}


def _spawned(variant: Variant, rotor: int, seed: int, particles: int) -> Record:
    """A rotor; the process keeps the model and its compiled rows."""
    if variant not in _models:
        _models[variant] = model_of(variant)
    return calibrated(_models[variant], variant, rotor, seed, particles)
