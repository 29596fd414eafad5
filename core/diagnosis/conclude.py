"""The word, once what is suspected has been in the model: every name stands on its own turn.

A turn weighs hypotheses: those that were calibrated by the particle filter's evidence, all others
by the scan's, among them what the simulation's runs have no room for. It may take the best of
those that were calibrated; but a name is claimed only where it has `NAMED` of that turn's
evidence, so that a lesser rival does not get the name of one that could not be calibrated. Where
families that differ in their course alone share it (a coating that wears, or comes off at once),
their cause is claimed (loss of coating), and the course is said to be open. A turn without either
leaves the smallest set that has `CREDIBLE` of the evidence, causes where courses are open: not
separable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from core.calibration.state import RotorState
from core.diagnosis.grammar import Cell
from core.diagnosis.hypotheses import LEAST, Hypothesis, credible, evidence_of
from core.diagnosis.verdict import CONFIRMED, DISAGREE, LEFT, MOST_NAMES, NAMED, Held, Verdict
from core.model import Model

SHOWN = 20


@dataclass(frozen=True)
class Rival:
    """Effects in the model, calibrated; gained [nat] against the model as it was.

    made  its state, drawn when it is first looked at: most rivals are weighed and no more
    """

    effects: tuple[Cell, ...]
    model: Model
    made: Callable[[], RotorState]
    gained: float

    @cached_property
    def state(self) -> RotorState:
        """With the particles of all blades."""
        return self.made()


@dataclass(frozen=True)
class Turn:
    """What was weighed, and what was taken of it: names, none where nothing earned its place.

    rivals  the calibrated ones, by the names that the turn would add
    cells   of the scan that found the hypotheses; before: effects that were in the model by then
    """

    hypotheses: tuple[Hypothesis, ...]
    took: tuple[str, ...]
    rivals: Mapping[tuple[str, ...], Rival]
    cells: tuple[Cell, ...] = ()
    before: tuple[Cell, ...] = ()

    @cached_property
    def evidence(self) -> dict[str, float]:
        """Share of the evidence of each name."""
        return evidence_of(self.hypotheses)

    @cached_property
    def causes(self) -> dict[str, str]:
        """The cause of each name; of one that is no cell's, itself."""
        return {cell.name: cell.cause for cell in self.cells}

    def claim(self, name: str) -> str | None:
        """What may be claimed of a name that was taken: itself, its cause, or nothing."""
        if self.evidence.get(name, 0.0) >= NAMED:
            return name
        causes = self.causes
        cause = causes.get(name, name)
        share = sum(
            h.weight for h in self.hypotheses if cause in {causes.get(n, n) for n in h.names}
        )
        return cause if share >= NAMED else None

    def called(self, name: str) -> str:
        """A name, or its cause, where no single name has the cause's evidence."""
        cause = self.causes.get(name, name)
        own = [self.evidence.get(n, 0.0) for n, c in self.causes.items() if c == cause]
        return name if max(own, default=0.0) >= NAMED * sum(own) else cause

    @property
    def in_doubt(self) -> tuple[str, ...]:
        """What the evidence leaves, and what was taken; causes where their courses are open."""
        return tuple(
            sorted({*credible(self.hypotheses, self.called), *map(self.called, self.took)})
        )

    @property
    def settled(self) -> bool:
        """Whether each of the names that were taken, or its cause, has the evidence."""
        return bool(self.took) and all(self.claim(n) is not None for n in self.took)


