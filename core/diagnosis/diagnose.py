"""From a calibrated rotor to a verdict: scan, put what is suspected into the model, look again.

    1. The readings' scores under the posterior are scanned for every cell and pair (`scan`); the
       family-wise test says whether anything is missing at all.
    2. The weightiest hypotheses, `RIVALS` of them at most, and the best one's other courses in time
       go into the model as calibrated effects and the rotor is calibrated anew: their evidence is
       the particle filter's, not the scan's.
    3. With the best of them in the model the readings are scanned again. What is still missing
       joins, up to `MOST` turns; each effect has to earn `EARNED` nats beyond the price of the
       search, the log of the number of families and of cells in them that it was chosen from, less
       what others of the same cause gain in its place.
    4. An effect that was taken early can turn out to have imitated a later one: after each turn
       each has to earn its place beside all others, or it leaves.
    5. What was taken but could not be told from its rivals leaves again where chance explains the
       readings without it: a name that is not settled must not keep those that are from being said.
       So does one beside which the others' amplitudes do not hold (`leaving`).
    6. The amplitudes have to hold (`verdict`), to lie inside of their room and to be those of all
       blades that the effect is said of (`concerned`), and what is left has to be chance
       (`conclude`).
    7. Where a cause is claimed and its course in time is open, another course joins (`courses`).

Everything is a function of the readings that count, the facts of the blades and the seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from core.calibration.online import Workspace
from core.calibration.state import RotorState, shared_posterior
from core.diagnosis.adopt import amplitude
from core.diagnosis.alternatives import shares
from core.diagnosis.case import Case
from core.diagnosis.clock import of_no_day
from core.diagnosis.concerned import heard
from core.diagnosis.conclude import Rival, Turn, conclude
from core.diagnosis.courses import with_both
from core.diagnosis.densities import leaning, leans
from core.diagnosis.grammar import Cell
from core.diagnosis.held import ending, leaving_runs, while_read
from core.diagnosis.leaving import without_open, without_unsteady
from core.diagnosis.left_out import left_out
from core.diagnosis.misread import copied, set_apart, slips, understated
from core.diagnosis.placebos import Placebo, withstood
from core.diagnosis.scan import Scan
from core.diagnosis.search import MOST, Progress, Search, prices
from core.diagnosis.together import shared
from core.diagnosis.verdict import ONCE, Verdict, judge, of_once
from core.errors import InputError
from core.model import Model


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect that is in the model: its cell, and its amplitude as calibrated."""

    cell: Cell
    mean: float
    sd: float


@dataclass(frozen=True)
class Diagnosis:
    """What was found, and the models and states before and after.

    first     the scan's verdict on the model as it was
    effects   those that are in the model `after`
    gained    log evidence of the effects by the particle filter
    tried     every calibrated hypothesis: cells and log evidence against the model as it was
    refused   hypotheses that the runs have no room for, with the reason: the scan's word alone
    turns     what each turn weighed and took
    rivals    what else the readings allow in place of the effects, with shares (`alternatives`)
    scan      the first one, where nothing was found: what it would have found is asked (`noticed`)
    placebos  of the effects in the model, where one may be claimed: the same where they are not
    """

    verdict: Verdict
    first: Verdict
    before: tuple[Model, RotorState]
    after: tuple[Model, RotorState]
    effects: tuple[Effect, ...]
    gained: float
    tried: tuple[tuple[tuple[Cell, ...], float], ...]
    refused: tuple[tuple[tuple[str, ...], str], ...] = ()
    turns: tuple[Turn, ...] = ()
    rivals: tuple[tuple[Rival, float], ...] = ()
    scan: Scan | None = None
    placebos: tuple[Placebo, ...] = ()

    def effects_of(self, rival: Rival) -> tuple[Effect, ...]:
        """A rival's effects, with their amplitudes as it was calibrated."""
        return tuple(_effect(cell, self.before[0], rival.state) for cell in rival.effects)

    @property
    def foretold(self) -> bool:
        """Whether forecasts by the rivals are told: where names are claimed, or share the evidence.

        What is left unexplained otherwise may be anything, and no rival forecasts it.
        """
        return self.verdict.word in ("effect", "not separable") or bool(self.verdict.several)

    @property
    def open(self) -> Turn | None:
        """The first turn that took something which stayed, and does not settle on its name; where
        names earn their place together alone, that which weighed them."""
        if self.verdict.several and not self.effects:
            return self.turns[0]
        stayed = {e.cell.name for e in self.effects}
        turns = (t for t in self.turns if stayed.intersection(t.took))
        return next((t for t in turns if not t.settled), None)


