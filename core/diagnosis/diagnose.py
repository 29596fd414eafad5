"""From a calibrated rotor to a verdict: scan, put what is suspected into the model, look again.

    1. The readings' scores under the posterior are scanned for every cell and pair (`scan`); the
       family-wise test says whether anything is missing at all.
    2. The weightiest hypotheses, `RIVALS` of them at most, go into the model as calibrated effects
       and the rotor is calibrated anew: their evidence is the particle filter's, not the scan's.
    3. With the best of them in the model the readings are scanned again. What is still missing
       joins, up to `MOST` effects; each has to earn `EARNED` nats.
    4. The amplitudes have to hold (`verdict`), and what is left has to be chance.

Everything is a function of the readings that count, the facts of the blades and the seed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import Workspace, update
from core.calibration.state import RotorSpec, RotorState, shared_posterior
from core.diagnosis.adopt import parameter_name, typical_noise, with_effects
from core.diagnosis.clock import readers
from core.diagnosis.grammar import FAMILIES, Cell, Facts, Family, cells
from core.diagnosis.scan import Scan
from core.diagnosis.scores import scores
from core.diagnosis.signature import Physics, signatures, unnamed
from core.diagnosis.verdict import (
    CREDIBLE,
    DEALT,
    LEFT,
    MOST_NAMES,
    NAMED,
    Held,
    Hypothesis,
    Verdict,
    Word,
    evidence_of,
    holds,
    judge,
)
from core.errors import InputError
from core.model import Model, Stacked
from core.observation import Inspection
from core.surrogate.driven import Driven

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
RIVALS = 3
MOST = 3
EARNED = 2.0
NOTICEABLE = 0.03  # share of the evidence from which a rival is calibrated


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect that is claimed: its cell, and its amplitude as calibrated."""

    cell: Cell
    mean: float
    sd: float


@dataclass(frozen=True)
class Diagnosis:
    """What was found, and the models and states before and after.

    first     the scan's verdict on the model as it was
    effects   those that are in the model `after`
    gained    log evidence of the effects by the particle filter
    tried     every calibrated hypothesis: names and log evidence against the model as it was
    refused   hypotheses that the runs have no room for, with the reason: the scan's word alone
    """

    verdict: Verdict
    first: Verdict
    before: tuple[Model, RotorState]
    after: tuple[Model, RotorState]
    effects: tuple[Effect, ...]
    gained: float
    tried: tuple[tuple[tuple[str, ...], float], ...]
    refused: tuple[tuple[tuple[str, ...], str], ...] = ()


@dataclass(frozen=True)
class Case:
    """A rotor to be diagnosed.

    physics   a surrogate with more inputs, where the model's own has too few (signatures only)
    """

    spec: RotorSpec
    readings: tuple[Inspection, ...]
    facts: Mapping[str, Facts]
    families: Sequence[Family] = FAMILIES
    physics: Physics | None = None
    dealt: int = DEALT

    def noise(self, model: Model, state: RotorState) -> dict[str, float]:
        """Of a reading, by quantity, as the state has it."""
        shared = shared_posterior(state.meta, state.arrays.__getitem__)
        means = dict(zip(shared.names, shared.particles.mean.tolist(), strict=True))
        return typical_noise(model, means)

    def scan(self, model: Model, state: RotorState, taken: Sequence[Cell] = ()) -> Scan:
        """Of a state; effects that are in the model already are left out."""
        seen = scores(model, state, self.readings, self.spec.known)
        answers = self.physics.answers if self.physics else model.surrogate
        if isinstance(answers, Stacked):
            raise InputError("model", model.network.name, "is stacked", "diagnose its parts")
        base = answers.base if isinstance(answers, Driven) else answers
        facts = {b: self.facts.get(b, Facts()) for b in self.spec.blades}
        rest = dict(self.physics.rest) if self.physics else {}
        if isinstance(answers, Driven):
            rest |= answers.fixed
        every = cells(
            self.families,
            [i.name for i in base.inputs],
            [q.name for q in model.network.quantities],
            {b: facts[b] for b in seen.blades},
            readers(self.readings, facts),
        )
        gone = {one.name for one in taken}
        every = [c for c in every if c.name not in gone]
        physics = Physics(answers, rest)
        noise = self.noise(model, state)
        g = signatures(model, seen, every, facts, noise, physics)
        return Scan.of(every, seen, g, unnamed(seen, facts))


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
    work = workspace or Workspace()
    say = progress or (lambda what, done, total: None)
    steps, done = 1 + MOST * (RIVALS + 1), 0
    say("scan", done, steps)
    scan = case.scan(model, state)
    first = judge(scan, case.spec.seed, dealt=case.dealt)
    if first.word == "adequate":
        return Diagnosis(first, first, (model, state), (model, state), (), 0.0, ())
    noise = case.noise(model, state)
    base = state.meta["log_evidence"]
    taken: tuple[Cell, ...] = ()
    now: tuple[Model, RotorState] = (model, state)
    found, tried = first, list[tuple[tuple[str, ...], float]]()
    refused: dict[tuple[str, ...], str] = {}
    after = first.p
    rivals: tuple[Hypothesis, ...] = ()
    for turn in range(MOST):
        candidates = [h for h in _apart(found) if h.weight >= NOTICEABLE][:RIVALS]
        known: list[tuple[float, Hypothesis, Model, RotorState, tuple[Cell, ...]]] = []
        weights = {h.names: h.weight for h in _apart(found)}
        for one in candidates:
            done += 1
            say(" and ".join(one.names), done, steps)
            more = (*taken, *(scan.cells[i] for i in one.cells))
            try:
                bigger = with_effects(model, more, case.facts, noise)
            except InputError as error:
                refused[tuple(c.name for c in more)] = str(error)
                continue
            made = update(bigger, case.spec, case.readings, workspace=work)
            gain = made.meta["log_evidence"] - base
            tried.append((tuple(c.name for c in more), gain))
            known.append((gain, one, bigger, made, more))
        if not known:
            break
        rivals = _reweighed(found, {one.names: gain for gain, one, *_ in known}, weights)
        gain, one, bigger, made, more = max(known, key=lambda k: k[0])
        before = now[1].meta["log_evidence"] - base
        if gain < before + EARNED * len(one.cells):
            break
        taken, now = more, (bigger, made)
        done += 1
        say("scan", done, steps)
        scan = case.scan(*now, taken=taken)
        found = judge(scan, case.spec.seed + turn + 1, alarm=LEFT, dealt=case.dealt)
        after = found.p
        if found.word == "adequate":
            break
    gained = now[1].meta["log_evidence"] - base
    effects = tuple(_effect(c, *now) for c in taken)
    verdict = _final(first, effects, after, rivals, gained, _held(case, model, state, taken))
    return Diagnosis(
        verdict,
        first,
        (model, state),
        now,
        effects,
        gained,
        tuple(tried),
        tuple(refused.items()),
    )


