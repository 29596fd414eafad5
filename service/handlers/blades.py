"""Blades of a rotor: who was there at an entry of its log, who joins and who leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from service.adopted import JOINING, Adopted, adopted_at
from service.digests import digest_of_json, told_of
from service.errors import ConflictError, FaultsError, NotFoundError
from service.ports import Appended, BladeRecord, NewEvent, RotorRecord, Store, Transaction
from service.slots import fault_beside
from service.variant import check_known


def blades_of(tx: Transaction, rotor_id: str) -> list[BladeRecord]:
    """All blades that it ever had; DamagedRotorError: they, or the rotor, are not what was
    written."""
    rotor = tx.records.rotor(rotor_id)  # first: who joins in between is no damage
    blades = tx.records.blades(rotor_id)
    tx.check_rotor(rotor, blades)
    return blades


def blades_at(blades: Sequence[BladeRecord], seq: int) -> list[BladeRecord]:
    """The blades as they were after entry `seq`: who joins later is left out, who leaves is on."""
    there = [blade for blade in blades if blade.added_seq <= seq]
    return [
        replace(blade, retired_seq=None)
        if blade.retired_seq is not None and blade.retired_seq > seq
        else blade
        for blade in there
    ]


def add_blade(store: Store, rotor_id: str, blade: BladeRecord) -> Appended:
    """A blade joins the rotor; its prior is what the rotor knows. An effect in force of its lot is
    its, too, by an entry of its own.

    FaultsError: its slot is that of a blade that runs. The rotor is locked by then, so that of two
    blades that come at once the second finds the first. ConflictError: one of its id is another, or
    has left: a repetition that was answered as done would be believed to be in service.
    """
    body, digest = digest_of_json(told_of(blade))
    event = NewEvent(f"blade/{blade.id}", "blade", body, digest, blade=blade.id)
    with store.read() as tx:
        rotor = tx.records.rotor(rotor_id)
        card = tx.records.model(rotor.model_id, rotor.model_version)
    check_known(card.network, [("", blade)])
    with store.write() as tx:
        tx.log.lock(rotor_id)
        there = tx.records.blade(rotor_id, blade.id)
        if there is not None and there.retired_seq is not None:
            problem = f"has left, by entry {there.retired_seq}, and none comes back"
            raise ConflictError("blade", blade.id, "choose a new id for the new blade", problem)
        if there is not None and there.added_seq == 0:
            if there != blade:
                raise ConflictError("blade", blade.id, "choose a new id for the new blade")
            return Appended(event.event_id, 0, False)
        taken = None
        if there is None:
            taken = fault_beside(blade, tx.records.blades(rotor_id), rotor_id)
        if taken is not None:
            raise FaultsError([taken])
        answer = tx.log.append(rotor_id, [event])[0]
        if answer.new:
            tx.records.put_blade(rotor_id, replace(blade, added_seq=answer.seq))
            join_effects(tx, tx.records.rotor(rotor_id), blade)
    return answer


def join_effects(tx: Transaction, rotor: RotorRecord, blade: BladeRecord) -> None:
    """A blade that has just joined has the effects in force of its lot, too (`service.adopted`)."""
    now = adopted_at(tx, rotor)
    for diagnosis in [sheet.diagnosis for sheet in now.sheets]:
        now = join_effect(tx, rotor.id, now, diagnosis, blade)


def join_effect(
    tx: Transaction, rotor_id: str, now: Adopted, diagnosis: str, blade: BladeRecord
) -> Adopted:
    """What is adopted once a blade has joined what a diagnosis found of its lot, if anything."""
    sheet = next(sheet for sheet in now.sheets if sheet.diagnosis == diagnosis)
    if not (effects := sheet.joins(blade)):
        return now
    text, digest = digest_of_json(now.joining(sheet, effects, blade.id))
    event = NewEvent(f"{JOINING}/{now.count + 1}", JOINING, text, digest)
    seq = tx.log.append(rotor_id, [event])[0].seq
    return now.after(tx.log.changes(rotor_id, seq - 1, 1)[0])


def retire_blade(store: Store, rotor_id: str, blade_id: str) -> Appended:
    """A blade leaves the rotor; what it told of the rotor stays."""
    event = NewEvent(f"retirement/{blade_id}", "retirement", *digest_of_json({}), blade=blade_id)
    with store.write() as tx:
        tx.log.lock(rotor_id)
        if tx.records.blade(rotor_id, blade_id) is None:
            raise NotFoundError("blade", blade_id, f"GET /v1/rotors/{rotor_id} lists the blades")
        answer = tx.log.append(rotor_id, [event])[0]
        if answer.new:
            tx.records.retire_blade(rotor_id, blade_id, answer.seq)
    return answer
