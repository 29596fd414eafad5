"""What the scan lets one say.

    adequate        the family-wise test finds nothing that chance would not
    effect          one name, or two together, has the evidence
    not separable   something is there, and several names would explain it: the smallest set that
                    has 95 % of the evidence
    unattributed    something is there, and no name explains it

Hypotheses are the single cells and the pairs of cells of different names (`hypotheses`). A pair
counts against its better single, so two effects are claimed only where each adds to the other.

This is the scan's word alone. A name that has the evidence still has to be calibrated, to hold
between halves of the blades and early and late, and to leave nothing behind (`conclude`); what is
left is scanned again with the misfits without a name (bins of hours) among what is looked for.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from core.diagnosis.grammar import Cell
from core.diagnosis.hypotheses import Hypothesis, best_of, credible, evidence_of, weighed
from core.diagnosis.scan import Scan

if TYPE_CHECKING:
    from core.diagnosis.concerned import Concerned

Word = Literal["adequate", "effect", "not separable", "unattributed"]
ALARM = 0.05  # family-wise
LEFT = 0.01  # of what is left once the effect is in
NAMED = 0.90  # evidence of a name
DISAGREE = 3.0  # sds between two halves' amplitudes
WIDE = 5.0  # prior sd of a half's amplitude, in sizes
CONFIRMED = 5.0  # nats by which an effect is found in a half by itself
MOST_NAMES = 5  # in a set that is still an answer
DEALT = 400
ONCE = (
    "{} of {} blades were read once: their own parameters make up for what one reading says, and "
    "they are left out of what is looked for"
)


@dataclass(frozen=True, slots=True)
class Held:
    """Whether an effect holds: its amplitude in each half, and the sd of the difference.

    amplitudes  in expected sizes; alone: whether each half was calibrated by itself (`parted`)
    gained      nats by which each half by itself has the effect beside all others; none where that
                was not asked, for amplitudes say enough
    """

    by: str
    amplitudes: tuple[float, float]
    sd: float
    effect: str = ""
    alone: bool = False
    gained: tuple[float, float] | None = None

    @property
    def agrees(self) -> bool:
        """Whether there can be one amplitude."""
        return abs(self.amplitudes[0] - self.amplitudes[1]) <= DISAGREE * self.sd

    @property
    def stands(self) -> bool:
        """Whether the effect may be claimed: one amplitude, or found in each half by itself.

        >>> Held("early and late", (90.0, 30.0), 17.0).stands
        False
        >>> Held("early and late", (90.0, 30.0), 17.0, gained=(270.0, 300.0)).stands
        True
        >>> Held("early and late", (1.0, 1.0), 0.3, gained=(10.0, -0.4)).stands
        False
        """
        if self.gained is None:
            return self.agrees
        return min(self.gained) >= CONFIRMED and self.amplitudes[0] * self.amplitudes[1] > 0

    @property
    def varies(self) -> bool:
        """Whether the effect is in both halves, and not with one amplitude."""
        return self.stands and not self.agrees

    def to_json(self) -> dict[str, Any]:
        """Plain JSON."""
        told = {name: getattr(self, name) for name in ("effect", "by", "sd", "agrees", "stands")}
        gained = None if self.gained is None else list(self.gained)
        return {**told, "amplitudes": list(self.amplitudes), "gained_nat": gained}


@dataclass(frozen=True)
class Verdict:
    """What is said, and what it rests on.

    p           family-wise probability of so large a gain by chance; after: of what is left
    names       those that are claimed, or the set that is not separable
    beside      of a set that is not separable, those that are sure: the rest is not told apart
    several     those that share the evidence where they are too many to be an answer: none is
                claimed, and what to read next can be told (`rivals`)
    hypotheses  all that have a noticeable share of the evidence, largest first
    tried       log mean Bayes factor of every family, and of misfits without a name
    reasons     in words
    concerns    whether all blades that effects are said of have them
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
    several: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    concerns: tuple[Concerned, ...] = ()


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
        why = f"a misfit without a name gains {top:z.1f} nat, and no family is left to look for"
        return Verdict("unattributed", p, None, (), None, (), {}, tried, (), (why,))
    evidence = evidence_of(hypotheses)
    named = tuple(sorted(n for n, w in evidence.items() if w >= NAMED))
    word: Word = "effect" if named else "not separable"
    names, why = named, f"no single name has {NAMED:.0%} of the evidence"
    if named:
        why = f"{' and '.join(named)} has {min(evidence[n] for n in named):.0%} of the evidence"
    elif len(names := credible(hypotheses)) > MOST_NAMES:
        word, names, why = "unattributed", (), f"{len(names)} names would explain it"
    best, shown = best_of(hypotheses, named), tuple(hypotheses[:20])
    return Verdict(word, p, None, names, best, shown, evidence, tried, (), (why,))


def of_once(scan: Scan, blades: Collection[str]) -> Verdict:
    """The verdict where no blade was read twice."""
    why = (
        f"none of {len(blades)} blades was read twice: its own parameters make up for what one "
        "reading says, so that nothing can contradict the model yet"
    )
    return Verdict("adequate", 1.0, None, (), None, (), {}, scan.found, (), (why,))


def describe(cell: Cell) -> str:
    """A cell in words."""
    when = f" at {cell.step_h:,.0f} h" if cell.step_h is not None else f", {cell.shape}"
    return f"{cell.name}{when}: {cell.family.sentence}"
