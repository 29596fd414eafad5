"""What a rotor costs by its number of blades, readings and particles, and the memory it takes.

    python tests/benchmarks/bench_scaling.py [REPEATS]

Each row is a rotor of its own in a new process: simulated readings (elongation of every blade at
each outage), then, after a warm-up that compiles, the time from the readings to a sealed posterior
(cold: nothing kept), of one reading more into a provisional one, and of the sealing that follows;
wall and processor time; the process's largest memory. The least of REPEATS is shown.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from dataclasses import replace

from core.calibration.online import Workspace, update
from core.calibration.state import RotorSpec
from core.model import rotor_blade
from core.validation.simulate import simulate
from core.validation.variants import VARIANTS

BASE = (100, 3, 10_000)
ROWS = (
    BASE,
    (10, 3, 10_000),
    (30, 3, 10_000),
    (300, 3, 10_000),
    (1000, 3, 10_000),
    (100, 1, 10_000),
    (100, 6, 10_000),
    (100, 12, 10_000),
    (100, 3, 1_000),
    (100, 3, 30_000),
    (100, 3, 100_000),
)


def one(blades: int, outages: int, particles: int, repeats: int) -> str:
    """The row of one rotor, best of `repeats`."""
    hours = tuple(24_000.0 * (k + 1) / outages for k in range(outages))
    variant = replace(VARIANTS["rotor-100"], blades=blades, outages_h=hours)
    model = rotor_blade()
    warm = simulate(model, replace(variant, blades=3), 1, 1).readings
    names = tuple(sorted({r.blade for r in warm}))
    first = update(model, RotorSpec("warm", names, 1000, 1), warm[:-1])
    update(model, RotorSpec("warm", names, 1000, 1), warm, first, quick=True)
    readings = simulate(model, variant, 0, 1).readings
    rotor = RotorSpec("r", tuple(sorted({r.blade for r in readings})), particles, 1)
    best: dict[str, tuple[float, float]] = {}
    for _ in range(repeats):
        work = Workspace()
        state = None
        for name, upto, quick in (
            ("cold", -1, False),
            ("quick", None, True),
            ("seal", None, False),
        ):
            start, cpu = time.perf_counter(), time.process_time()
            state = update(model, rotor, readings[:upto], state, quick=quick, workspace=work)
            took = time.perf_counter() - start, time.process_time() - cpu
            best[name] = min(best.get(name, took), took)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    cells = [f"{blades}", f"{outages}", f"{particles:,}"]
    cells += [f"{best[n][0]:.2f} / {best[n][1]:.2f}" for n in ("cold", "quick", "seal")]
    return "| " + " | ".join([*cells, f"{memory:.0f}"]) + " |"


def main(repeats: int) -> None:
    """One process for each row."""
    head = ("blades", "outages", "particles per blade", "cold, s wall / CPU", "one more reading, s")
    head += ("its sealing, s", "memory, MB")
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for row in ROWS:
        words = [sys.executable, __file__, str(repeats), *map(str, row)]
        print(subprocess.run(words, check=True, capture_output=True, text=True).stdout, end="")
        sys.stdout.flush()


if __name__ == "__main__":
    given = [int(word) for word in sys.argv[1:]]
    if len(given) == 4:
        print(one(given[1], given[2], given[3], given[0]))
    else:
        main(given[0] if given else 1)