def _apart(found: Verdict) -> list[Hypothesis]:
    """The weightiest hypothesis of each set of names, with the weight of all of that set."""
    best: dict[tuple[str, ...], Hypothesis] = {}
    for one in found.hypotheses:
        key = tuple(sorted(one.names))
        if key in best:
            best[key] = replace(best[key], weight=best[key].weight + one.weight)
        else:
            best[key] = one
    return sorted(best.values(), key=lambda h: -h.weight)


def _reweighed(
    found: Verdict,
    gains: Mapping[tuple[str, ...], float],
    weights: Mapping[tuple[str, ...], float],
) -> tuple[Hypothesis, ...]:
    """Hypotheses with the filter's evidence where it is known; of the others, the scan's.

    The scan's scale is brought to the filter's at the best that both know.
    """
    every = _apart(found)
    known = [h for h in every if h.names in gains]
    top = max(known, key=lambda h: h.weight)
    shift = gains[top.names] - top.log_bf
    log_w = np.array(
        [
            np.log(h.weight) + ((gains[h.names] - h.log_bf - shift) if h.names in gains else 0.0)
            for h in every
        ]
    )
    weight = np.exp(log_w - log_w.max())
    weight /= weight.sum()
    order = np.argsort(-weight, kind="stable")
    return tuple(
        replace(
            every[i], weight=float(weight[i]), log_bf=gains.get(every[i].names, every[i].log_bf)
        )
        for i in order
    )


def _effect(cell: Cell, model: Model, state: RotorState) -> Effect:
    shared = shared_posterior(state.meta, state.arrays.__getitem__)
    a, w = shared.column(parameter_name(cell)), shared.particles.w
    mean = float(w @ a)
    return Effect(cell, mean, float(np.sqrt(w @ (a - mean) ** 2)))


def _held(case: Case, model: Model, state: RotorState, taken: Sequence[Cell]) -> tuple[Held, ...]:
    """Between halves, by the scan of the model as it was, each with the others in it."""
    scan = case.scan(model, state)
    places = tuple(scan.cells.index(c) for c in taken if c in scan.cells)
    return tuple(one for c in places for one in holds(scan, places, c))


def _final(
    first: Verdict,
    effects: tuple[Effect, ...],
    after: float,
    rivals: tuple[Hypothesis, ...],
    gained: float,
    held: tuple[Held, ...],
) -> Verdict:
    """The word, from all that was seen."""
    reasons: list[str] = []
    if not effects:
        reasons.append("no effect of the grammar earns its place in the model")
    if effects and after <= LEFT:
        reasons.append(f"what is left has a p of {after:.3g}: more is there than they explain")
    reasons += [
        f"its amplitude is {h.amplitudes[0]:.2g} and {h.amplitudes[1]:.2g} times the expected one "
        f"{h.by}: three sd of the difference are {3 * h.sd:.2g}"
        for h in held
        if not h.agrees
    ]
    names = tuple(sorted(e.cell.name for e in effects))
    if reasons:
        return replace(
            first, word="unattributed", after=after, names=(), held=held, reasons=tuple(reasons)
        )
    evidence = evidence_of(rivals)
    last = rivals[0]
    if all(evidence.get(n, 0.0) >= NAMED for n in last.names):
        why = f"{' and '.join(names)} gains {gained:.1f} nat and leaves nothing behind"
        return replace(
            first, word="effect", after=after, names=names, hypotheses=rivals, evidence=evidence,
            held=held, reasons=(why,), best=last,
        )  # fmt: skip
    several: list[str] = []
    total = 0.0
    for one in rivals:
        several += [n for n in one.names if n not in several]
        total += one.weight
        if total >= CREDIBLE:
            break
    word: Word = "not separable" if len(several) <= MOST_NAMES else "unattributed"
    why = f"{len(several)} names share the evidence"
    return replace(
        first, word=word, after=after, names=tuple(several) if word == "not separable" else (),
        hypotheses=rivals, evidence=evidence, held=held, reasons=(why,), best=last,
    )  # fmt: skip
