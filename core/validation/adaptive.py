"""Do adaptive designs need fewer runs than one-shot ones, where it matters?

A seed is a rotor of twenty blades that are finite-element runs (`adaptive_truth.blade_rotor`), from
cool to hot; their elongations at three outages, with noise, are its readings. Three designs begin
with the same maximin hypercube of 16 runs:

one shot   maximin hypercubes of growing size, each a design of its own
adaptive   `core.surrogate.refine`, weighted by the rotor's posterior by its own surrogate
uniform    the same, all inputs weighing alike: the control, which knows no rotor

Every surrogate is trained by `core.surrogate.train` and measured on the same pool: further runs at
draws of the rotor's posterior, which comes from a reference surrogate of all one-shot runs. The
pool is drawn before any adaptive run and no design looks at it. The error is the root mean square
over pool and instants from 8,000 h of the elongation's relative error.

For every one-shot size N > 16, E is the smallest error of one-shot designs of up to N runs, and n
the number of runs after which the adaptive design's error stays below E (log-log between rounds):
both favour the one-shot design. n / N is the ratio at that size; a seed's ratio is their geometric
mean. Where E is not kept to, n is unknown, above what was run, and counts as that number times the
last step: a lower bound, which is said.

Seeds may share one-shot designs (seed s has set s mod `designs`): their adaptive curves are
independent, what they are held against is not.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive
from core.builtin.paper_network import rotor_blade_network
from core.design import Region, maximin_lhs
from core.network import Network
from core.observation import Inspection
from core.pools import process_pool
from core.posterior_region import from_readings, of_prior
from core.rng import seed_of, stream
from core.surrogate import Surrogate, train
from core.surrogate.accuracy import Goal
from core.surrogate.refine import Regions, refine
from core.surrogate.rounds import Plan, Round
from core.validation.adaptive_counts import Point, ratios
from core.validation.adaptive_truth import (
    HIGH,
    LOW,
    OUTAGES_H,
    TIME_H,
    Rotor,
    Truth,
    archive_of,
    blade_rotor,
    finite_elements,
    formula,
    formula_rotor,
    write,
)

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
FROM_H = 8_000.0
GOAL = Goal("elongation", 1e-5, (8_000.0, 16_000.0, 24_000.0, 37_000.0, 50_000.0))
"""Never met: the study looks at the whole curve."""


@dataclass(frozen=True, slots=True)
class Study:
    """The size of the study; `seed` draws everything.

    sizes    of one-shot designs, ascending; the first one is where the others begin
    most     runs of the adaptive designs
    designs  sets of one-shot designs
    noise    sd of a reading [mm]
    """

    seeds: int = 5
    sizes: tuple[int, ...] = (16, 26, 40, 54)
    most: int = 38
    batch: int = 4
    pool: int = 20
    designs: int = 2
    noise: float = 0.005
    particles: int = 2000
    seed: int = 7

    def one_shot(self, size: int, design: int) -> Array:
        """Inputs of a one-shot design (size, 4)."""
        key = seed_of(self.seed, "adaptive study", "one shot", design, size)
        return maximin_lhs(size, LOW, HIGH, key)

    def readings(self, number: int, elongation: Array) -> list[Inspection]:
        """A rotor's readings: elongation (blades, outages) [mm] with noise."""
        rng, found = stream(self.seed, "adaptive study", "noise", number), []
        for b, row in enumerate(elongation):
            for hours, true in zip(OUTAGES_H, row, strict=True):
                value = np.array([true + self.noise * rng.normal()])
                name = f"B{b + 1:02d}"
                made = Inspection(f"{name}-{hours:g}", name, "elongation", hours, value)
                found.append(made)
        return found

    def sets(self) -> Array:
        """Inputs of all one-shot designs, (n, 4)."""
        return np.vstack([self.one_shot(n, d) for d in range(self.designs) for n in self.sizes])


def network() -> Network:
    """The paper's network, of which elongation alone is read."""
    whole = rotor_blade_network()
    return replace(whole, quantities=(whole.quantity("elongation"),))


def learn(x: Array, truth: Truth, seed: int = 0) -> Surrogate:
    """The surrogate of the runs at x (n, 4)."""
    with tempfile.TemporaryDirectory(prefix="bladetwin-adaptive-") as folder:
        archive = archive_of(folder, seed)
        write(archive, 0, x, truth(x))
        return train(archive, seed=seed)


