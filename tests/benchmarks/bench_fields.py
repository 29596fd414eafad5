"""One field of a blade on the whole mesh, by the plain and by the wide model: processor time.

    python tests/benchmarks/bench_fields.py [ROUNDS]

512 particles at draws of the priors, 50,000 h; what `GET …/field` computes without the service.
Then of a blade whose coating wears, an adopted effect, each particle followed and told by some.
"""

from __future__ import annotations

import sys
import time
from statistics import median

import service.one_thread  # noqa: F401  before numpy

# isort: split
import numpy as np

from core.calibration.state import Posterior
from core.diagnosis.adopt import with_effects
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.model import Model, rotor_blade, rotor_blade_wide
from core.rng import stream
from core.smc.particles import Particles
from core.surrogate import nearby
from service.fields import ENOUGH, field_of

QUANTITIES = ("deformation", "ceeq")


def drawn(model: Model) -> Posterior:
    """Particles at draws of the priors."""
    rng, names = stream(7, "bench-fields"), tuple(model.input_names)
    priors = [model.network.parameter(name).prior for name in names]
    values = np.stack([prior.quantile(rng.random(ENOUGH)) for prior in priors], axis=1)
    return Posterior(names, Particles(values, np.zeros(ENOUGH)))


def worn() -> tuple[Model, Posterior]:
    """The wide model with a coating that wears, and particles as of a blade that was read."""
    family = next(one for one in FAMILIES if one.name == "coating wear")
    cell, noise = Cell(family, "linear", "all"), {"elongation": 0.02}
    model = with_effects(rotor_blade_wide(), [cell], {}, noise, {"B1": 24_000.0})
    rng, names = stream(7, "bench-fields"), tuple(model.input_names)
    middle = {"t1t_rate": (0.9, 0.01), cell.name: (0.2, 0.03), "tbc_thickness": (1.1, 0.04)}
    columns = [
        rng.normal(*middle[name], ENOUGH)
        if name in middle
        else model.network.parameter(name).prior.quantile(0.2 + 0.6 * rng.random(ENOUGH))
        for name in names
    ]
    return model, Posterior(names, Particles(np.stack(columns, axis=1), np.zeros(ENOUGH)))


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    plain, wide, (model, own) = rotor_blade(), rotor_blade_wide(), worn()
    cases = [
        ("rotor-blade", plain, drawn(plain), nearby.SHARE),
        ("rotor-blade-wide", wide, drawn(wide), nearby.SHARE),
        ("worn, each", model, own, 0.0),
        ("worn, by some", model, own, nearby.SHARE),
    ]
    for name, model, posterior, share in cases:
        nearby.SHARE = share
        for quantity in QUANTITIES:
            taken = []
            for _ in range(rounds):
                start = time.process_time()
                field_of(model, posterior, quantity, 50_000.0, None)
                taken.append(time.process_time() - start)
            low, middle, high = min(taken), median(taken), max(taken)
            print(f"{name:17} {quantity:12} {middle:6.2f} s of a processor ({low:.2f}-{high:.2f})")


if __name__ == "__main__":
    main()