def apart(hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """The weightiest hypothesis of each set of names, with the weight of all of that set."""
    best: dict[tuple[str, ...], Hypothesis] = {}
    for one in hypotheses:
        key = tuple(sorted(one.names))
        if key in best:
            best[key] = replace(best[key], weight=best[key].weight + one.weight)
        else:
            best[key] = one
    return tuple(sorted(best.values(), key=lambda h: -h.weight))


def reweighed(
    hypotheses: Sequence[Hypothesis], gains: Mapping[tuple[int, ...], float]
) -> tuple[Hypothesis, ...]:
    """Hypotheses with the filter's evidence where it is known; of the others, the scan's.

    gains  by cells. The scan's scale is brought to the filter's at the weightiest that both know.

    >>> a, b = Hypothesis((0,), ("a",), 9.0, 0.5), Hypothesis((1,), ("b",), 9.0, 0.5)
    >>> [(h.names, round(h.weight, 2)) for h in reweighed((a, b), {(0,): 4.0, (1,): 7.0})]
    [(('b',), 0.95), (('a',), 0.05)]
    """
    known = [h for h in hypotheses if h.cells in gains]
    if not known:
        return tuple(hypotheses)
    top = max(known, key=lambda h: h.weight)
    shift = gains[top.cells] - top.log_bf
    news = [gains[h.cells] - h.log_bf - shift if h.cells in gains else 0.0 for h in hypotheses]
    log_w = np.array([np.log(h.weight) + n for h, n in zip(hypotheses, news, strict=True)])
    weight = np.exp(log_w - log_w.max())
    weight /= weight.sum()
    order = np.argsort(-weight, kind="stable")
    found = [hypotheses[i] for i in order if weight[i] > LEAST]
    shares = [float(weight[i]) for i in order if weight[i] > LEAST]
    return tuple(
        replace(h, weight=w, log_bf=gains.get(h.cells, h.log_bf))
        for h, w in zip(found, shares, strict=True)
    )


def conclude(
    first: Verdict,
    names: Sequence[str],
    after: float,
    turns: Sequence[Turn],
    gained: float,
    held: tuple[Held, ...],
    refused: Mapping[tuple[str, ...], str],
    gone: Sequence[str] = (),
    ends: Sequence[str] = (),
) -> Verdict:
    """The verdict on the effects `names` that are in the model, from all that was seen.

    after    p of what is left; held: whether amplitudes agree between halves
    refused  hypotheses that the runs have no room for, with the reason
    gone     effects that were taken and left again (`leaving`), in words
    ends     amplitudes that lean on the end of their room, in words
    """
    reasons = [*_against(names, after, held, refused), *ends]
    if reasons:
        return replace(
            first, word="unattributed", after=after, names=(), held=held, reasons=tuple(reasons)
        )
    took = [turn for turn in turns if any(n in names for n in turn.took)]
    claims = {n: turn.claim(n) for turn in took for n in turn.took if n in names}
    evidence: dict[str, float] = {}
    for turn in took:
        for name, share in turn.evidence.items():
            evidence[name] = max(share, evidence.get(name, 0.0))
    said = replace(
        first,
        word="effect",
        after=after,
        held=held,
        evidence=dict(sorted(evidence.items(), key=lambda item: (-item[1], item[0]))),
        hypotheses=took[-1].hypotheses[:SHOWN],
        best=took[-1].hypotheses[0],
    )
    sure = sorted({c for c in claims.values() if c is not None})
    if all(c is not None for c in claims.values()):
        verbs = ("gain", "leave") if len(sure) > 1 else ("gains", "leaves")
        whys = [f"{' and '.join(sure)} {verbs[0]} {gained:z.1f} nat and {verbs[1]} nothing behind"]
        whys += [
            f"how {claim} runs is open: {name} has {evidence.get(name, 0.0):.0%} of the evidence"
            for name, claim in claims.items()
            if claim not in (None, name)
        ]
        whys += gone
        whys += [_varies(h) for h in held if h.varies]
        return replace(said, names=tuple(sure), reasons=tuple(whys))
    doubt = [t for t in took if any(claims.get(n, n) is None for n in t.took)]
    rest = {n for turn in doubt for n in turn.in_doubt}
    several = tuple(sorted({*sure, *rest}))
    open_, beside = sorted(rest - set(sure) or rest), " and ".join(sure)
    why = f"the evidence{beside and ' beside ' + beside}"
    own = ([h.weight for h in t.hypotheses if open_[0] in map(t.called, h.names)] for t in doubt)
    if len(open_) == 1:
        why = f"{open_[0]} has {max(map(sum, own)):.0%} of {why}, where {NAMED:.0%} are asked for"
    else:
        why = f"{len(open_)} names share {why}"
    if len(several) > MOST_NAMES:
        return replace(said, word="unattributed", names=(), several=several, reasons=(why,))
    return replace(said, word="not separable", names=several, reasons=(why,), beside=tuple(sure))


def _against(
    names: Sequence[str],
    after: float,
    held: Sequence[Held],
    refused: Mapping[tuple[str, ...], str],
) -> list[str]:
    """Why nothing can be named, in words; empty where it can."""
    reasons = []
    if not names:
        reasons.append("no effect of the grammar earns its place in the model")
        reasons += [f"{' and '.join(n)} could not be calibrated: {w}" for n, w in refused.items()]
    elif after <= LEFT:
        reasons.append(f"what is left has a p of {after:.3g}: more is there than they explain")
    return reasons + [_apart(h) for h in held if not h.stands]


def _apart(held: Held) -> str:
    """That an effect does not hold in halves, in words."""
    if held.gained is not None and min(held.gained) < CONFIRMED:
        first, second = held.gained
        return (
            f"{held.effect} is not found {held.by} in each by itself: they gain {first:z.1f} and "
            f"{second:z.1f} nat, {CONFIRMED:g} are asked for"
        )
    return f"the amplitude of {held.effect} does not hold: it is {_sizes(held)}"


def _varies(held: Held) -> str:
    """That an effect is there everywhere, and not with one amplitude, in words."""
    assert held.gained is not None
    return (
        f"{held.effect} is found {held.by} in each by itself ({held.gained[0]:.0f} and "
        f"{held.gained[1]:.0f} nat), but not with one amplitude: it is {_sizes(held)}; a forecast "
        "with one amplitude for all is too sure"
    )


def _sizes(held: Held) -> str:
    first, second = held.amplitudes
    return (
        f"{first:.3g} and {second:.3g} times the expected one {held.by}, where {DISAGREE:g} sd of "
        f"the difference are {DISAGREE * held.sd:.3g}"
    )