def measured(surrogate: Surrogate, x: Array, courses: Array, said: float | None = None) -> Point:
    """Relative errors of the elongation from `FROM_H` at x (m, 4), whose courses are (m, 2, T)."""
    late = TIME_H >= FROM_H
    true = courses[:, 0, late]
    mean, _ = surrogate.predict(x, "elongation", TIME_H[late])
    off = mean / true - 1.0
    n, p95 = len(surrogate.process.z), np.quantile(np.abs(off), 0.95)
    return Point(n, float(np.sqrt(np.mean(off**2))), float(p95), said)


def adaptive(
    study: Study, truth: Truth, regions: Regions, begin: Array, seed: int, pool: tuple[Array, Array]
) -> list[Point]:
    """The curve of a design that begins at `begin` and grows to `study.most` runs."""
    curve: list[Point] = []

    def seen(made: Round, surrogate: Surrogate) -> None:
        curve.append(measured(surrogate, *pool, said=made.accuracy[0].p95))

    def runs(
        archive: Archive, points: Mapping[int, Array], done: Callable[[int], None]
    ) -> dict[int, str]:
        x = np.array(list(points.values()))
        write(archive, min(points), x, truth(x))
        return {}

    with tempfile.TemporaryDirectory(prefix="bladetwin-adaptive-") as folder:
        archive = archive_of(folder, seed)
        write(archive, 0, begin, truth(begin))
        plan = Plan(batch=study.batch, most=study.most, seed=seed)
        refine(archive, runs, regions, [GOAL], plan, seen=seen)
    return curve


def even(study: Study, design: int) -> Regions:
    """The control's region: all inputs weigh alike, whatever the rotor."""

    def regions(surrogate: Surrogate) -> tuple[Region, str]:
        return of_prior(network(), [i.name for i in surrogate.inputs], design), "uniform"

    return regions


def reference(study: Study, truth: Truth) -> Surrogate:
    """The surrogate of all one-shot runs, by which the pools are placed."""
    return learn(study.sets(), truth, study.seed)


def pool_of(study: Study, number: int, truth: Truth, region: Region) -> tuple[Array, Array]:
    """Inputs (pool, 4) of draws of a region, and their courses."""
    rng = stream(study.seed, "adaptive study", "pool", number)
    x = region.x[rng.choice(len(region.x), study.pool, replace=False)]
    return x, truth(x)


def one_seed(
    study: Study, number: int, truth: Truth, rotor: Rotor, known: Surrogate
) -> dict[str, Any]:
    """All designs of a rotor, and the ratios."""
    design = number % study.designs
    readings = study.readings(number, rotor(number))
    blades = sorted({one.blade for one in readings})
    regions = from_readings(
        network(), blades, readings, particles=study.particles, seed=study.seed + number
    )
    region, words = regions(known)
    mean, sd = region.mean_and_sd()
    pool = pool_of(study, number, truth, region)
    begin = study.one_shot(study.sizes[0], design)
    shots = [measured(learn(study.one_shot(n, design), truth), *pool) for n in study.sizes]
    curve = adaptive(study, truth, regions, begin, number, pool)
    control = adaptive(study, truth, even(study, design), begin, design, pool)
    return {
        "rotor": number,
        "design": design,
        "region": {"of": words, "mean": mean.tolist(), "sd": sd.tolist()},
        "one_shot": [asdict(one) for one in shots],
        "adaptive": [asdict(one) for one in curve],
        "uniform": [asdict(one) for one in control],
        "ratios": ratios(curve, shots),
        "uniform_ratios": ratios(control, shots),
    }


def run(
    study: Study,
    folder: str | Path,
    *,
    processes: int = 1,
    progress: Progress = lambda what, done, total: None,
) -> list[dict[str, Any]]:
    """A row for each seed, by finite elements; their runs are kept in `folder`."""
    first = finite_elements(folder, processes, partial(progress, "one-shot designs"))
    first(study.sets())
    known = reference(study, first)
    tasks = [(study, k, str(folder), known) for k in range(study.seeds)]
    rows = []
    with process_pool(processes) as made:
        for one in [made.submit(_seed, *task) for task in tasks]:
            rows.append(one.result())
            progress("seeds", len(rows), study.seeds)
    return rows


def _seed(study: Study, number: int, folder: str, known: Surrogate) -> dict[str, Any]:
    return one_seed(study, number, finite_elements(folder), blade_rotor, known)


def run_formula(study: Study) -> list[dict[str, Any]]:
    """The same on the closed form: a row for each seed."""
    known = reference(study, formula)
    rotor = partial(formula_rotor, seed=study.seed)
    return [one_seed(study, k, formula, rotor, known) for k in range(study.seeds)]
