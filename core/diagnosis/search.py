"""What a diagnosis calibrates, and what it takes and gives up again (`diagnose`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from core.calibration.online import Workspace, begun
from core.calibration.start import Start
from core.calibration.state import RotorState
from core.diagnosis.adopt import with_effects
from core.diagnosis.case import Case
from core.diagnosis.choice import by_name
from core.diagnosis.conclude import Rival, Turn, apart, reweighed
from core.diagnosis.expected import joined, without
from core.diagnosis.grammar import Cell
from core.diagnosis.hypotheses import Hypothesis
from core.diagnosis.hypotheses import weighed as weighed_all
from core.diagnosis.scan import Scan
from core.diagnosis.verdict import LEFT, Verdict, judge
from core.errors import CalibrationError, InputError, ModelError
from core.model import Model
from core.rng import seed_of

Progress = Callable[[str, int, int], None]
RIVALS = 6
MOST = 3
EARNED = 2.0
SIBLINGS = 5
STEPS = 3 + MOST * (RIVALS + SIBLINGS + 2)  # at most; few more where effects leave again
FEW = 2  # effects whose posterior is looked for elsewhere, too, if it is not where it is expected
LOST = 0.05  # share of effective nodes below which a posterior counts as not found
NOTICEABLE = 0.01  # share of the evidence from which a rival is calibrated


@dataclass
class Search:
    """What was calibrated so far, and what could not be."""

    model: Model
    state: RotorState
    case: Case
    work: Workspace
    progress: Progress
    known: dict[frozenset[Cell], Rival] = field(default_factory=dict)
    refused: dict[tuple[str, ...], str] = field(default_factory=dict)
    prices: Mapping[Cell, float] = field(default_factory=dict)
    paid: dict[Cell, float] = field(default_factory=dict)
    done: int = 0

    def say(self, what: str) -> None:
        self.progress(what, min(self.done, STEPS), STEPS)
        self.done += 1

    def calibrated(
        self, effects: tuple[Cell, ...], start: Callable[[], Start] | None = None
    ) -> Rival | None:
        """The rotor with these effects in its model; none where the runs have no room.

        start  where its posterior is expected
        """
        names = tuple(c.name for c in effects)
        if not effects:
            return Rival((), self.model, lambda: self.state, 0.0)
        if (key := frozenset(effects)) not in self.known:
            self.say(" and ".join(names))
            noise = self.case.noise(self.model, self.state)
            try:
                case = self.case
                bigger = with_effects(self.model, effects, case.facts, noise, case.read_h)
                made = begun(
                    bigger,
                    self.case.spec,
                    self.case.readings,
                    workspace=self.work,
                    start=replace(start(), alone=len(effects) > FEW) if start else None,
                )
                gained = made.log_evidence - self.state.meta["log_evidence"]
                share = made.weighed.ess_ratio
                if share < LOST:
                    raise InputError(
                        "posterior",
                        f"{share:.1%} of its nodes carry it",
                        "is not found well enough to be compared",
                        "the scan's word stands",
                    )
            except (InputError, ModelError, CalibrationError) as error:
                # together they may leave the runs, in one blade alone, or be past computing
                self.refused[names] = str(error)
                return None
            self.known[key] = Rival(effects, bigger, made.sealed, gained)
        return self.known[key]

    def turn(self, scan: Scan, taken: Rival) -> Turn:
        """Calibrate the weightiest of what a scan finds, beside what is taken already.

        Of the best of them the other courses of the same causes too: the scan, of second order,
        tells causes from each other, and large effects' courses hardly. Scatter between blades
        discounts what they say of an alarm, but not here: the filter knows no discount, and an
        effect that few blades tell of would stand back behind one that is said of these alone.
        """
        weighed = weighed_all(scan.undiscounted, least=0.0)
        noise = self.case.noise(self.model, self.state)
        known: dict[tuple[int, ...], Rival] = {}

        def ask(cells: tuple[int, ...]) -> None:
            made = self.calibrated(
                (*taken.effects, *(scan.cells[i] for i in cells)),
                lambda: joined(taken.model, taken.state, scan, cells, self.model, noise),
            )
            if made is not None:
                known[cells] = made
            elif len(cells) > 1:  # what has no room together may have it alone
                for i in cells:
                    ask((i,))

        for one in [h for h in apart(weighed) if h.weight >= NOTICEABLE][:RIVALS]:
            ask(one.cells)
        if known:
            there = {h.cells: h.weight for h in weighed}
            courses = [c for c in siblings(scan, self._best(known, scan.cells)) if c in there]
            for cells_ in sorted(courses, key=lambda c: -there[c])[:SIBLINGS]:
                ask(cells_)
        names = {c: tuple(scan.cells[i].name for i in c) for c in known}
        rivals = {names[c]: known[c] for c in sorted(known, key=lambda c: known[c].gained)}
        found = reweighed(weighed, {c: r.gained for c, r in known.items()})
        took: tuple[str, ...] = ()
        if known:
            best = self._best(known, scan.cells)
            owed = self._owed(best, found, scan.cells)
            if known[best].gained >= taken.gained + sum(owed.values()):
                took = names[best]
                self.paid |= owed
        return Turn(found, took, rivals, tuple(scan.cells), taken.effects)

    def left(self, taken: Rival, turn: int) -> tuple[Scan, Verdict]:
        """What is still there with effects in the model."""
        self.say("scan")
        case = self.case
        noise = case.noise(self.model, self.state)
        scan = case.scan(taken.model, taken.state, taken.effects, noise)
        return scan, judge(scan, seed_of(case.seed, turn), alarm=LEFT, dealt=case.dealt)

    def _best(
        self, known: Mapping[tuple[int, ...], Rival], cells: Sequence[Cell]
    ) -> tuple[int, ...]:
        """By what was gained less the price of each effect: two have to be worth two."""
        left = {
            which: made.gained - sum(self.prices.get(cells[i], 0.0) for i in which)
            for which, made in known.items()
        }
        return by_name(left, cells)

    def _owed(
        self, which: tuple[int, ...], found: Sequence[Hypothesis], cells: Sequence[Cell]
    ) -> dict[Cell, float]:
        """What each of these has to gain: its price, less what others of its cause gain for it.

        Steps at neighbouring hours, or courses that differ little, say the same thing: together
        they have the evidence of which each has a part.
        """
        weights, owed = {h.cells: h.weight for h in found}, dict[Cell, float]()
        own = weights.get(which, 0.0)
        for i in which:
            rest = tuple(j for j in which if j != i)
            alike = sum(
                weights.get(tuple(sorted((*rest, j))), 0.0)
                for j, cell in enumerate(cells)
                if j not in rest and cell.cause == cells[i].cause
            )
            credit = math.log(max(alike / own, 1.0)) if own > 0 else 0.0
            owed[cells[i]] = self.prices.get(cells[i], 0.0) - credit
        return owed

    def only(self, taken: Rival, effects: tuple[Cell, ...]) -> Rival | None:
        """Calibrated with some of the effects that are taken."""
        gone = [c for c in taken.effects if c not in effects]
        return self.calibrated(effects, lambda: without(taken.model, taken.state, gone, self.model))

    def beside(self, taken: Rival, out: Cell) -> Rival | None:
        """Calibrated with all effects that are taken but one."""
        return self.only(taken, tuple(c for c in taken.effects if c != out))

    def needed(self, taken: Rival) -> Rival:
        """Without the effects that do not earn their place beside the others."""
        for out in taken.effects if len(taken.effects) > 1 else ():
            rest = self.beside(taken, out)
            if rest is not None and taken.gained < rest.gained + self.paid.get(out, 0.0):
                return self.needed(rest)
        return taken

    def standing(self, turn: Turn, taken: Rival) -> Turn:
        """A turn's word on what it took and stayed, where effects that it rested on have left.

        Its hypotheses are weighed anew by what was calibrated beside the effects that stayed, among
        them those that left; what was not calibrated without these keeps the turn's word.
        """
        stayed = {c.name for c in taken.effects}
        if set(turn.before) <= set(taken.effects) or not stayed.intersection(turn.took):
            return turn
        before = tuple(c for c in taken.effects if c.name not in turn.took)
        rest = frozenset(before)
        beside = {key - rest: made for key, made in self.known.items() if rest < key}
        more = {c for key in beside if len(key) == 1 for c in key if c not in turn.cells}
        cells = (*turn.cells, *sorted(more, key=lambda c: (c.name, c.shape, c.step_h or 0.0)))
        place = {cell: i for i, cell in enumerate(cells)}
        gains = {
            tuple(sorted(place[c] for c in key)): made.gained
            for key, made in beside.items()
            if all(c in place for c in key)
        }
        known = [h for h in turn.hypotheses if h.cells in gains]
        like = max(known, key=lambda h: h.weight, default=turn.hypotheses[0])
        new = [
            replace(like, cells=(i,), names=(cells[i].name,))
            for i in range(len(cells))
            if (i,) in gains and (i,) not in {h.cells for h in turn.hypotheses}
        ]
        rivals = {
            tuple(cells[i].name for i in at): beside[frozenset(cells[i] for i in at)]
            for at in sorted(gains, key=gains.__getitem__)
        }
        found = reweighed((*turn.hypotheses, *new), gains)
        return replace(turn, hypotheses=found, rivals=rivals, cells=cells, before=before)


def prices(scan: Scan) -> dict[Cell, float]:
    """What a cell has to gain: `EARNED`, and the log of what it was chosen from.

    Families share the prior evenly and cells their family's (`hypotheses.weighed`), so that with
    no effect the mean over all cells of exp(gain − price) is e^−`EARNED`: by Markov's inequality
    one is taken in no more than that share of clean rotors, were it for this alone.
    """
    families = scan.families
    return {
        scan.cells[i]: EARNED + math.log(len(families) * len(own))
        for own in families.values()
        for i in own
    }


def siblings(scan: Scan, which: tuple[int, ...]) -> list[tuple[int, ...]]:
    """The same cells but for one, which runs otherwise: other shapes and families of its cause."""
    found = []
    for place, i in enumerate(which):
        for j, cell in enumerate(scan.cells):
            if j != i and cell.cause == scan.cells[i].cause:
                found.append((*which[:place], j, *which[place + 1 :]))
    return [tuple(sorted(one)) for one in found]
