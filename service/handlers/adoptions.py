"""Effects that a diagnosis named go into the rotor's model, and out of it again.

Both are entries of the log (`service.adopted`), appended in one transaction; the posterior follows
like after any other entry, from the whole log under the new network.

What a diagnosis must be to enter: `service.handlers.adoptable`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

from core.log import Entry
from service.adopted import ADOPTION, BACK_OUT, JOINING, PAGE, Adopted, adopted_at, entries
from service.digests import digest_of_json
from service.errors import AdoptionError, NotFoundError
from service.handlers.adoptable import (
    claimed,
    holding,
    models_of,
    newcomers,
    read_ahead,
    readings_since,
    strangers,
    told_effects,
)
from service.handlers.blades import join_effect
from service.handlers.choice import Choice, chosen, same
from service.handlers.diagnoses import found_in
from service.ports import (
    BladeRecord,
    Event,
    JobRecord,
    Json,
    NewEvent,
    Science,
    Store,
    Transaction,
)
from service.variant import with_more

NOTES = {ADOPTION: "adopted", BACK_OUT: "backed-out"}  # as who listens is told


@dataclass(frozen=True, slots=True)
class Change:
    """An entry that adopted or backed out, and whether this request appended it.

    joined   the entries by which blades that had joined since the diagnosis joined its effects,
             appended in the same transaction
    """

    event: Event
    body: Json
    new: bool
    joined: tuple[Event, ...] = ()

    @property
    def head_seq(self) -> int:
        """The last entry that the request appended."""
        return self.joined[-1].seq if self.joined else self.event.seq

    @property
    def blades(self) -> list[str]:
        """Those that have joined, the first that joined the rotor first."""
        return [json.loads(event.body)["blade"] for event in self.joined]


def adopt(
    store: Store, science: Science, rotor_id: str, diagnosis: str, choice: Choice | None = None
) -> Change:
    """The effects of a diagnosis enter the model; one that is in force gives its entry again.

    choice  one of its alternatives in place of what it claims

    Raises NotFoundError, InputError for an alternative that it has not, and AdoptionError with
    what to do.
    """
    with store.read() as tx:
        job = found_in(tx, rotor_id, diagnosis)
        rotor = tx.records.rotor(rotor_id)
        card = tx.records.model(rotor.model_id, rotor.model_version)
    science.vary(card, rotor.network)  # loads the model before anybody waits for a lock
    ahead = read_ahead(store, rotor_id)
    with store.write() as tx:
        tx.log.lock(rotor_id)
        for sheet in adopted_at(tx, tx.records.rotor(rotor_id)).sheets:
            if sheet.diagnosis == job.id:
                same(job, sheet, choice)
                return _at(tx, rotor_id, sheet.seq)
        return enter(tx, ready(tx, science, job, job.result, ahead, choice=choice))


@dataclass(frozen=True, slots=True)
class Ready:
    """An adoption that nothing forbids: what it lies on, its entry, and who joins with it."""

    rotor_id: str
    now: Adopted
    body: Json
    late: Sequence[BladeRecord]


def ready(
    tx: Transaction,
    science: Science,
    job: JobRecord,
    result: Json | None,
    ahead: Sequence[Entry],
    *,
    unasked: bool = False,
    choice: Choice | None = None,
) -> Ready:
    """What would enter; nothing is written. AdoptionError: something forbids it.

    ahead     the first of the log's entries, read before the transaction (`read_ahead`)
    unasked   by the rotor's own option `adopt`, with the result that is being written
    """
    assert job.rotor_id is not None
    head = tx.log.lock(job.rotor_id)
    rotor = tx.records.rotor(job.rotor_id)
    now = adopted_at(tx, rotor)
    if choice is not None and result is not None:
        result = chosen(job, result, choice)
    adds = claimed(job, result)
    assert result is not None
    if unasked:
        holding(job, result)
    card = tx.records.model(rotor.model_id, rotor.model_version)
    late = newcomers(tx, rotor, result)
    then = adopted_at(tx, rotor, int(result["rests_on"]["through_seq"]))
    below = [sheet.diagnosis for sheet in then.sheets]
    models = models_of(science, card, now, adds, late, below, job, result)
    since = readings_since(tx, rotor, job, result, head, ahead)
    body: Json = {
        "number": now.count + 1,
        "diagnosis": job.id,
        "effects": told_effects(result),
        "before": now.network,
        "after": with_more(now.network, adds),
        "models": models,
        "through_seq": result["rests_on"]["through_seq"],
        "readings_since": since,
        "unasked": unasked,
    }
    body |= {} if choice is None else {"chosen": choice.to_json()}
    strangers(job, now.laid(body, head + 1), late)
    return Ready(rotor.id, now, body, late)


def enter(tx: Transaction, made: Ready) -> Change:
    """Append it, in the transaction in which it was found ready."""
    change = _append(tx, made.rotor_id, ADOPTION, made.body)
    now = made.now.after(change.event)
    for blade in made.late:
        now = join_effect(tx, made.rotor_id, now, made.body["diagnosis"], blade)
    return replace(_at(tx, made.rotor_id, change.event.seq), new=True)


def back_out(store: Store, science: Science, rotor_id: str, diagnosis: str) -> Change:
    """The former network comes back, and a rotor that the adoption had blocked is freed; what is
    backed out already gives its entry again. The diagnosis itself need not be here.

    Raises NotFoundError where it was never adopted, AdoptionError where a later one rests on it.
    """
    with store.read() as tx:
        rotor = tx.records.rotor(rotor_id)
        card = tx.records.model(rotor.model_id, rotor.model_version)
    science.vary(card, rotor.network)
    with store.write() as tx:
        tx.log.lock(rotor_id)
        now = adopted_at(tx, tx.records.rotor(rotor_id))
        places = [sheet.diagnosis for sheet in now.sheets]
        if diagnosis not in places:
            return _last(tx, rotor_id, diagnosis)
        later = places[places.index(diagnosis) + 1 :]
        if later:
            problem = f"what was adopted later rests on it ({', '.join(later)})"
            raise AdoptionError(diagnosis, "backed out", problem, f"back out {later[-1]} first")
        sheet = now.sheets[-1]
        models = {
            when: science.vary(card, network).digest
            for when, network in (("before", now.network), ("after", sheet.before))
        }
        body: Json = {
            "number": now.count + 1,
            "diagnosis": diagnosis,
            "effects": list(sheet.effects),
            "before": now.network,
            "after": sheet.before,
            "models": models,
        }
        tx.log.free(rotor_id)
        return _append(tx, rotor_id, BACK_OUT, body)


def history(store: Store, rotor_id: str, after: int, limit: int) -> list[Change]:
    """What was adopted and backed out, and who joined, in order, after a sequence number."""
    with store.read() as tx:
        tx.records.rotor(rotor_id)
        return [_change(event) for event in tx.log.changes(rotor_id, after, limit)]


def in_order(tx: Transaction, rotor_id: str) -> list[Change]:
    """Everything that was adopted and backed out, who joined left aside."""
    return [_change(event) for event in entries(tx, rotor_id) if event.kind != JOINING]


def standing(store: Store, rotor_id: str, diagnosis: str) -> Change | None:
    """The entry by which a diagnosis was last adopted or backed out; None: it never was."""
    with store.read() as tx:
        found = [c for c in in_order(tx, rotor_id) if c.body["diagnosis"] == diagnosis]
    return found[-1] if found else None


def _change(event: Event, *, new: bool = False) -> Change:
    return Change(event, json.loads(event.body), new)


def _at(tx: Transaction, rotor_id: str, seq: int) -> Change:
    """With the joinings right behind it; those of blades that come later stand behind the blade's
    own entry."""
    found = tx.log.changes(rotor_id, seq - 1, PAGE)
    joined = []
    for number, event in enumerate(found[1:], seq + 1):
        if event.kind != JOINING or event.seq != number:
            break
        joined.append(event)
    return replace(_change(found[0]), joined=tuple(joined))


def _last(tx: Transaction, rotor_id: str, diagnosis: str) -> Change:
    for event in reversed(entries(tx, rotor_id)):
        if (change := _change(event)).body["diagnosis"] == diagnosis:
            return change
    remedy = f"GET /v1/rotors/{rotor_id}/adoptions lists what was adopted"
    raise NotFoundError("adoption of diagnosis", diagnosis, remedy)


def _append(tx: Transaction, rotor_id: str, kind: str, body: Json) -> Change:
    text, digest = digest_of_json(body)
    event = NewEvent(f"{kind}/{body['number']}", kind, text, digest)
    found = _at(tx, rotor_id, tx.log.append(rotor_id, [event])[0].seq).event
    names = [one["name"] for one in body["effects"]]
    told = {"diagnosis": body["diagnosis"], "seq": found.seq, "posted_by": found.posted_by}
    told |= {"effects": names} | {of: body[of] for of in ("unasked", "chosen") if of in body}
    tx.outbox.post(rotor_id, NOTES[kind], told)
    return Change(found, body, True)
