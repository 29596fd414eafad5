"""Whether a diagnosis may be adopted: it speaks of the rotor as it is.

* Its verdict is ``effect``, or it is ``unattributed`` and the readings bear a discrepancy out that
  names no cause and widens the bands: there is nothing else that could go into a model.
* The rotor's model is the one that it was made for: an effect is what *that* model lacked.
* Every reading that it used still counts, unchanged. Readings that came later are no obstacle, or
  nothing could be adopted on a rotor that is read all the time; the answer tells how many.
* A blade that joined since has the effect, too, where it is of the blade's lot and grows with the
  blade's own hours, as it would had it joined after the adoption. None joined whom it would have to
  be told about: one of its lot, or any, where the effect runs by the rotor's hours, be it by the
  machine or an instrument, for at which of them the blade began is not known.

Each rule raises AdoptionError, with what to do.
"""

from __future__ import annotations

from collections.abc import Sequence

from core.errors import BladetwinError
from core.log import Entry, effective
from service.adopted import Adopted, Sheet
from service.concerned import concerns
from service.entries import entries_of
from service.errors import AdoptionError
from service.ports import (
    BladeRecord,
    JobRecord,
    Json,
    ModelCard,
    RotorRecord,
    Science,
    Store,
    Transaction,
)
from service.variant import with_more

PAGE = 500


def claimed(job: JobRecord, result: Json | None) -> Json:
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
            "not separable": f"take readings that would {_told(result)}, then ask anew: {where}",
        }.get(verdict, f"add readings, or families of effects of your own, then ask anew: {where}")
        if result.get("alternatives"):
            remedy += "; if you know which it is from elsewhere, choose it: "
            remedy += "its `alternative`, and `because`"
        raise AdoptionError(job.id, "adopted", problem, remedy)
    adds: Json | None = result.get("adds")
    if not adds:
        problem = "it is of a release that did not say what its effects add to the network"
        raise AdoptionError(job.id, "adopted", problem, f"ask anew: {where}")
    return adds


def _told(result: Json) -> str:
    """What readings would tell of a set that is not separable.

    >>> _told({"names": ["rub", "wear"], "beside": []})
    'separate rub and wear'
    >>> _told({"names": ["rub", "wear"], "beside": ["rub"]})
    'tell whether wear is there beside rub'
    """
    sure = result.get("beside") or []
    open_ = [name for name in result["names"] if name not in sure]
    if sure and len(open_) == 1:
        return f"tell whether {open_[0]} is there beside {' and '.join(sure)}"
    return f"separate {' and '.join(open_) or 'the effects'}"


def holding(job: JobRecord, result: Json) -> None:
    """AdoptionError: it fails in a condition or varies, and nobody has decided to have it so."""
    there = f"/v1/rotors/{job.rotor_id}/diagnoses/{job.id}"
    remedy = f"where it is to be had all the same, POST {there}/adoption"
    fails = [c for c in result.get("conditions") or () if not c["holds"]]
    if fails:
        where = ", ".join(f"{c['input']} = {c['value']:g}" for c in fails)
        raise AdoptionError(job.id, "adopted unasked", f"it does not hold at {where}", remedy)
    open_ = [c["effect"] for c in result.get("concerns") or () if not c["stands"]]
    if open_:
        problem = f"whether all blades have {' and '.join(open_)} is open, and all would get it"
        raise AdoptionError(job.id, "adopted unasked", problem, remedy)
    varies = [h for h in result.get("holds") or () if not h["agrees"]]
    if varies:
        how = ", ".join(f"of {h.get('effect', 'it')} {h['by']}" for h in varies)
        problem = f"the amplitude {how} is not one, and it would be adopted with one for all"
        raise AdoptionError(job.id, "adopted unasked", problem, remedy)


