"""One rotor, one set of readings, several methods side by side: time and error.

    python tests/benchmarks/bench_posterior.py [ROTOR] [METHOD …] [--json FILE]

ROTOR is a stored reference (``tests/claims/results/reference``); methods: ours nuts pymc schedule.
Needs the extra `reference` (nuts) or pymc; a method that is not installed says so and is left out.
Each gets the readings and answers for all parameters of all blades; times are wall and processor
seconds of one process, compilation told apart. The error is against the stored long run: the
largest difference of a mean in reference sd, and the range of sd ratios, over all blades, local and
shared parameters and predictions.

What is compared: *ours* is the state that the service persists (10,000 particles a blade). NUTS and
PyMC are as a user would write them: the same target and compiled rows, defaults, a dense mass
matrix for NUTS; one chain, which costs them one adaptation only, sampled until T1T has 64 and 400
effective draws (ours: 64 nodes in a low-discrepancy net). For one more reading they start again:
there is no other way (numpyro#534, pymc#1780).
"""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import numpy as np

from core.calibration.online import Workspace, update
from core.calibration.state import Posterior, RotorSpec
from core.model import Model, rotor_blade
from core.observation import Inspection
from core.rng import stream
from core.smc.particles import Particles
from core.validation.compare import AT_H, Comparison, Stored, of_posteriors, of_state
from core.validation.nuts import Target, Tubes, effective, jax_and_numpyro, potential

FOLDER = Path(__file__).parents[1] / "claims" / "results" / "reference"
ENOUGH = (64, 400)
LIMIT_S = 600.0  # processor seconds after which a sampler is stopped and says how far it came
Row = dict[str, Any]


class Clock:
    """Wall and processor seconds since it was made."""

    def __init__(self) -> None:
        self.wall, self.cpu = time.perf_counter(), time.process_time()

    def read(self) -> dict[str, float]:
        """Seconds so far."""
        return {
            "wall_s": round(time.perf_counter() - self.wall, 3),
            "cpu_s": round(time.process_time() - self.cpu, 3),
        }


def error(found: Any, kept: Stored) -> dict[str, float]:
    """Largest |Δ mean| / sd, and the range of sd ratios; those of T1T apart."""
    c = Comparison.of(found, kept.moments)
    t1t = c.names.index("t1t_rate")
    return {
        "mean": round(float(np.abs(c.mean).max()), 3),
        "ratio_low": round(float(c.ratio.min()), 3),
        "ratio_high": round(float(c.ratio.max()), 3),
        "t1t_mean": round(float(c.mean[0, t1t]), 3),
        "t1t_ratio": round(float(c.ratio[0, t1t]), 3),
    }


def one_more(model: Model, kept: Stored) -> Inspection:
    """A further reading of the first blade, at AT_H: the reference's prediction plus noise."""
    y = float(kept.moments.mean[0, -1] + stream(0, "one more").normal() * kept.moments.sd[0, -1])
    return Inspection("more", kept.rotor.blades[0], "elongation", AT_H, np.array([y]))


def ours(model: Model, kept: Stored) -> list[Row]:
    """Offline from nothing; then one more reading, provisional and sealed."""
    rotor, readings = kept.rotor, list(kept.readings)
    update(model, rotor, readings[:1])  # compiles the kernels
    work, clock = Workspace(), Clock()
    state = update(model, rotor, readings, workspace=work)
    rows: list[Row] = [{"method": "ours, offline", **clock.read()}]
    rows[0] |= error(of_state(model, rotor, state), kept)
    more = [*readings, one_more(model, kept)]
    clock = Clock()
    quick = update(model, rotor, more, state, quick=True, workspace=work)
    rows.append({"method": "ours, one more reading, provisional", **clock.read()})
    clock = Clock()
    update(model, rotor, more, quick, workspace=work)
    rows.append({"method": "ours, one more reading, sealed after it", **clock.read()})
    return rows


def drawn(model: Model, kept: Stored, target: Target, shared: Any, local: Any) -> dict[str, float]:
    """Errors of draws on the unit boxes, shared (n, S) and local (n, B, L)."""
    x, y = target.natural(shared, 0), target.natural(local, shared.shape[1])
    names = (*target.local, *target.shared)
    found = {
        b: Posterior(names, Particles(np.concatenate([y[:, i], x], axis=1), np.zeros(len(x))))
        for i, b in enumerate(target.blades)
    }
    return error(of_posteriors(model, kept.rotor, found), kept)


