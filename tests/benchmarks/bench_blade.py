"""Cost and mesh error of the finite-element blade over the whole horizon.

python tests/benchmarks/bench_blade.py            (OMP_NUM_THREADS=1 for one thread)
python tests/benchmarks/bench_blade.py paper      with the mesh of 27,360 nodes, at the centre only

For each input and mesh: processor seconds of one run of 54 instants, evaluations of the creep
rate, elongation after 1000 and 50,000 h (mm), and its difference from the mesh "fine" (%). Then
the peak memory of the first run, default or paper, measured alone (MB).
"""

from __future__ import annotations

import json
import resource
import sys
from time import process_time

from core.blade import simulate
from core.blade.inputs import BOUNDS
from core.blade.integrate import Work

POINTS = {
    "centre": (1.0, 0.9, 0.0, 0.0),
    "hottest": (2 / 3, 1.0, 3.0, 3.0),
    "coolest": (4 / 3, 0.8, -3.0, -3.0),
    "hot, little creep": (2 / 3, 1.0, -3.0, -3.0),
    "cool, much creep": (4 / 3, 0.8, 3.0, 3.0),
}


def one(point: tuple[float, ...], mesh: str) -> dict[str, float]:
    """One run: cost and elongation."""
    work, start = Work(), process_time()
    run = simulate(dict(zip(BOUNDS, point, strict=True)), mesh, work=work)
    return {
        "seconds": round(process_time() - start, 1),
        "steps": work.steps,
        "evaluations": work.evaluations,
        "elongation_1000h": round(float(run.elongation[15]), 6),
        "elongation_50000h": round(float(run.elongation[-1]), 6),
    }


def main(meshes: tuple[str, ...], points: dict[str, tuple[float, ...]]) -> dict[str, object]:
    """Measure `meshes` against "fine" at `points`."""
    one(POINTS["centre"], "coarse")  # compile
    found: dict[str, object] = {}
    for place, point in points.items():
        rows = {mesh: one(point, mesh) for mesh in meshes}
        if "memory_mb" not in found:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            found["memory_mb"] = round(peak / 1024)
        rows["fine"] = one(point, "fine")
        for row in rows.values():
            for hours in ("1000h", "50000h"):
                name = f"elongation_{hours}"
                row[f"error_{hours}_%"] = round(100 * (row[name] / rows["fine"][name] - 1), 3)
        found[place] = rows
    return found


if __name__ == "__main__":
    paper = "paper" in sys.argv[1:]
    chosen = {"centre": POINTS["centre"]} if paper else POINTS
    print(json.dumps(main(("paper",) if paper else ("default", "coarse"), chosen), indent=1))