def models_of(
    science: Science,
    card: ModelCard,
    now: Adopted,
    adds: Json,
    late: Sequence[BladeRecord],
    below: Sequence[str],
    job: JobRecord,
    result: Json,
) -> Json:
    """Digests of the model before and after; AdoptionError: not those of the diagnosis.

    late   the blades that joined since (`newcomers`): without the effects in force that they have
           joined, the models have to be those that were calibrated
    below  the diagnoses of which effects were in the model for which this one was made
    """
    anew = f"ask for a diagnosis of the present model: POST /v1/rotors/{job.rotor_id}/diagnoses"
    then = now.without({blade.id for blade in late})
    before = science.vary(card, then).digest
    if before != result["models"]["before"]:
        there = [sheet.diagnosis for sheet in now.sheets]
        since = [name for name in there if name not in below]
        out = [name for name in below if name not in there]
        why = f" (adopted since: {', '.join(since)})" if since else ""
        why += f" (backed out since: {', '.join(out)})" if out else ""
        problem = (
            f"it was made for model {result['models']['before'][:12]}…, "
            f"and the rotor has {before[:12]}…{why}"
        )
        again = f"adopt {out[0]} again first, or " if out and not since else ""
        raise AdoptionError(job.id, "adopted", problem, again + anew)
    try:
        after = science.vary(card, with_more(then, adds)).digest
    except BladetwinError as error:
        raise AdoptionError(job.id, "adopted", f"the model refuses it ({error})", anew) from None
    if after != result["models"]["after"]:
        problem = (
            f"this release makes model {after[:12]}… of it, "
            f"not {result['models']['after'][:12]}…, which was calibrated"
        )
        raise AdoptionError(job.id, "adopted", problem, anew)
    if then != now.network:
        networks = (now.network, with_more(now.network, adds))
        before, after = (science.vary(card, network).digest for network in networks)
    return {"before": before, "after": after}


def readings_since(
    tx: Transaction,
    rotor: RotorRecord,
    job: JobRecord,
    result: Json,
    head: int,
    ahead: Sequence[Entry] = (),
) -> int:
    """How many readings count that the diagnosis did not see; AdoptionError: its own do not.

    ahead   the first of the log's entries, where they were read before (`read_ahead`)
    """
    through = int(result["rests_on"]["through_seq"])
    anew = f"ask for a new diagnosis: POST /v1/rotors/{rotor.id}/diagnoses"
    then, now = _readings(tx, rotor.id, through, head, ahead)
    gone = sorted(name for name, reading in then.items() if now.get(name) != reading)
    if gone:
        shown = ", ".join(gone[:5]) + ("…" if len(gone) > 5 else "")
        problem = f"{len(gone)} of its {len(then)} readings count no longer ({shown})"
        raise AdoptionError(job.id, "adopted", problem, anew)
    return len(now) - len(then)


def newcomers(tx: Transaction, rotor: RotorRecord, result: Json) -> list[BladeRecord]:
    """The blades that joined after a diagnosis, the first that joined first."""
    through = int(result["rests_on"]["through_seq"])
    late = [b for b in tx.records.blades(rotor.id) if b.added_seq > through]
    return sorted(late, key=lambda blade: blade.added_seq)


def strangers(job: JobRecord, sheet: Sheet, late: Sequence[BladeRecord]) -> None:
    """AdoptionError: a blade that joined since would have to be told about one of the effects."""
    for effect in sheet.effects:
        names = [b.id for b in late if concerns(effect, b) and effect not in sheet.joins(b)]
        if names:
            problem = f"{', '.join(names)} joined since, and {effect['name']!r} concerns them"
            if effect.get("clock") == "rotor":
                problem += " by the rotor's hours (at which of these their own began is not known)"
            anew = f"ask for a new diagnosis: POST /v1/rotors/{job.rotor_id}/diagnoses"
            raise AdoptionError(job.id, "adopted", problem, anew)


def told_effects(result: Json) -> list[Json]:
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


def read_ahead(store: Store, rotor_id: str) -> list[Entry]:
    """The entries of a rotor's log as it stands, read and checked before anybody waits for it."""
    with store.read() as tx:
        head = tx.records.rotor(rotor_id).head_seq
    ahead: list[Entry] = []
    last = 0
    while last < head:
        with store.read() as tx:
            page = tx.log.entries(rotor_id, last, head, PAGE)
        if not page:
            break
        ahead += entries_of(page)
        last = page[-1].seq
    return ahead


def _readings(
    tx: Transaction, rotor_id: str, through: int, head: int, ahead: Sequence[Entry]
) -> tuple[dict[str, str], dict[str, str]]:
    """The readings that counted as of an entry, and those that count now: id -> digest."""
    known = list(ahead)
    last = known[-1].seq if known else 0
    while last < head:
        page = tx.log.entries(rotor_id, last, head, PAGE)
        if not page:
            break
        known += entries_of(page)
        last = page[-1].seq
    then = effective(entry for entry in known if entry.seq <= through)
    return {r.id: r.digest() for r in then}, {r.id: r.digest() for r in effective(known)}
