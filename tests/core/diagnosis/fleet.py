"""Simulated rotors whose scores are known exactly: linear, Gaussian, two local parameters."""

from __future__ import annotations

from typing import Any

import numpy as np

from core.calibration.target import assemble
from core.diagnosis.clock import readers
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell, Facts, cells
from core.diagnosis.scan import Scan
from core.diagnosis.scores import Scores
from core.diagnosis.signature import signatures, unnamed
from core.observation import Inspection
from tests.core.calibration.test_exact import SLOPES, conjugate

MODEL = conjugate(2)
TIMES, SIGMA, BLADES = (0.5, 1.0, 1.5), 0.15, 24
READING = tuple(
    f.__class__(**{**f.to_json(), "of": "y", "shapes": f.shapes, "whom": f.whom})
    for f in FAMILIES
    if f.target == "reading"
)


def rotor(seed: int, add: Any = None, noise: str = "normal") -> tuple[Scores, dict[str, Facts]]:
    """A rotor's scores; `add(blade, visit)` is put on its readings.

    noise   ``normal``, ``heavy`` (t with 3 degrees of freedom) or ``walk`` (beside the normal
            noise a random walk of twice the size: what the model lacks runs within each blade)
    """
    rng = np.random.default_rng(seed)
    s = rng.normal(2.0, 0.5)
    data, facts, parts = [], {}, []
    for b in range(BLADES):
        name = f"b{b:02d}"
        facts[name] = Facts(lot=f"L{b % 3}", offset_h=[0.0, 0.5][b % 2])
        local = np.array([-1.0, 0.0]) + 0.6 * rng.normal(size=2)
        design = np.array([[SLOPES[j] * t**j for j in range(2)] for t in TIMES])
        y = 0.8 * s + design @ local
        off = rng.normal(size=len(TIMES))
        if noise == "heavy":
            off = rng.standard_t(3, len(TIMES)) / np.sqrt(3)
        y = y + SIGMA * off
        if noise == "walk":
            y = y + 2 * SIGMA * np.cumsum(rng.normal(size=len(TIMES)))
        y = y + [0.0 if add is None else add(b, k) for k in range(len(TIMES))]
        data += [
            Inspection(f"{b}-{k}", name, "y", t, np.array([y[k]]), sigma=SIGMA, campaign=f"c{k}")
            for k, t in enumerate(TIMES)
        ]
        parts.append((design, y - 1.6 - design @ np.array([-1.0, 0.0])))
    q_b = np.array(
        [np.linalg.inv(0.36 * d @ d.T + SIGMA**2 * np.eye(len(TIMES))) for d, _ in parts]
    )
    miss = np.array([m for _, m in parts])
    slope = np.full((BLADES, len(TIMES), 1), 0.8)
    weighted = np.einsum("bij,bjs->bis", q_b, slope)[:, :, 0]
    shift = np.sum(weighted * miss) / (4.0 + np.sum(weighted * 0.8))
    q = np.einsum("bij,bj->bi", q_b, miss - 0.8 * shift)
    by_blade = [[r for r in data if r.blade == n] for n in facts]
    rows = tuple(r for own in by_blade if (r := assemble(MODEL, own)) is not None)
    seen = Scores(
        tuple(facts),
        rows,
        np.tile(np.arange(len(TIMES)), (BLADES, 1)),
        q,
        q_b,
        slope,
        np.array([0.25]),
        np.array([r.y[: len(TIMES)] for r in rows]) - SIGMA**2 * q,
        SIGMA**2 * q_b - np.eye(len(TIMES)),
        tuple({} for _ in facts),
        np.zeros((BLADES, 1, len(TIMES))),
    )
    return seen, facts


def scan(seen: Scores, facts: dict[str, Facts]) -> Scan:
    """Every cell of readings against it."""
    data = [r for rows in seen.rows for r in rows.readings]
    every: list[Cell] = cells(READING, ("s", "l0", "l1"), ["y"], facts, readers(data, facts))
    g = signatures(MODEL, seen, every, facts, {"y": SIGMA})
    return Scan.of(every, seen, g, unnamed(seen, facts))
