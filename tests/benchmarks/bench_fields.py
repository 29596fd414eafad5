"""One field of a blade on the whole mesh, by the plain and by the wide model: processor time.

    python tests/benchmarks/bench_fields.py [ROUNDS]

512 particles at draws of the priors, 50,000 h; what `GET …/field` computes without the service.
"""

from __future__ import annotations

import sys
import time
from statistics import median

import service.one_thread  # noqa: F401  before numpy

# isort: split
import numpy as np

from core.calibration.state import Posterior
from core.model import Model, rotor_blade, rotor_blade_wide
from core.rng import stream
from core.smc.particles import Particles
from service.fields import ENOUGH, field_of

QUANTITIES = ("deformation", "ceeq")


def drawn(model: Model) -> Posterior:
    """Particles at draws of the priors."""
    rng, names = stream(7, "bench-fields"), tuple(model.input_names)
    priors = [model.network.parameter(name).prior for name in names]
    values = np.stack([prior.quantile(rng.random(ENOUGH)) for prior in priors], axis=1)
    return Posterior(names, Particles(values, np.zeros(ENOUGH)))


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    for name, model in (("rotor-blade", rotor_blade()), ("rotor-blade-wide", rotor_blade_wide())):
        posterior = drawn(model)
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
