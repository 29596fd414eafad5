"""A rotor leaves as one file, entry for entry.

The file holds what the posterior is a function of (blades, network, seed, the whole log with the
moments of arrival), not the posterior: a service that imports it (`service.handlers.transfer_in`)
computes it from the log, and its sealed state is bit-identical to the original's.

Every entry, the rotor's row and the blades are held against their digests before they go out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from service import bundle
from service.digests import as_created, digest_of_blade, digest_of_rotor, policy_problem
from service.entries import body_problem
from service.errors import DamagedError, DamagedLogError, DamagedRotorError, NotYetError
from service.handlers.blades import blades_at
from service.handlers.transfer_lines import CHUNK, EntryLine, PolicyLine, RotorLine
from service.ports import BladeRecord, Event, Json, RotorRecord, Store, Transaction


def export_rotor(store: Store, rotor_id: str, path: Path, release: str) -> Json:
    """Write a rotor as it stands into a file; its manifest. Later entries are left out.

    DamagedLogError, DamagedRotorError: what it would hold is not what was written, and a file that
    is there already stays.
    """
    with store.read() as tx:
        rotor = tx.records.rotor(rotor_id)
        card = tx.records.model(rotor.model_id, rotor.model_version)
        head = rotor.head_seq
        blades = blades_at(tx.records.blades(rotor_id), head)
        state = _newest_sealed(tx, rotor_id, head)
    _check_creation(rotor, blades)
    line = RotorLine(
        id=rotor.id,
        model=rotor.model_id,
        model_version=rotor.model_version,
        model_digest=card.digest,
        particles=rotor.particles,
        seed=rotor.seed,
        network=rotor.network,
        origin=rotor.origin,
        adopt=rotor.adopt,
        diagnose=rotor.diagnose,
        policy=None if rotor.policy is None else PolicyLine(**asdict(rotor.policy)),
        digest=rotor.digest,
        created_at=rotor.created_at,
    )
    model = {"id": card.id, "version": card.version, "digest": card.digest}
    facts: Json = {"release": release, "rotor": rotor.id, "model": model, "head_seq": head}
    log = (_told_entry(event) for event in _entries(store, rotor_id, head, blades))
    present = (asdict(blade) for blade in blades)
    return bundle.write(
        path, facts | {"state": state}, line.model_dump(exclude_defaults=True), present, log
    )


def _check_creation(rotor: RotorRecord, blades: Sequence[BladeRecord]) -> None:
    """DamagedRotorError: the rotor's row, or those of its first blades, are not what they were."""
    asks = (rotor.particles, rotor.seed, rotor.network, rotor.adopt, rotor.diagnose)
    made = digest_of_rotor(rotor.id, rotor.model_id, as_created(blades), *asks)
    if made != rotor.digest:
        problem = f"has digest {made[:12]}… with its first blades, written was {rotor.digest[:12]}…"
        raise DamagedRotorError(rotor.id, [f"rotor {rotor.id} {problem}"])
    if (now := policy_problem(rotor)) is not None:
        raise DamagedRotorError(rotor.id, [f"rotor {rotor.id}: {now}"])


def _newest_sealed(tx: Transaction, rotor_id: str, head: int) -> Json | None:
    """Digests of the newest version, if it is sealed and sound, to compare an import with.

    Where it rests on entries after `head`, which came while this was read, there is none.
    """
    try:
        state = tx.states.get(rotor_id)
    except (NotYetError, DamagedError):
        return None
    if not state.sealed or state.through_seq > head:
        return None
    names = ("through_seq", "events_digest", "digest", "algorithm_version")
    return {name: getattr(state, name) for name in names}


def _entries(
    store: Store, rotor_id: str, head: int, blades: Sequence[BladeRecord]
) -> Iterator[Event]:
    after, joined = 0, {blade.id: digest_of_blade(blade) for blade in blades if blade.added_seq}
    while after < head:
        with store.read() as tx:
            page = tx.log.entries(rotor_id, after, head, CHUNK)
        for event in page:
            problem = body_problem(event)
            if problem is not None or event.seq != after + 1:
                problem = problem or f"entry {after + 1} is missing"
                raise DamagedLogError(rotor_id, event.event_id, problem)
            if event.kind == "blade" and joined.get(event.blade or "") != event.digest:
                problem = f"blade {event.blade} is not as entry {event.seq} made it"
                raise DamagedRotorError(rotor_id, [problem])
            after = event.seq
            yield event
        if not page:
            raise DamagedLogError(rotor_id, str(after + 1), "is missing")


def _told_entry(event: Event) -> Json:
    told = {name: getattr(event, name) for name in EntryLine.model_fields}
    if event.posted_by is None:
        del told["posted_by"]
    return told