def until_enough(
    name: str,
    clock: Clock,
    first: dict[str, float],
    batch: Callable[[], tuple[Any, Any]],
    judged: Callable[[Any, Any], dict[str, float]],
) -> list[Row]:
    """Batches of draws until T1T has each of ENOUGH effective ones; `first`: adaptation done."""
    shared, local = batch()
    rows: list[Row] = []
    for enough in ENOUGH:
        while (size := effective(shared[None, :, 0])) < enough:
            if clock.read()["cpu_s"] > LIMIT_S:
                break
            more = batch()
            shared, local = np.concatenate([shared, more[0]]), np.concatenate([local, more[1]])
        label = f"{name}, ESS {enough}" + ("" if size >= enough else f" not reached: {size:.0f}")
        rows.append({"method": label, **clock.read(), "adaptation_cpu_s": first["cpu_s"]})
        rows[-1] |= {"draws": len(shared), **judged(shared, local)}
    return rows


def nuts(model: Model, kept: Stored) -> list[Row]:
    """numpyro's NUTS, a dense mass matrix, 500 steps of adaptation."""
    jax, numpyro = jax_and_numpyro()
    target = Target.of(model, kept.rotor, kept.readings)
    tubes = Tubes.none(target)
    kernel = numpyro.infer.NUTS(potential_fn=potential(target, tubes, jax), dense_mass=True)
    mcmc = numpyro.infer.MCMC(kernel, num_warmup=500, num_samples=50, progress_bar=False)
    b, each = len(target.blades), len(target.local)
    start = {"local": np.zeros((b, each)), "shared": np.zeros(len(target.shared))}
    clock = Clock()
    mcmc.warmup(jax.random.PRNGKey(1), init_params=start)
    first = clock.read()

    def batch() -> tuple[Any, Any]:
        mcmc.run(mcmc.post_warmup_state.rng_key)
        mcmc.post_warmup_state = mcmc.last_state
        found = mcmc.get_samples()
        return tuple(1 / (1 + np.exp(-np.asarray(found[k]))) for k in ("shared", "local"))

    return until_enough(
        "numpyro NUTS",
        clock,
        first,
        batch,
        lambda shared, local: drawn(model, kept, target, shared, local),
    )


def pymc(model: Model, kept: Stored) -> list[Row]:
    """PyMC's NUTS on the same target, its defaults."""
    import pymc as pm
    import pytensor.tensor as pt

    target = Target.of(model, kept.rotor, kept.readings)
    b, each = len(target.blades), len(target.local)
    clock = Clock()
    with pm.Model():
        shared = pm.Uniform("shared", 0, 1, shape=len(target.shared))
        local = pm.Uniform("local", 0, 1, shape=(b, each))
        pm.Potential("readings", target.log_joint(pt, shared, local))
        drawn_ = pm.sample(
            draws=1000, tune=500, chains=1, cores=1, random_seed=1, progressbar=False,
            compute_convergence_checks=False,
        )  # fmt: skip
    one, each_one = (drawn_.posterior[name].values[0] for name in ("shared", "local"))
    size = effective(one[None, :, 0])
    row = {"method": f"PyMC NUTS, 1000 draws, ESS {size:.0f}", **clock.read()}
    return [row | {"draws": len(one)} | drawn(model, kept, target, one, each_one)]


def schedule(model: Model, kept: Stored) -> list[Row]:
    """The paper's Algorithm 1, offline, in its default reading."""
    from core.calibration.schedule import Schedule, calibrate

    rotor = RotorSpec(kept.rotor.id, kept.rotor.blades, 2000)
    clock = Clock()
    found = calibrate(model, rotor, kept.readings, Schedule())
    row = {"method": "the paper's schedule, offline", **clock.read()}
    joint = {b: found.blade(b) for b in rotor.blades}
    return [row | error(of_posteriors(model, rotor, joint), kept)]


METHODS: dict[str, Callable[[Model, Stored], list[Row]]] = {
    "ours": ours,
    "nuts": nuts,
    "pymc": pymc,
    "schedule": schedule,
}


def main(rotor: str, methods: Sequence[str], out: Path | None) -> None:
    """Run, print the table, write the JSON."""
    model, kept = rotor_blade(), Stored.load(FOLDER / f"{rotor}.json")
    rows: list[Row] = []
    for name in methods:
        try:
            found = METHODS[name](model, kept)
        except ImportError as missing:
            found = [{"method": name, "left_out": str(missing)}]
        rows += found
        for row in found:
            print("  ".join(f"{k}={v}" if k != "method" else str(v) for k, v in row.items()))
    result = {
        "command": " ".join(["python tests/benchmarks/bench_posterior.py", *sys.argv[1:]]),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}",
        "rotor": rotor,
        "blades": len(kept.rotor.blades),
        "readings": len(kept.readings),
        "rows": rows,
    }
    if out is not None:
        out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    words = sys.argv[1:]
    file = None
    if "--json" in words:
        at = words.index("--json")
        file, words = Path(words[at + 1]), words[:at] + words[at + 2 :]
    main(words[0] if words else "warm", words[1:] or list(METHODS), file)
