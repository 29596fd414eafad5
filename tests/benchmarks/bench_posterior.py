"""One rotor, one set of readings, several methods side by side: time and error.

    python tests/benchmarks/bench_posterior.py [ROTOR] [METHOD …] [--json FILE]

ROTOR is a stored reference (``tests/claims/results/reference``); methods: ours schedule nuts pymc.
Needs the extra `reference` (nuts) or pymc; a method that is not installed says so and is left out.
Each gets the readings and answers for all parameters of all blades; times are wall and processor
seconds of one process, compilation of ours told apart. The error is against the stored long run:
the largest difference of a mean in reference sd, and the range of sd ratios, over all blades, local
and shared parameters and predictions. ESS is that of the least of the shared parameters; for ours,
whose nodes are no chain, 1 / mean square error of their means over `SEEDS` seeds, in reference sd.

What is compared: *ours* is the state that the service persists (10,000 particles a blade); online,
readings come one by one in the order of their hours, each answered by a provisional state, and one
sealed state follows. The *schedule* is the paper's (`core.calibration.schedule`), with as many
particles; it keeps no state, so one more reading costs an online run's last outage at least. NUTS
and PyMC are as a user would write them: the same target and compiled rows on unit boxes, defaults,
a dense mass matrix for NUTS; one chain, which costs them one adaptation only, until there are
ENOUGH effective draws or LIMIT_S processor seconds are over. For one more reading they start again:
there is no other way (numpyro#534, pymc#1780).
"""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

import numpy as np

from core.calibration.online import Workspace, update
from core.calibration.schedule import Schedule, calibrate
from core.calibration.state import Posterior
from core.errors import ModelError
from core.observation import Inspection
from core.rng import stream
from core.smc.particles import Particles
from core.validation.compare import AT_H, Comparison, Moments
from core.validation.convergence import effective
from core.validation.joint import Target
from core.validation.nuts import jax_and_numpyro
from core.validation.reference import Stored

FOLDER = Path(__file__).parents[1] / "claims" / "results" / "reference"
ENOUGH = 400
LIMIT_S = float(os.environ.get("LIMIT_S", "600"))
SEEDS = 4
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


def error(found: Moments, kept: Stored) -> dict[str, float]:
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


def one_more(kept: Stored) -> Inspection:
    """A further reading of the first blade, at AT_H: the reference's prediction plus noise."""
    y = float(kept.moments.mean[0, -1] + stream(0, "one more").normal() * kept.moments.sd[0, -1])
    return Inspection("more", kept.rotor.blades[0], "elongation", AT_H, np.array([y]))


def ours(kept: Stored) -> list[Row]:
    """Offline from nothing; then one more reading, provisional and sealed; online from nothing."""
    model, rotor, readings = kept.model, kept.rotor, list(kept.readings)
    update(model, rotor, readings)  # compiles the kernels
    misses, rows = [], []
    for seed in range(SEEDS):
        work, clock = Workspace(), Clock()
        state = update(model, replace(rotor, seed=seed), readings, workspace=work)
        found = Moments.of_state(model, rotor, state)
        c = Comparison.of(found, kept.moments)
        misses.append([c.mean[0, c.names.index(n)] for n in state.meta["shared"]])
        rows.append({"method": f"ours, offline, seed {seed}", **clock.read(), **error(found, kept)})
    ess = float((1 / np.mean(np.square(misses), axis=0)).min())
    rows[-1] |= {"ess": round(ess), "ess_per_cpu_s": round(ess / rows[-1]["cpu_s"], 2)}
    last = replace(rotor, seed=SEEDS - 1)
    more = [*readings, one_more(kept)]
    clock = Clock()
    quick = update(model, last, more, state, quick=True, workspace=work)
    rows.append({"method": "ours, one more reading, provisional", **clock.read()})
    clock = Clock()
    update(model, last, more, quick, workspace=work)
    rows.append({"method": "ours, one more reading, sealed after it", **clock.read()})
    online, work, each, clock = None, Workspace(), [], Clock()
    readings.sort(key=lambda reading: reading.time_h)
    for k in range(len(readings)):
        own = Clock()
        online = update(model, last, readings[: k + 1], online, quick=True, workspace=work)
        each.append(own.read()["cpu_s"])
    provisional = Moments.of_state(model, rotor, online)
    row = {"method": "ours, online, provisional", **clock.read(), **error(provisional, kept)}
    rows.append(row | {"cpu_s_per_reading": round(float(np.median(each)), 4)})
    online = update(model, last, readings, online, workspace=work)
    row = {"method": "ours, online, sealed", **clock.read()}
    rows.append(row | error(Moments.of_state(model, rotor, online), kept))
    assert online.digest == state.digest
    return rows


def schedule(kept: Stored) -> list[Row]:
    """The paper's Algorithm 1, offline and online."""
    model, rotor, rows = kept.model, kept.rotor, []
    for arm in ("offline", "online"):
        calibrate(model, replace(rotor, particles=200), kept.readings, Schedule(arm))  # compiles
        clock = Clock()
        got = calibrate(model, rotor, kept.readings, Schedule(arm))
        row = {"method": f"the paper's schedule, {arm}", **clock.read(), "sweeps": len(got.trace)}
        found = Moments.of(model, rotor, {b: got.blade(b) for b in rotor.blades})
        rows.append(row | error(found, kept))
    return rows


