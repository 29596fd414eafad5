"""Speed of the shipped surrogate.

python tests/benchmarks/bench_surrogate.py        (OMP_NUM_THREADS=1 for one thread)

Medians of several calls, in milliseconds of processor time; of one quantity at one node and
instant as a compiled polynomial (`core.surrogate.contest.row`) values per second of one processor,
and how far they are from the surrogate itself.
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
from core.surrogate.contest.row import Row

VALUES = 1_000_000


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
    many = np.random.default_rng(1).uniform(model.low, model.high, (VALUES, len(model.inputs)))
    last = float(model.horizon_h)
    for quantity, place in (("elongation", None), ("ceeq", node[0])):
        row = Row.of(model, quantity, last, place)
        row(many[:100])
        spent = milliseconds(lambda row=row: row(many), 15) / 1000.0  # type: ignore[misc]
        found[f"values per second, {quantity} at one node and instant"] = round(VALUES / spent)
        exact, _ = model.predict(x, quantity, [last], None if place is None else [place])
        off = np.abs(row(x) / exact.reshape(-1) - 1.0)
        found[f"of that {quantity}, % off, 95th percentile"] = round(
            100 * float(np.quantile(off, 0.95)), 4
        )
    return found


if __name__ == "__main__":
    print(json.dumps(main(*map(Path, sys.argv[1:])), indent=1))
