"""Speed of the shipped surrogate.

python tests/benchmarks/bench_surrogate.py        (OMP_NUM_THREADS=1 for one thread)

Medians of several calls, in milliseconds of processor time.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np

from core.builtin.rotor_blade import MODEL
from core.surrogate import load


def milliseconds(call: Callable[[], object], repeats: int = 9) -> float:
    """Median processor time of a call."""
    spent = []
    for _ in range(repeats):
        start = process_time()
        call()
        spent.append(process_time() - start)
    return round(1000 * median(spent), 2)


def main(directory: Path = MODEL) -> dict[str, float]:
    """Measure the artefact in `directory`."""
    found = {"load": milliseconds(lambda: load(directory), 3)}
    model = load(directory)
    start = process_time()
    model.compiler()
    found["compile once"] = round(1000 * (process_time() - start), 2)
    x = np.random.default_rng(0).uniform(model.low, model.high, (10_000, len(model.inputs)))
    time, node = model.time_h, [model.named["critical"]]
    found["predict 10,000 x, 54 times, elongation"] = milliseconds(
        lambda: model.predict(x, "elongation", time)
    )
    found["predict 10,000 x, 1 time, ceeq at 1 node"] = milliseconds(
        lambda: model.predict(x, "ceeq", [8000.0], node)
    )
    found["predict 1 x, whole deformation at 54 times"] = milliseconds(
        lambda: model.predict(x[0], "deformation", time)
    )
    found["response, 54 rows of elongation"] = milliseconds(
        lambda: model.response("elongation", time)
    )
    found["response, 200 nodes of deformation"] = milliseconds(
        lambda: model.response("deformation", [8000.0], list(range(200)))
    )
    response = model.response("elongation", time)
    found["evaluate the response at 10,000 x"] = milliseconds(lambda: response.evaluate(x))
    return found


if __name__ == "__main__":
    print(json.dumps(main(*map(Path, sys.argv[1:])), indent=1))
