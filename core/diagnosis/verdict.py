"""What the scan lets one say.

    adequate        the family-wise test finds nothing that chance would not
    effect          one name, or two together, has the evidence, holds on other blades and at
                    other times, and leaves nothing behind
    not separable   something is there, and several names would explain it: the smallest set that
                    has 95 % of the evidence
    unattributed    something is there, and no name explains it

Hypotheses are the single cells and the pairs of cells of different names (`hypotheses`). A pair
counts against its better single, so two effects are claimed only where each adds to the other.

A name that has the evidence still has to hold: its amplitude has to agree between two halves of
the blades, and between early and late readings. What is left is scanned again. Where a misfit
without a name (bins of hours) explains much more than the best name, the verdict is unattributed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.grammar import Cell
from core.diagnosis.hypotheses import Hypothesis, best_of, credible, evidence_of, weighed
from core.diagnosis.scan import Scan

Array = NDArray[np.float64]
Word = Literal["adequate", "effect", "not separable", "unattributed"]
ALARM = 0.05  # family-wise
LEFT = 0.01  # of what is left once the effect is in
NAMED = 0.90  # evidence of a name
FREE = 3.0  # nats by which a misfit without a name must beat the best name
DISAGREE = 3.0  # sds between two halves' amplitudes
WIDE = 5.0  # prior sd of a half's amplitude, in sizes
MOST_NAMES = 5  # in a set that is still an answer
DEALT = 400


@dataclass(frozen=True, slots=True)
class Held:
    """Whether an amplitude holds: its size in each half, and the sd of the difference."""

    by: str
    amplitudes: tuple[float, float]
    sd: float

    @property
    def agrees(self) -> bool:
        return abs(self.amplitudes[0] - self.amplitudes[1]) <= DISAGREE * self.sd


@dataclass(frozen=True)
class Verdict:
    """What is said, and what it rests on.

    p           family-wise probability of so large a gain by chance; after: of what is left
    names       those that are claimed, or the set that is not separable
    hypotheses  all that have a noticeable share of the evidence, largest first
    tried       log mean Bayes factor of every family, and of misfits without a name
    reasons     in words
    """

    word: Word
    p: float
    after: float | None
    names: tuple[str, ...]
    best: Hypothesis | None
    hypotheses: tuple[Hypothesis, ...]
    evidence: dict[str, float]
    tried: dict[str, float]
    held: tuple[Held, ...]
    reasons: tuple[str, ...]


def judge(scan: Scan, seed: int, alarm: float = ALARM, dealt: int = DEALT) -> Verdict:
    """The verdict on a scan; a function of the readings and the seed."""
    tried = scan.found
    if not tried:
        return Verdict(
            "adequate", 1.0, None, (), None, (), {}, {}, (), ("nothing is left to look for",)
        )
    top, p = max(tried.values()), scan.chance(dealt, seed)
    if p > alarm:
        why = f"so large a gain comes by chance in {p:.0%} of {dealt} dealt sets"
        return Verdict("adequate", p, None, (), None, (), {}, tried, (), (why,))
    hypotheses = weighed(scan)
    if not hypotheses:
        why = f"a misfit without a name gains {top:.1f} nat, and no family is left to look for"
        return Verdict("unattributed", p, None, (), None, (), {}, tried, (), (why,))
    evidence = evidence_of(hypotheses)
    named = tuple(sorted(n for n, w in evidence.items() if w >= NAMED))
    best = best_of(hypotheses, named)
    rest = scan.including(*best.cells)
    after = rest.chance(dealt, seed)
    held = tuple(one for c in best.cells for one in holds(scan, best.cells, c))
    reasons = []
    free = max((tried[n] for n in scan.free), default=-np.inf)
    if free > best.log_bf + FREE:
        reasons.append(
            f"a misfit without a name gains {free:.1f} nat, {' with '.join(best.names)} "
            f"{best.log_bf:.1f}"
        )
    if after <= LEFT:
        reasons.append(f"what is left has a p of {after:.3g}: more is there than it explains")
    reasons += [
        f"its amplitude is {h.amplitudes[0]:.2g} and {h.amplitudes[1]:.2g} times the expected one "
        f"{h.by}: {DISAGREE:g} sd of the difference are {DISAGREE * h.sd:.2g}"
        for h in held
        if not h.agrees
    ]
    word: Word = "effect" if named else "not separable"
    names = named
    if not named:
        names = credible(hypotheses)
        if len(names) > MOST_NAMES:
            reasons.append(f"{len(names)} names would explain it")
    if reasons:
        word, names = "unattributed", ()
    elif named:
        least = min(evidence[n] for n in named)
        reasons = [f"{' and '.join(named)} has {least:.0%} of the evidence"]
    else:
        reasons = [f"no single name has {NAMED:.0%} of the evidence"]
    return Verdict(
        word,
        p,
        after,
        names,
        best,
        tuple(hypotheses[:20]),
        evidence,
        tried,
        held,
        tuple(reasons),
    )


def holds(scan: Scan, together: tuple[int, ...], cell: int) -> list[Held]:
    """The amplitude of a cell between halves of what it concerns, the others of its set as found.

    Blades are halved by their order of names, readings by their median hour.
    """
    others = tuple(i for i in together if i != cell)
    if others:
        scan = scan.including(*others)
    g, seen = scan.g[:, :, cell], scan.seen
    concerned = (g != 0) & seen.real
    blades = np.flatnonzero(concerned.any(axis=1))
    hours = seen.hours
    odd = np.isin(np.arange(len(g)), blades[1::2])[:, None]
    late = hours > np.median(hours[concerned])
    parts = (("in two halves of the blades", odd), ("early and late", late))
    return [
        _held(
            scan,
            cell,
            by,
            np.stack([np.broadcast_to(~half, g.shape), np.broadcast_to(half, g.shape)], axis=2),
        )
        for by, half in parts
        if np.any(concerned & half) and np.any(concerned & ~half)
    ]


def _held(scan: Scan, cell: int, by: str, parts: NDArray[np.bool_]) -> Held:
    """The amplitudes of a cell in two halves of the rows (B, n, 2), each free."""
    phi = float(scan.phi[cell])
    halves = scan.g[:, :, cell, None] * parts
    pull = (scan.h[:, :, cell, None] * parts).sum(axis=(0, 1))
    u = (np.einsum("bik,bi->k", halves, scan.seen.q) + pull) / phi
    information = scan.seen.cross(halves) / phi + np.eye(2) / WIDE**2
    covariance = np.linalg.inv(information)
    mean, off = covariance @ u, np.array([1.0, -1.0])
    return Held(by, (float(mean[0]), float(mean[1])), float(np.sqrt(off @ covariance @ off)))


def describe(cell: Cell) -> str:
    """A cell in words."""
    when = f" at {cell.step_h:,.0f} h" if cell.step_h is not None else f", {cell.shape}"
    return f"{cell.name}{when}: {cell.family.sentence}"
