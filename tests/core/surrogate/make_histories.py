"""Makes histories.json: finite-element runs whose inputs change in time, to hold the rule against.

    python tests/core/surrogate/make_histories.py

Twelve histories on the default mesh, two of each kind, inside the box that the shipped surrogate
was trained on; about a minute each on one processor. Values at the nodes "tip" and "critical".
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from core.blade import build_mesh, simulate_history
from core.rng import stream

FILE = Path(__file__).with_name("histories.json")
TIMES = np.array([0.0, 2e3, 8e3, 16e3, 24e3, 32e3, 40e3, 50e3])
KINDS = ("worn", "fouling", "step up", "step down", "both", "late ramp")


def course(kind: str, x: dict[str, float], hour: float) -> dict[str, list[tuple[float, float]]]:
    """The inputs of this kind that change."""
    coating, gas, end = x["tbc_thickness"], x["t1t_rate"], float(TIMES[-1])
    worn = {"tbc_thickness": [(0.0, coating), (end, max(0.67, 0.55 * coating))]}
    fouled = {"t1t_rate": [(0.0, gas), (end, gas + 0.042)]}
    step = 0.03 if kind == "step up" else -0.03
    return {
        "worn": worn,
        "fouling": fouled,
        "both": worn | fouled,
        "late ramp": {"tbc_thickness": [(hour, coating), (hour + 2e4, 0.7)]},
    }.get(kind) or {"t1t_rate": [(0.0, gas), (hour, gas), (hour, gas + step)]}


def main(file: Path = FILE) -> None:
    rng, grid, runs = stream(1, "histories"), build_mesh("default"), []
    nodes = [grid.named["tip"], grid.named["critical"]]
    box = {"tbc_thickness": (0.9, 1.3), "t1t_rate": (0.84, 0.95)}
    box |= {"creep_transient": (-2.0, 2.0), "creep_steady": (-2.0, 2.0)}
    for i in range(12):
        kind = KINDS[i % 6]
        x = {name: float(rng.uniform(*ends)) for name, ends in box.items()}
        inputs = x | course(kind, x, float(rng.uniform(6e3, 2e4)))
        run = simulate_history(inputs, "default", time_h=TIMES)
        fields = {
            "ceeq": run.ceeq,
            "creep_damage": run.creep_damage,
            "deformation": run.deformation,
        }
        kept = {name: values[:, nodes].tolist() for name, values in fields.items()}
        own = {"elongation": run.elongation.tolist(), **kept}
        runs.append({"kind": kind, "inputs": inputs, **own})
        print(f"{i + 1} of 12: {kind}, {run.elongation[-1]:.4f} mm", flush=True)
        file.write_text(json.dumps({"time_h": TIMES.tolist(), "nodes": nodes, "runs": runs}) + "\n")


if __name__ == "__main__":
    main()
