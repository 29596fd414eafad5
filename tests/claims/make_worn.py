"""Makes results/erosion/truth.json: blades in finite elements, coatings that wear and that do not.

    python tests/claims/make_worn.py

Eight blades of one rotor on the default mesh; the coating loses 28 % of its thickness by 50,000 h,
linearly. About 75 seconds a blade on one processor.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from core.blade import simulate, simulate_history
from core.rng import stream

FILE = Path(__file__).with_name("results") / "erosion" / "truth.json"
TIMES = np.array([0.0, 4e3, 8e3, 12e3, 16e3, 20e3, 24e3, 32e3, 40e3, 50e3])
BLADES, T1T, LOST = 8, 0.93, 0.28


def main(file: Path = FILE) -> None:
    rng, blades = stream(3, "worn"), []
    for number in range(BLADES):
        inputs = {"tbc_thickness": float(rng.uniform(1.03, 1.30)), "t1t_rate": T1T}
        for name in ("creep_transient", "creep_steady"):
            inputs[name] = float(np.clip(rng.normal(), -2.5, 2.5))
        coating = inputs["tbc_thickness"]
        course = [(0.0, coating), (5e4, (1.0 - LOST) * coating)]
        clean = simulate(inputs, "default", time_h=TIMES)
        worn = simulate_history({**inputs, "tbc_thickness": course}, "default", time_h=TIMES)
        curves = {"clean": clean.elongation.tolist(), "worn": worn.elongation.tolist()}
        blades.append({"inputs": inputs, **curves})
        print(f"{number + 1} of {BLADES}", flush=True)
    head = {"time_h": TIMES.tolist(), "lost_by_50000_h": LOST, "blades": blades}
    file.write_text(json.dumps(head) + "\n")


if __name__ == "__main__":
    main()
