"""The scan's cells and pairs of cells as hypotheses, and the evidence of the names in them.

Each family has the same prior weight, spread evenly over its cells; a pair has the product of its
families' shares of `PAIRS`. A pair counts against its better single. The evidence of a name is that
of all hypotheses that contain it, whatever the shape or hour.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from core.diagnosis.scan import Scan
from core.smc.particles import log_sum_exp

CREDIBLE = 0.95  # of the set that is named where no single name has it
PAIRS = 0.1  # prior weight of all pairs against that of all singles
LEAST = 1e-6


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Cells that are there together; log_bf against none, weight its share of the evidence."""

    cells: tuple[int, ...]
    names: tuple[str, ...]
    log_bf: float
    weight: float


def weighed(scan: Scan, least: float = LEAST) -> list[Hypothesis]:
    """Single cells and pairs with their shares of the evidence, largest first.

    least  share below which they are left out
    """
    families, share = scan.families, {}
    for members in families.values():
        for i in members:
            share[i] = -np.log(len(families) * len(members))
    found: list[tuple[tuple[int, ...], float, float]] = [
        ((i,), float(scan.gains[i]), share[i]) for i in share
    ]
    common = [i for i in share if scan.cells[i].whom != "blade"]
    for k, i in enumerate(common):
        for j in common[k + 1 :]:
            if scan.cells[i].name == scan.cells[j].name:
                continue
            gain = scan.gain(i, j)
            if gain > max(scan.gains[i], scan.gains[j]):
                found.append(((i, j), gain, share[i] + share[j] + np.log(2 * PAIRS)))
    if not found:
        return []
    log_w = np.array([gain + prior for _, gain, prior in found])
    weight = np.exp(log_w - log_sum_exp(log_w))
    order = np.argsort(-weight, kind="stable")
    return [
        Hypothesis(
            found[k][0],
            tuple(scan.cells[i].name for i in found[k][0]),
            found[k][1],
            float(weight[k]),
        )
        for k in order
        if weight[k] > least
    ]


def evidence_of(hypotheses: Sequence[Hypothesis]) -> dict[str, float]:
    """Share of the evidence of all hypotheses with a name in them, largest first."""
    found: dict[str, float] = {}
    for one in hypotheses:
        for name in one.names:
            found[name] = found.get(name, 0.0) + one.weight
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


def best_of(hypotheses: Sequence[Hypothesis], named: tuple[str, ...]) -> Hypothesis:
    """The weightiest with just the names that are claimed, or of all."""
    for one in hypotheses:
        if named and set(one.names) == set(named):
            return one
    return hypotheses[0]


def credible(
    hypotheses: Sequence[Hypothesis], called: Callable[[str], str] = str
) -> tuple[str, ...]:
    """The names of the fewest hypotheses that together have `CREDIBLE` of the evidence.

    called  what a name is called; hypotheses with the same ones count as one
    """
    by_names: dict[tuple[str, ...], float] = {}
    for one in hypotheses:
        key = tuple(sorted({called(n) for n in one.names}))
        by_names[key] = by_names.get(key, 0.0) + one.weight
    names: list[str] = []
    total = 0.0
    for key, weight in sorted(by_names.items(), key=lambda item: -item[1]):
        names += [n for n in key if n not in names]
        total += weight
        if total >= CREDIBLE:
            break
    return tuple(names)