def diagnose(
    model: Model,
    state: RotorState,
    case: Case,
    progress: Progress | None = None,
    workspace: Workspace | None = None,
) -> Diagnosis:
    """The verdict on a rotor with its sealed state.

    Raises InputError where there are no readings or the state is provisional.
    """
    if not state.sealed:
        raise InputError("state", "provisional", "cannot be diagnosed", "wait until it is sealed")
    quiet: Progress = lambda what, done, total: None  # noqa: E731
    work = workspace or Workspace()
    case = replace(case, workspace=work)
    search = Search(model, state, case, work, progress or quiet)
    search.say("scan")
    scan = case.scan(model, state)
    search.prices = prices(scan)
    once = case.once(model)
    first = found = (
        of_once(scan, once)
        if len(once) == len(case.read_h)
        else judge(scan, case.seed, dealt=case.dealt)
    )
    nothing = taken = Rival((), model, lambda: state, 0.0)
    if first.word == "adequate":
        first = _with_slips(first, case, nothing, model)
        same = (model, state)
        return Diagnosis(first, first, same, same, (), 0.0, (), scan=scan)
    turns: list[Turn] = []
    seen = [frozenset[Cell]()]
    while found.word != "adequate" and len(turns) < MOST:
        turns.append(search.turn(scan, taken))
        if not turns[-1].took:
            break
        taken = search.needed(turns[-1].rivals[turns[-1].took])
        scan, found = search.left(taken, len(turns))
        if frozenset(taken.effects) in seen:
            break  # what came has left again
        seen.append(frozenset(taken.effects))
    turns = [search.standing(turn, taken) for turn in turns]
    after, gone = found.p, list[str]()
    for leave in (without_open, without_unsteady):
        if (fewer := leave(search, taken, turns)) is not None:
            taken, after = fewer.rest, fewer.p
            gone.append(fewer.told)
            turns = [search.standing(turn, taken) for turn in turns]
    verdict = conclude(
        first,
        [c.name for c in taken.effects],
        after,
        turns,
        taken.gained,
        case.halves(model, state, taken),
        search.refused,
        gone,
        [end for c in taken.effects if (end := _end(c, model, case, taken)) is not None],
    )
    verdict = shared(verdict, turns, search.prices)
    verdict = heard(verdict, case.concerned(model, state, taken) if taken.effects else ())
    tried: tuple[Placebo, ...] = ()
    if verdict.word in ("effect", "not separable"):
        tried = case.placebos(model, state, taken, lambda cell: search.beside(taken, cell))
        verdict = withstood(verdict, tried)
    leading = _leading(taken, turns, verdict)
    rivals = shares(leading, [*search.known.values()], turns, search.prices)
    if verdict.word == "effect":
        no_room = lambda cell, rival: _end(cell, model, case, rival)  # noqa: E731
        if (both := with_both(search, taken, rivals, verdict.names, no_room)) is not None:
            taken, told = both
            verdict = replace(verdict, reasons=(*verdict.reasons, told))
        later = leaving_runs(taken.model, taken.state, case.present, case.spec.known)
        later += ending(taken.model, case.present)
        verdict = replace(verdict, reasons=(*verdict.reasons, *later))
    return Diagnosis(
        _with_slips(verdict, case, taken, model),
        first,
        (nothing.model, nothing.state),
        (taken.model, taken.state),
        tuple(_effect(c, model, taken.state) for c in taken.effects),
        taken.gained,
        tuple((r.effects, r.gained) for r in search.known.values()),
        tuple(search.refused.items()),
        tuple(turns),
        rivals,
        placebos=tried,
    )


def _leading(taken: Rival, turns: Sequence[Turn], verdict: Verdict) -> Rival:
    """What has rivals: what is in the model, or the weightiest of names that earn it together."""
    if taken.effects or not verdict.several:
        return taken
    single = [names for names in turns[0].rivals if len(names) == 1]
    return turns[0].rivals[single[-1]]


def _with_slips(verdict: Verdict, case: Case, taken: Rival, before: Model) -> Verdict:
    """With what leans on an end of its prior in its reasons, readings that may be misread, copied
    or of a sigma too small, campaigns of no single day, and blades that were left out."""
    own = [amplitude(cell, before.network)[0] for cell in taken.effects]
    told = (*leaning(taken.model, taken.state, own),)
    read = left_out(case.seen(taken.model, taken.state, whole=True))
    told += understated(read) + slips(read)
    told += set_apart(taken.state) + of_no_day(case.readings) + copied(case.readings)
    once, every = len(case.once(taken.model)), len(case.read_h)
    told += (ONCE.format(once, every),) if 0 < once < every else ()
    return replace(verdict, reasons=(*verdict.reasons, *told))


def _end(cell: Cell, before: Model, case: Case, taken: Rival) -> str | None:
    """That a cell's amplitude would go on if it could, or that it takes blades that are read to the
    end of the runs, in words; None where it has room."""
    name, origin = amplitude(cell, before.network)
    prior = taken.model.network.parameter(name).prior
    shared = shared_posterior(taken.state.meta, taken.state.arrays.__getitem__)
    side = leans(prior, shared.column(name), shared.particles.w)
    end = {"low": prior.low, "high": prior.high}.get(side or "", origin)
    if end == origin:
        return while_read(name, taken.model, taken.state, case.read_h, case.spec.known)
    why = "the runs end there" if cell.family.target == "input" else "none so large is expected"
    return f"the amplitude of {cell.name} leans on {end - origin:.3g}, no room: {why}"


def _effect(cell: Cell, before: Model, after: RotorState) -> Effect:
    shared = shared_posterior(after.meta, after.arrays.__getitem__)
    name, origin = amplitude(cell, before.network)
    a, w = shared.column(name) - origin, shared.particles.w
    mean = float(w @ a)
    return Effect(cell, mean, float(np.sqrt(w @ (a - mean) ** 2)))
