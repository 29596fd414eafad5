"""A rotor to be diagnosed: what was read, what is known of its blades, and scans of its states."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from core.answers import Answers, Stacked
from core.calibration.state import RotorSpec, RotorState, shared_posterior
from core.calibration.workspace import Workspace
from core.diagnosis.adopt import amplitude, typical_noise, with_effects
from core.diagnosis.amplitudes import Amplitude, amplitudes
from core.diagnosis.clock import readers
from core.diagnosis.concerned import Concerned, concerned
from core.diagnosis.conclude import Rival
from core.diagnosis.families import families_for
from core.diagnosis.grammar import Cell, Facts, cells
from core.diagnosis.halves import halves
from core.diagnosis.misread import apart
from core.diagnosis.moving import Physics, follows
from core.diagnosis.parted import Parted
from core.diagnosis.placebos import Placebo, placebos
from core.diagnosis.scan import Scan
from core.diagnosis.scores import Scores
from core.diagnosis.scoring import scores
from core.diagnosis.signature import exchanged, signatures, unnamed
from core.diagnosis.verdict import DEALT, Held
from core.errors import InputError
from core.family import Family
from core.model import Model
from core.observation import Inspection
from core.rng import seed_of
from core.surrogate.driven import Driven

KEPT = 3  # states whose scores are kept


@dataclass(frozen=True)
class Case:
    """A rotor to be diagnosed.

    families  beside those of the grammar and of the network
    serving   blades that are still on the rotor, which forecasts and inspections to come are of;
              none: all
    workspace of its updates, where rows are kept
    """

    spec: RotorSpec
    readings: tuple[Inspection, ...]
    facts: Mapping[str, Facts]
    families: Sequence[Family] = ()
    dealt: int = DEALT
    serving: Sequence[str] = ()
    workspace: Workspace | None = field(default=None, compare=False, repr=False)
    _seen: dict[tuple[str, str, frozenset[str]], Scores] = field(
        default_factory=dict, compare=False, repr=False
    )

    @property
    def seed(self) -> int:
        """Of its dealt sets: rotors of one seed have sets of their own."""
        return seed_of(self.spec.seed, self.spec.id)

    @property
    def present(self) -> tuple[str, ...]:
        """Blades that forecasts and inspections to come are of."""
        return tuple(self.serving) or tuple(self.spec.blades)

    @cached_property
    def read_h(self) -> dict[str, float]:
        """Hours of the blades at which each was read last."""
        found: dict[str, float] = {}
        for one in self.readings:
            found[one.blade] = max(one.time_h, found.get(one.blade, 0.0))
        return found

    def once(self, model: Model) -> frozenset[str]:
        """Blades of one number, where these are more than half: their own parameters make up for
        it, as far as priors go, and no second order holds there. None without such parameters."""
        numbers = Counter[str]()
        for one in self.readings:
            numbers[one.blade] += one.values.size
        few = frozenset(b for b, n in numbers.items() if n == 1)
        own = model.network.of_level("local")
        return few if own and 2 * len(few) > len(numbers) else frozenset()

    def noise(self, model: Model, state: RotorState) -> dict[str, float]:
        """Of a reading, by quantity, as the state has it."""
        shared = shared_posterior(state.meta, state.arrays.__getitem__)
        means = dict(zip(shared.names, shared.particles.mean.tolist(), strict=True))
        return typical_noise(model, means, self.readings)

    def cells(self, model: Model) -> list[Cell]:
        """Every cell that these readings could tell of; InputError where there is none at all.

        Of inputs that nothing can follow in time constant effects only.
        """
        inputs = [i.name for i in _base(model).inputs]
        quantities = [q.name for q in model.network.quantities]
        facts = {b: self.facts.get(b, Facts()) for b in self.spec.blades}
        read = sorted({r.blade for r in self.readings})
        every = cells(
            families_for(model.network, self.families),
            inputs,
            quantities,
            {b: facts[b] for b in read},
            readers(self.readings, facts),
            _base(model).horizon_h,
        )
        if not follows(model.surrogate):
            every = [c for c in every if c.family.target == "reading" or c.shape == "constant"]
        if not every:
            raise InputError(
                "families",
                len(self.families),
                f"and the built-in ones concern neither {', '.join(inputs)} nor readings of "
                f"{', '.join(quantities)} as they are: there is nothing to look for",
                "give families of this physics, here or in the model's network",
            )
        return every

    def seen(self, model: Model, state: RotorState, *, whole: bool = False) -> Scores:
        """Its scores under a state; those of the last few states are kept.

        whole  with blades that one reading sets apart (`misread.apart`): their particles were
               fitted to that reading, and what they say of the others is worth nothing; and with
               those that were read `once`, which are left out beside others
        """
        once = self.once(model)
        told = frozenset[str]() if len(once) == len(self.read_h) else once
        out = frozenset[str]() if whole else apart(state) | told
        key = (model.digest, state.digest, out)
        if key not in self._seen:
            while len(self._seen) >= KEPT:
                del self._seen[next(iter(self._seen))]
            given = (self.readings, self.spec.known, self.workspace, out)
            self._seen[key] = scores(model, state, *given)
        return self._seen[key]

    def scan(
        self,
        model: Model,
        state: RotorState,
        taken: Sequence[Cell] = (),
        noise: Mapping[str, float] | None = None,
    ) -> Scan:
        """Of a state; effects that are in the model already are left out, and may be all.

        noise  from which offsets without a size have theirs: as the bare model has it, so that a
               cell is as large in the scan as it is when it is calibrated; none: of this state
        """
        noise = self.noise(model, state) if noise is None else noise
        seen = self.seen(model, state)
        facts = {b: self.facts.get(b, Facts()) for b in self.spec.blades}
        gone = {one.name for one in taken}
        left = [c for c in self.cells(model) if c.name not in gone]
        found = signatures(model, seen, left, facts, noise, _physics(model))
        return Scan.of(left, seen, found, unnamed(seen, facts))

    def placebos(
        self,
        model: Model,
        state: RotorState,
        taken: Rival,
        without: Callable[[Cell], Rival | None],
    ) -> tuple[Placebo, ...]:
        """Of each effect in a model, beside all others; model, state without any effect.

        without  the rotor with all effects but one in its model; None: it could not be calibrated
        """
        facts = {b: self.facts.get(b, Facts()) for b in self.spec.blades}
        noise, found = self.noise(model, state), list[Placebo]()
        for cell in taken.effects:
            if (rest := without(cell)) is not None:
                seen = self.seen(rest.model, rest.state)
                changed = exchanged(seen, cell, facts, noise, _physics(rest.model))
                found += placebos(seen, cell, facts, changed, self.seed)
        return tuple(found)

    @cached_property
    def parted(self) -> Parted:
        """Its readings in halves that are calibrated by themselves."""
        work = self.workspace or Workspace()
        return Parted(self.spec, self.readings, work.heed)

    def concerned(self, model: Model, state: RotorState, taken: Rival) -> tuple[Concerned, ...]:
        """Whether all blades have the effects in a model; model, state without any effect."""
        return concerned(self.seen(taken.model, taken.state), self._amplitudes(model, state, taken))

    def _amplitudes(self, model: Model, state: RotorState, taken: Rival) -> Iterator[Amplitude]:
        """Of the effects in a model."""
        seen = self.seen(taken.model, taken.state)
        facts = {b: self.facts.get(b, Facts()) for b in seen.blades}
        noise = self.noise(model, state)
        return amplitudes(model, taken.state, seen, taken.effects, facts, noise)

    def halves(self, model: Model, state: RotorState, taken: Rival) -> tuple[Held, ...]:
        """Whether the effects in a model hold in halves: by amplitude, or each half by itself.

        model, state  without any effect
        """
        if not taken.effects:
            return ()
        seen = self.seen(taken.model, taken.state)
        facts = {b: self.facts.get(b, Facts()) for b in seen.blades}
        noise = self.noise(model, state)

        def again(cell: Cell, size: float, by: str) -> Held:
            name, origin = amplitude(cell, model.network)
            return self.parted.amplitudes(taken.model, cell.name, name, origin, size, by)

        found = halves(seen, self._amplitudes(model, state, taken), again)
        if not any(one.alone and not one.agrees for one in found):
            return found
        less = {
            cell.name: with_effects(
                model, [c for c in taken.effects if c != cell], facts, noise, self.read_h
            )
            for cell in taken.effects
        }
        return tuple(
            replace(one, gained=self.parted.gained(taken.model, less[one.effect], one.by))
            for one in found
        )


def _base(model: Model) -> Answers:
    """What answers for the physics, without what drives it."""
    answers = model.surrogate
    if isinstance(answers, Stacked):
        raise InputError("model", model.network.name, "is stacked", "diagnose its parts")
    return answers.base if isinstance(answers, Driven) else answers


def _physics(model: Model) -> Physics:
    answers = model.surrogate
    if isinstance(answers, Driven):
        return Physics.of(model.network, answers, dict(answers.fixed))
    return Physics.of(model.network, _base(model), {})
