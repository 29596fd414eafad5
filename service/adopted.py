"""Which effects are in a rotor's model, as its log says.

A diagnosis may end with an effect that the model lacks (`core.diagnosis`). Adopting it appends an
entry to the rotor's log, and backing it out another one. An entry holds the rotor's network before
and after it (`service.variant`), so that

    the network of a version = that of the last such entry up to the version's `through_seq`,
                               else the one that the rotor was created with,

on every machine, for every version that is kept, and for whoever replays or imports the log.
Adoptions lie on one another like sheets: each was calibrated with those below it in the model, so
only the last one is backed out.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass

from service.errors import DamagedLogError
from service.ports import BladeRecord, Event, Json, RotorRecord, Transaction

ADOPTION, BACK_OUT = "adoption", "back-out"
KINDS = (ADOPTION, BACK_OUT)
PAGE = 200


@dataclass(frozen=True, slots=True)
class Sheet:
    """An adoption that is in force: its diagnosis, its effects, its entry, what was below it."""

    diagnosis: str
    effects: tuple[Json, ...]
    seq: int
    before: Json | None


@dataclass(frozen=True, slots=True)
class Adopted:
    """What a rotor's model holds as of an entry of its log.

    network   as `service.variant` reads it; None: the model's own
    sheets    what is in force, the first adopted first
    count     entries that adopted or backed out so far
    """

    network: Json | None
    sheets: tuple[Sheet, ...] = ()
    count: int = 0

    @property
    def effects(self) -> list[Json]:
        """Every effect in force, with its diagnosis and entry."""
        return [
            {**effect, "diagnosis": sheet.diagnosis, "seq": sheet.seq}
            for sheet in self.sheets
            for effect in sheet.effects
        ]

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
            new = Sheet(body["diagnosis"], tuple(body["effects"]), event.seq, self.network)
            return Adopted(body["after"], (*self.sheets, new), self.count + 1)
        if not self.sheets or self.sheets[-1].diagnosis != body["diagnosis"]:
            raise ValueError(f"diagnosis {body['diagnosis']} is not the last one adopted")
        if body["after"] != self.sheets[-1].before:
            raise ValueError("it does not bring back the network before the adoption")
        return Adopted(body["after"], self.sheets[:-1], self.count + 1)


def untold(effect: Json, blades: Iterable[BladeRecord]) -> list[str]:
    """Blades that joined after an effect in force (`Adopted.effects`), and that it concerns.

    The model takes such a blade for one that the effect leaves alone, or that began with the rotor.

    >>> wear = {"seq": 7, "whom": "lot", "value": "L1", "clock": "blade", "shape": "linear"}
    >>> untold(wear, [BladeRecord(f"B{n}", lot="L1", added_seq=n) for n in (0, 6, 8)])
    ['B8']
    """
    return [b.id for b in blades if b.added_seq > effect["seq"] and concerns(effect, b)]


def concerns(effect: Json, blade: BladeRecord) -> bool:
    """Whether a blade that joined has to be told about an effect: of its lot, or of a day.

    An event's, which was before it joined, it did not see.
    """
    whom, value = effect.get("whom"), effect.get("value")
    if effect.get("clock") == "event":
        return False
    own = {"lot": blade.lot, "coating_lot": blade.coating_lot}
    if whom in own:
        return bool(own[whom] == value)
    runs = effect.get("clock") == "rotor" and effect.get("shape") != "constant"
    return bool(runs and whom in ("all", "instrument", "campaign"))


def adopted_at(tx: Transaction, rotor: RotorRecord, through: int | None = None) -> Adopted:
    """What the rotor's model holds as of entry `through`; None: as of its head.

    Raises DamagedLogError where the entries do not go on from one another.
    """
    found = Adopted(rotor.network)
    for event in entries(tx, rotor.id, through):
        try:
            found = found.after(event)
        except (ValueError, KeyError, TypeError) as error:
            raise DamagedLogError(rotor.id, event.event_id, str(error)) from None
    return found


def entries(tx: Transaction, rotor_id: str, through: int | None = None) -> list[Event]:
    """The entries that adopt or back out, in order."""
    found: list[Event] = []
    last = 0
    while page := tx.log.changes(rotor_id, last, PAGE):
        found += [e for e in page if through is None or e.seq <= through]
        last = page[-1].seq
        if len(page) < PAGE or (through is not None and last >= through):
            break
    return found
