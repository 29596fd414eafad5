"""Which effects are in a rotor's model, as its log says.

A diagnosis may end with an effect that the model lacks (`core.diagnosis`). Adopting it appends an
entry to the rotor's log, and backing it out another one. An entry holds the rotor's network before
and after it (`service.variant`), so that

    the network of a version = that of the last such entry up to the version's `through_seq`,
                               else the one that the rotor was created with,

on every machine, for every version that is kept, and for whoever replays or imports the log.
Adoptions lie on one another like sheets: each was calibrated with those below it in the model, so
only the last one is backed out.

A blade that joins a lot of which an effect is in force has the effect, as it grows with the blade's
own hours: its name goes into the network's list of blades, by an entry of the log for each adoption
that concerns it, in the transaction in which it joins. What lies above that adoption was put on the
network without it; so the network that a back-out brings back has the blade as well. A blade that
joined the rotor after a diagnosis joins its effects when they are adopted, in that transaction:
what is backed out and put back is what it was. Which effects a blade joins, and which it would have
to be told: `service.concerned`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from service.concerned import by_lot
from service.errors import DamagedLogError
from service.ports import BladeRecord, Event, Json, RotorRecord, Transaction

ADOPTION, BACK_OUT, JOINING = "adoption", "back-out", "joining"
KINDS = (ADOPTION, BACK_OUT, JOINING)
PARTS = ("drifts", "biases")
PAGE = 200


@dataclass(frozen=True, slots=True)
class Sheet:
    """An adoption that is in force: its diagnosis, its effects, its entry, what was below it.

    parts    what it added to the network's drifts and biases, by name
    joined   (part, blade) of each blade that has joined an effect since
    at       when it was adopted, s since 1970; unasked: by the rotor itself
    chosen   the `alternative` that somebody chose, and `because`; None: the diagnosis' own claim
    through  the last entry that its diagnosis knew
    """

    diagnosis: str
    effects: tuple[Json, ...]
    seq: int
    before: Json | None
    parts: frozenset[str] = frozenset()
    joined: tuple[tuple[str, str], ...] = ()
    at: float = 0.0
    unasked: bool = False
    chosen: Json | None = None
    through: int = 0

    def joins(self, blade: BladeRecord) -> list[Json]:
        """Its effects that a blade has which joins now: those of its lot, by its own hours."""
        return [e for e in self.effects if by_lot(e, blade) and part_of(e, self.parts)]

    def joined_to(self, effect: Json) -> list[str]:
        """The blades that have joined one of its effects."""
        part = part_of(effect, self.parts)
        return [blade for there, blade in self.joined if there == part]


@dataclass(frozen=True, slots=True)
class Adopted:
    """What a rotor's model holds as of an entry of its log.

    network   as `service.variant` reads it; None: the model's own
    sheets    what is in force, the first adopted first
    count     entries of `KINDS` so far
    """

    network: Json | None
    sheets: tuple[Sheet, ...] = ()
    count: int = 0

    @property
    def effects(self) -> list[Json]:
        """Every effect in force, with its diagnosis and entry, and who adopted it when."""
        return [
            {
                **effect,
                "diagnosis": sheet.diagnosis,
                "seq": sheet.seq,
                "at": sheet.at,
                "unasked": sheet.unasked,
                "chosen": sheet.chosen,
                "joined": sheet.joined_to(effect),
            }
            for sheet in self.sheets
            for effect in sheet.effects
        ]

    def without(self, late: Collection[str]) -> Json | None:
        """The network as it would be if these blades had joined no effect in force."""
        network = self.network
        for part in {part for sheet in self.sheets for part, _ in sheet.joined}:
            network = _listed(network, [part], lambda own: own.difference(late))
        return network

    def laid(self, body: Json, seq: int) -> Sheet:
        """The sheet of an adoption, by the body of its entry."""
        parts = frozenset(_parts(body["after"]) - _parts(self.network))
        of_whom, effects = bool(body.get("unasked", False)), tuple(body["effects"])
        own = Sheet(body["diagnosis"], effects, seq, self.network, parts, unasked=of_whom)
        knew = int(body.get("through_seq", seq))
        return replace(own, chosen=body.get("chosen"), through=knew)

    def after(self, event: Event) -> Adopted:
        """With one more entry. ValueError: the entry does not go on from here."""
        body = json.loads(event.body)
        if body["before"] != self.network:
            raise ValueError("it goes on from another network than the entries before it make")
        if body["number"] != self.count + 1 or event.event_id != f"{event.kind}/{body['number']}":
            raise ValueError(f"it is number {body['number']} of its kind, not {self.count + 1}")
        if event.kind == ADOPTION:
            if body["diagnosis"] in {sheet.diagnosis for sheet in self.sheets}:
                raise ValueError(f"diagnosis {body['diagnosis']} is adopted already")
            new = replace(self.laid(body, event.seq), at=event.received_at)
            sheets = (*self.sheets, new)
            return Adopted(body["after"], sheets, self.count + 1)
        if event.kind == JOINING:
            return self._joined(body)
        if not self.sheets or self.sheets[-1].diagnosis != body["diagnosis"]:
            raise ValueError(f"diagnosis {body['diagnosis']} is not the last one adopted")
        if body["after"] != self.sheets[-1].before:
            raise ValueError("it does not bring back the network before the adoption")
        return Adopted(body["after"], self.sheets[:-1], self.count + 1)

    def joining(self, sheet: Sheet, effects: Sequence[Json], blade: str) -> Json:
        """The body of the entry by which a blade joins effects of one of the sheets."""
        parts = [part for e in effects if (part := part_of(e, sheet.parts))]
        return {
            "number": self.count + 1,
            "diagnosis": sheet.diagnosis,
            "blade": blade,
            "effects": list(effects),
            "before": self.network,
            "after": with_blade(self.network, parts, blade),
        }

    def _joined(self, body: Json) -> Adopted:
        told = {sheet.diagnosis: sheet for sheet in self.sheets}
        if (sheet := told.get(body["diagnosis"])) is None:
            raise ValueError(f"diagnosis {body['diagnosis']} is not adopted")
        blade, effects = body["blade"], body["effects"]
        if not effects or any(one not in sheet.effects for one in effects):
            raise ValueError("its effects are not those of the adoption")
        if body != self.joining(sheet, effects, blade):
            raise ValueError(f"it does more than to put blade {blade} into these effects")
        parts = [part for e in effects if (part := part_of(e, sheet.parts))]
        new = replace(sheet, joined=(*sheet.joined, *((part, blade) for part in parts)))
        sheets = (new if one is sheet else one for one in self.sheets)
        below = tuple(replace(one, before=with_blade(one.before, parts, blade)) for one in sheets)
        return Adopted(body["after"], below, self.count + 1)


def part_of(effect: Json, parts: Iterable[str]) -> str | None:
    """The drift or bias by which an effect is in the network; None: none of these.

    Its name is the effect's, in the characters that a parameter's name may have, and numbered where
    there was one of that name (`core.diagnosis.adopt.parameter_name`).

    >>> part_of({"name": "wear (lot L1.2)"}, ["wear (lot L1 2) 2", "wear (lot L1 2) of"])
    'wear (lot L1 2) 2'
    """
    name = re.escape(effect["name"].replace("@", " at ").replace(".", " "))
    return next((one for one in sorted(parts) if re.fullmatch(rf"{name}(?: \d+)?", one)), None)


def with_blade(network: Json | None, parts: Iterable[str], blade: str) -> Json | None:
    """A network whose drifts and biases of these names concern one more blade.

    >>> wear = {"name": "wear", "blades": ["B1"]}
    >>> with_blade({"effects": {"drifts": [wear], "biases": []}}, ["wear"], "B0")
    {'effects': {'drifts': [{'name': 'wear', 'blades': ['B0', 'B1']}], 'biases': []}}
    """
    return _listed(network, parts, lambda own: own | {blade})


def _listed(
    network: Json | None, parts: Iterable[str], change: Callable[[set[str]], set[str]]
) -> Json | None:
    """A network whose drifts and biases of these names concern other blades."""
    if network is None or "effects" not in network:
        return network
    names, effects = frozenset(parts), network["effects"]
    changed = {
        kind: [
            {**one, "blades": sorted(change(set(one["blades"])))}
            if one["name"] in names and one.get("blades") is not None
            else one
            for one in effects[kind]
        ]
        for kind in PARTS
        if kind in effects
    }
    return {**network, "effects": {**effects, **changed}}


def _parts(network: Json | None) -> set[str]:
    """Names of the drifts and biases, of effects in a network, that concern some blades only."""
    effects = (network or {}).get("effects", {})
    listed = (one for kind in PARTS for one in effects.get(kind, ()))
    return {one["name"] for one in listed if one.get("blades") is not None}


def adopted_at(
    tx: Transaction, rotor: RotorRecord, through: int | None = None, changes: int | None = None
) -> Adopted:
    """What the rotor's model holds as of entry `through`; None: as of its head.

    changes   entries of `KINDS` up to the rotor's head, where they were counted: of most rotors
              there are none, and none are asked for

    Raises DamagedLogError where the entries do not go on from one another.
    """
    found = Adopted(rotor.network)
    if changes == 0 and through is not None and through <= rotor.head_seq:
        return found
    for event in entries(tx, rotor.id, through):
        try:
            found = found.after(event)
        except (ValueError, KeyError, TypeError) as error:
            raise DamagedLogError(rotor.id, event.event_id, str(error)) from None
    return found


def entries(tx: Transaction, rotor_id: str, through: int | None = None) -> list[Event]:
    """The entries that adopt, back out or let a blade join, in order."""
    found: list[Event] = []
    last = 0
    while page := tx.log.changes(rotor_id, last, PAGE):
        found += [e for e in page if through is None or e.seq <= through]
        last = page[-1].seq
        if len(page) < PAGE or (through is not None and last >= through):
            break
    return found
