"""Effects that a diagnosis named go into the rotor's model, and out of it again.

Both are entries of the log (`service.adopted`), appended in one transaction; the posterior follows
like after any other entry, from the whole log under the new network.

A diagnosis is adopted where it speaks of the rotor as it is:

* its verdict is ``effect``, or it is ``unattributed`` and the readings bear a discrepancy out that
  names no cause and widens the bands: there is nothing else that could go into a model;
* the rotor's model is the one that it was made for: an effect is what *that* model lacked;
* every reading that it used still counts, unchanged. Readings that came later are no obstacle, or
  nothing could be adopted on a rotor that is read all the time; the answer tells how many;
* no blade joined since whom the effect would have to be told about: one of its lot, or one with a
  clock of its own where the effect runs by the rotor's.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

from core.errors import BladetwinError
from core.observation import Inspection, effective
from service.adopted import ADOPTION, BACK_OUT, Adopted, adopted_at, entries
from service.entries import entries_of
from service.errors import AdoptionError, NotFoundError
from service.handlers.diagnoses import found_in
from service.handlers.rotors import digest_of_json
from service.ports import (
    BladeRecord,
    Event,
    JobRecord,
    Json,
    ModelCard,
    NewEvent,
    RotorRecord,
    Science,
    Store,
    Transaction,
)
from service.variant import with_more

PAGE = 500


@dataclass(frozen=True, slots=True)
class Change:
    """An entry that adopted or backed out, and whether this request appended it."""

    event: Event
    body: Json
    new: bool


def adopt(store: Store, science: Science, rotor_id: str, diagnosis: str) -> Change:
    """The effects of a diagnosis enter the model; one that is in force gives its entry again.

    Raises NotFoundError, and AdoptionError with what to do.
    """
    with store.read() as tx:
        job = found_in(tx, rotor_id, diagnosis)
        rotor = tx.records.rotor(rotor_id)
        card = tx.records.model(rotor.model_id, rotor.model_version)
    science.vary(card, rotor.network)  # loads the model before anybody waits for a lock
    with store.write() as tx:
        return adopt_in(tx, science, job, job.result)


def adopt_in(
    tx: Transaction, science: Science, job: JobRecord, result: Json | None, *, unasked: bool = False
) -> Change:
    """The same inside a writing transaction.

    unasked   by the rotor's own option `adopt`, with the result that is being written
    """
    assert job.rotor_id is not None
    head = tx.log.lock(job.rotor_id)
    rotor = tx.records.rotor(job.rotor_id)
    now = adopted_at(tx, rotor)
    for sheet in now.sheets:
        if sheet.diagnosis == job.id:
            return _at(tx, rotor.id, sheet.seq)
    adds = _claimed(job, result)
    assert result is not None
    card = tx.records.model(rotor.model_id, rotor.model_version)
    network = with_more(now.network, adds)
    models = _models(science, card, now, network, job, result)
    since = _since(tx, rotor, job, result, head)
    body: Json = {
        "number": now.count + 1,
        "diagnosis": job.id,
        "effects": _told(result),
        "before": now.network,
        "after": network,
        "models": models,
        "through_seq": result["rests_on"]["through_seq"],
        "readings_since": since,
        "unasked": unasked,
    }
    return _append(tx, rotor.id, ADOPTION, body)


def back_out(store: Store, science: Science, rotor_id: str, diagnosis: str) -> Change:
    """The former network comes back; one that is backed out already gives its entry again.

    The diagnosis itself need not be here any more. Raises NotFoundError where it was never
    adopted, AdoptionError where a later one rests on it.
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
        return _append(tx, rotor_id, BACK_OUT, body)


def history(store: Store, rotor_id: str, after: int, limit: int) -> list[Change]:
    """What was adopted and backed out, in order, after a sequence number."""
    with store.read() as tx:
        tx.records.rotor(rotor_id)
        return [_change(event) for event in tx.log.changes(rotor_id, after, limit)]


def standing(store: Store, rotor_id: str, diagnosis: str) -> Change | None:
    """The last entry that concerns a diagnosis; None: it was never adopted."""
    with store.read() as tx:
        own = [c for c in map(_change, entries(tx, rotor_id)) if c.body["diagnosis"] == diagnosis]
    return own[-1] if own else None


def _change(event: Event, *, new: bool = False) -> Change:
    return Change(event, json.loads(event.body), new)


def _at(tx: Transaction, rotor_id: str, seq: int) -> Change:
    return _change(tx.log.changes(rotor_id, seq - 1, 1)[0])


def _last(tx: Transaction, rotor_id: str, diagnosis: str) -> Change:
    for event in reversed(entries(tx, rotor_id)):
        if (change := _change(event)).body["diagnosis"] == diagnosis:
            return change
    remedy = f"GET /v1/rotors/{rotor_id}/adoptions lists what was adopted"
    raise NotFoundError("adoption of diagnosis", diagnosis, remedy)


def _append(tx: Transaction, rotor_id: str, kind: str, body: Json) -> Change:
    text, digest = digest_of_json(body)
    event = NewEvent(f"{kind}/{body['number']}", kind, text, digest)
    seq = tx.log.append(rotor_id, [event])[0].seq
    return Change(_at(tx, rotor_id, seq).event, body, True)


