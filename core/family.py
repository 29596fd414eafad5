"""A physical effect that a model may lack, as data: with a name, a sentence, a size and a shape.

A network declares those of its own physics (`core.network.Network.families`); those of a rotor of
blades are in `core.diagnosis.grammar`, which says how families span what a diagnosis looks for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from core.errors import InputError

Shape = Literal["constant", "early", "linear", "late", "step"]
Whom = Literal["all", "lot", "coating_lot", "blade", "instrument", "campaign"]
Clock = Literal["blade", "rotor", "event"]
How = Literal["plus", "times"]
SHAPES = ("constant", "early", "linear", "late", "step")
WHOM = ("all", "lot", "coating_lot", "blade", "instrument", "campaign")
MOST_TIMES = 10.0  # of an input or a reading
LEAST = 1e-4  # of an input's range, or in proportion
LEAST_NOISES = 1e-2  # of the least noise that a reading may have


@dataclass(frozen=True, slots=True)
class Family:
    """An effect with a name.

    name      as engineers say it
    sentence  what happens, for the report
    target    ``input`` or ``reading``
    of        the input's name; of a reading: the quantity
    how       ``plus`` or ``times``
    size      expected size, of what `how` says; for a reading with ``plus``, None: three times
              the noise
    sign      −1, 1, or 0: either
    clock     the blade's own hours, or the rotor's; ``event``: a step by the rotor's, of the blades
              that were on it then and of none that came later
    kind      physics, operation, material or sensor
    cause     what it has in common with families that differ in their course alone: where readings
              do not tell these apart, the cause is what is named; by default its own name
    """

    name: str
    sentence: str
    target: Literal["input", "reading"]
    of: str
    how: How
    size: float | None
    sign: int
    shapes: tuple[Shape, ...]
    whom: tuple[Whom, ...]
    clock: Clock
    kind: Literal["physics", "operation", "material", "sensor"]
    cause: str = ""

    def __post_init__(self) -> None:
        for name in ("name", "sentence", "of", "cause"):
            if not isinstance(text := getattr(self, name), str):
                raise InputError(f"{name} of an effect", text, "is no text", "give one, in quotes")
        for what, given, known in (
            ("shapes", self.shapes, SHAPES),
            ("whom", self.whom, WHOM),
            ("how", (self.how,), ("plus", "times")),
            ("target", (self.target,), ("input", "reading")),
            ("clock", (self.clock,), ("blade", "rotor", "event")),
            ("sign", (self.sign,), (-1, 0, 1)),
            ("kind", (self.kind,), ("physics", "operation", "material", "sensor")),
        ):
            wrong = [g for g in given if g not in known]
            if wrong or not given:
                raise InputError(
                    f"{what} of the effect {self.name!r}", wrong, "is unknown", f"use {[*known]}"
                )
        for what, each in (("shapes", self.shapes), ("whom", self.whom)):
            if len(set(each)) < len(each):
                raise InputError(
                    f"{what} of the effect {self.name!r}",
                    [*each],
                    "has one twice",
                    "give each once",
                )
        if self.size is None and (self.target, self.how) != ("reading", "plus"):
            raise InputError(f"size of the effect {self.name!r}", None, "is missing", "give it")
        if self.size is not None and not self.size > 0:
            raise InputError(
                f"size of the effect {self.name!r}", self.size, "is not positive", "give one > 0"
            )
        if self.clock == "event" and self.shapes != ("step",):
            raise InputError(
                f"shapes of the effect {self.name!r}", [*self.shapes], "is no event", "use step"
            )
        seen_by_hand = {"instrument", "campaign"} & set(self.whom)
        if self.target == "input" and seen_by_hand:
            raise InputError(
                f"whom of the effect {self.name!r}",
                sorted(seen_by_hand),
                "concerns readings, not an input",
                "use all, lot, coating_lot or blade",
            )

    def to_json(self) -> dict[str, Any]:
        """A plain dictionary."""
        told = asdict(self)
        if not told["cause"]:
            del told["cause"]
        return {**told, "shapes": list(self.shapes), "whom": list(self.whom)}

    @staticmethod
    def from_json(told: Mapping[str, Any]) -> Family:
        """The inverse of `to_json`. Raises InputError for what is no family."""
        try:
            return Family(**{**told, "shapes": tuple(told["shapes"]), "whom": tuple(told["whom"])})
        except (TypeError, KeyError) as error:
            raise InputError("effect", str(error), "is no effect", "see Family") from error


def odd_size(family: Family, whole: float, noise: float | None = None) -> tuple[str, str] | None:
    """Why a family's size cannot be meant, and what would do; None: it can.

    whole  high − low of the input or of the quantity
    noise  the least that a reading of the quantity may have

    An effect of more than there can be of a thing is none, and one that no reading shows is never
    found: both are slips of a unit.

    >>> thin = Family("wear", "it wears", "input", "wall", "plus", 0.5, -1, ("constant",), ("all",),
    ...               "blade", "physics")
    >>> odd_size(thin, 4.0), odd_size(thin, 4e-3)
    (None, ('is larger than all there can be of wall', 'give 0.004 at most'))
    >>> problem, remedy = odd_size(thin, 4e6)
    >>> print(f"{problem}; {remedy}")
    is too small for any reading to show: less than 0.0001 of the range of wall; give 400 or more
    """
    if family.size is None:
        return None
    most = MOST_TIMES if family.how == "times" else whole
    if family.size > most:
        return f"is larger than all there can be of {family.of}", f"give {most:g} at most"
    least, said = LEAST * whole, f"less than {LEAST:g} of the range of {family.of}"
    if family.how == "times":
        least, said = LEAST, f"in proportion, less than {LEAST:g}"
    elif noise is not None:
        least = LEAST_NOISES * noise
        said = f"less than a hundredth of the least noise of {family.of}, {noise:g}"
    if family.size < least:
        return f"is too small for any reading to show: {said}", f"give {least:g} or more"
    return None