def drawn(kept: Stored, target: Target, shared: Any, local: Any) -> dict[str, float]:
    """Errors and ESS of draws on the unit boxes, shared (n, S) and local (n, B, L)."""
    x, y = target.natural(shared, 0), target.natural(local, shared.shape[1])
    names = (*target.local, *target.shared)
    found = {
        b: Posterior(names, Particles(np.concatenate([y[:, i], x], axis=1), np.zeros(len(x))))
        for i, b in enumerate(target.blades)
    }
    ess = least(shared)
    return {"draws": len(x), "ess": round(ess, 1)} | error(
        Moments.of(kept.model, kept.rotor, found), kept
    )


def least(shared: Any) -> float:
    """ESS of the shared parameter that has least, of one chain (n, S)."""
    return min(effective(shared[None, :, j]) for j in range(shared.shape[1]))


def rated(row: Row) -> Row:
    """A row with its ESS per second, and what ENOUGH would cost at that rate."""
    rate = row["ess"] / row["cpu_s"]
    more = max(ENOUGH - row["ess"], 0) / row["ess"] * (row["cpu_s"] - row.get("adaptation_s", 0.0))
    return row | {
        "ess_per_cpu_s": round(rate, 3),
        f"cpu_s_to_ess_{ENOUGH}": round(row["cpu_s"] + more, 1),
    }


def nuts(kept: Stored) -> list[Row]:
    """numpyro's NUTS on the unconstrained parameters, a dense mass matrix, 400 steps to adapt."""
    jax, numpyro = jax_and_numpyro()
    target = Target.of(kept.model, kept.rotor, kept.readings)

    def potential(q: Mapping[str, Any]) -> Any:
        total = target.log_joint(jax.numpy, *(jax.nn.sigmoid(q[k]) for k in ("shared", "local")))
        for part in q.values():
            total += jax.numpy.sum(jax.nn.log_sigmoid(part) + jax.nn.log_sigmoid(-part))
        return -total

    kernel = numpyro.infer.NUTS(potential_fn=potential, dense_mass=True)
    mcmc = numpyro.infer.MCMC(kernel, num_warmup=400, num_samples=50, progress_bar=False)
    b, each = len(target.blades), len(target.local)
    start = {"local": np.zeros((b, each)), "shared": np.zeros(len(target.shared))}
    clock = Clock()
    mcmc.warmup(jax.random.PRNGKey(1), init_params=start)
    adaptation = clock.read()["cpu_s"]
    parts: list[tuple[Any, Any]] = []
    while not parts or clock.read()["cpu_s"] < LIMIT_S:
        mcmc.run(mcmc.post_warmup_state.rng_key)
        mcmc.post_warmup_state = mcmc.last_state
        found = mcmc.get_samples()
        parts.append(tuple(1 / (1 + np.exp(-np.asarray(found[k]))) for k in ("shared", "local")))
        shared, local = (np.concatenate(p) for p in zip(*parts, strict=True))
        if least(shared) >= ENOUGH:
            break
    row = {"method": "numpyro NUTS", **clock.read(), "adaptation_s": adaptation}
    return [rated(row | drawn(kept, target, shared, local))]


def pymc(kept: Stored) -> list[Row]:
    """PyMC's NUTS on the same target, its defaults."""
    import pymc as pm
    import pytensor.tensor as pt

    target = Target.of(kept.model, kept.rotor, kept.readings)
    b, each = len(target.blades), len(target.local)
    clock = Clock()

    def stop(trace: Any, draw: Any) -> None:
        if clock.read()["cpu_s"] > LIMIT_S:
            raise KeyboardInterrupt

    with pm.Model():
        shared = pm.Uniform("shared", 0, 1, shape=len(target.shared))
        local = pm.Uniform("local", 0, 1, shape=(b, each))
        pm.Potential("readings", target.log_joint(pt, shared, local))
        kept_draws = pm.sample(
            draws=2000, tune=400, chains=1, cores=1, random_seed=1, progressbar=False,
            compute_convergence_checks=False, callback=stop, discard_tuned_samples=False,
        )  # fmt: skip
    if "posterior" not in kept_draws or kept_draws.posterior.sizes["draw"] < 20:
        return [{"method": "PyMC NUTS, stopped while it adapted", **clock.read()}]
    one, each_one = (kept_draws.posterior[name].values[0] for name in ("shared", "local"))
    row = {"method": "PyMC NUTS", **clock.read()}
    return [rated(row | drawn(kept, target, one, each_one))]


METHODS: dict[str, Callable[[Stored], list[Row]]] = {
    "ours": ours,
    "schedule": schedule,
    "nuts": nuts,
    "pymc": pymc,
}


def main(rotor: str, methods: Sequence[str], out: Path | None) -> None:
    """Run, print the table, write the JSON."""
    kept = Stored.load(FOLDER / f"{rotor}.json")
    rows: list[Row] = []
    for name in methods:
        try:
            found = METHODS[name](kept)
        except (ImportError, ModelError) as missing:
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
    main(words[0] if words else "thin-coating", words[1:] or list(METHODS), file)