def _claimed(job: JobRecord, result: Json | None) -> Json:
    """What a result adds to a network; AdoptionError: nothing that could be adopted."""
    where = f"POST /v1/rotors/{job.rotor_id}/diagnoses"
    if result is None:
        problem = f"it is {job.status} and has no result"
        wait = f"wait until GET /v1/rotors/{job.rotor_id}/diagnoses/{job.id} says done"
        over = job.status in ("failed", "cancelled")
        raise AdoptionError(job.id, "adopted", problem, f"ask anew: {where}" if over else wait)
    verdict = result["verdict"]
    wide = (result.get("widened") or {}) if verdict == "unattributed" else {}
    if verdict != "effect" and not wide.get("borne_out"):
        problem = (
            f"its verdict is {verdict!r}, and it has neither an effect that is named "
            "nor a discrepancy that is borne out"
        )
        remedy = {
            "adequate": "leave the model as it is",
            "not separable": "take the readings that would separate "
            f"{' and '.join(result['names']) or 'the effects'}, then ask anew: {where}",
        }.get(verdict, f"add readings, or families of effects of your own, then ask anew: {where}")
        raise AdoptionError(job.id, "adopted", problem, remedy)
    adds: Json | None = result.get("adds")
    if not adds:
        problem = "it is of a release that did not say what its effects add to the network"
        raise AdoptionError(job.id, "adopted", problem, f"ask anew: {where}")
    return adds


def _models(
    science: Science, card: ModelCard, now: Adopted, network: Json, job: JobRecord, result: Json
) -> Json:
    """Digests of the model before and after; AdoptionError: not those of the diagnosis."""
    anew = f"ask for a diagnosis of the present model: POST /v1/rotors/{job.rotor_id}/diagnoses"
    before = science.vary(card, now.network).digest
    if before != result["models"]["before"]:
        since = [sheet.diagnosis for sheet in now.sheets]
        why = f" (adopted since: {', '.join(since)})" if since else ""
        problem = (
            f"it was made for model {result['models']['before'][:12]}…, "
            f"and the rotor has {before[:12]}…{why}"
        )
        raise AdoptionError(job.id, "adopted", problem, anew)
    try:
        after = science.vary(card, network).digest
    except BladetwinError as error:
        raise AdoptionError(job.id, "adopted", f"the model refuses it ({error})", anew) from None
    if after != result["models"]["after"]:
        problem = (
            f"this release makes model {after[:12]}… of it, "
            f"not {result['models']['after'][:12]}…, which was calibrated"
        )
        raise AdoptionError(job.id, "adopted", problem, anew)
    return {"before": before, "after": after}


def _since(tx: Transaction, rotor: RotorRecord, job: JobRecord, result: Json, head: int) -> int:
    """How many readings count that the diagnosis did not see; AdoptionError: its own do not."""
    through = int(result["rests_on"]["through_seq"])
    anew = f"ask for a new diagnosis: POST /v1/rotors/{rotor.id}/diagnoses"
    then, now = _readings(tx, rotor.id, through, head)
    gone = sorted(name for name, reading in then.items() if now.get(name) != reading)
    if gone:
        shown = ", ".join(gone[:5]) + ("…" if len(gone) > 5 else "")
        problem = f"{len(gone)} of its {len(then)} readings count no longer ({shown})"
        raise AdoptionError(job.id, "adopted", problem, anew)
    joined = [b for b in tx.records.blades(rotor.id) if b.added_seq > through]
    for effect in _told(result):
        strangers = [b.id for b in joined if _concerns(effect, b)]
        if strangers:
            problem = f"{', '.join(strangers)} joined since, and {effect['name']!r} concerns them"
            raise AdoptionError(job.id, "adopted", problem, anew)
    return len(now) - len(then)


def _told(result: Json) -> list[Json]:
    """The effects that enter; of a lack without a name, its discrepancy, which is all blades'."""
    if result["verdict"] == "effect":
        return list(result["effects"])
    wide = result["widened"]
    name = f"discrepancy ({wide['quantity']})"
    share = f"{wide['share']:.0%} of the variance at {wide['time_h']:,.0f} h"
    return [
        {
            "name": name,
            "words": f"{name}: {share}, without a cause",
            "kind": "unnamed",
            "on": "quantity",
            "target": wide["quantity"],
            "whom": "all",
            "value": None,
            "shape": "gp",
            "clock": "blade",
        }
    ]


def _concerns(effect: Json, blade: BladeRecord) -> bool:
    """Whether a blade that joined has to be told about an effect: of its lot, or of a day."""
    whom, value = effect["whom"], effect["value"]
    own = {"lot": blade.lot, "coating_lot": blade.coating_lot}
    if whom in own:
        return bool(own[whom] == value)
    return bool(effect["clock"] == "rotor" and effect["shape"] != "constant" and whom == "all")


def _readings(
    tx: Transaction, rotor_id: str, through: int, head: int
) -> tuple[dict[str, str], dict[str, str]]:
    """The readings that counted as of an entry, and those that count now: id -> digest."""
    events: list[Event] = []
    last = 0
    while last < head:
        page = tx.log.entries(rotor_id, last, head, PAGE)
        if not page:
            break
        events += page
        last = page[-1].seq

    def counting(until: int) -> tuple[Inspection, ...]:
        return effective(entries_of([e for e in events if e.seq <= until]))

    then, now = ({r.id: r.digest() for r in counting(until)} for until in (through, head))
    return then, now
