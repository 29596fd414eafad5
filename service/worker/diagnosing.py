"""A diagnosis as a job: what it rests on is read, and what was found becomes plain data.

It rests on the log through the entry that its request names and on nothing else: the science
calibrates anew from the readings that count, so neither the stored posterior, nor what comes while
it runs, nor how often it was begun changes the answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, MutableMapping
from dataclasses import replace
from typing import Any

from core.errors import InputError
from core.log import effective
from core.readings import digest_of
from service.adopted import adopted_at
from service.entries import entries_of
from service.ports import BladeRecord, Json, Progress, RotorSpec, Science
from service.store.creation import sound_blades
from service.store.entries import read_entries
from service.store.unit_of_work import SqlStore

MOST_PARTICLES = 2000  # a diagnosis calibrates about ten models


def diagnose(
    store: SqlStore,
    science: Science,
    rotor_id: str,
    request: Json,
    progress: Progress,
    kept: MutableMapping[str, Any],
    heed: Callable[[], None] = lambda: None,
) -> Json:
    """The result of a diagnosis of the log through ``request["through_seq"]``.

    kept  what an earlier attempt had found out; it spares time and changes nothing
    heed  called within steps, too; what it raises ends the diagnosis

    Raises InputError where no reading counts.
    """
    through = int(request["through_seq"])
    with store.read() as tx:
        rotor = tx.records.rotor(rotor_id)
        blades = sound_blades(tx.connection, rotor)
        blades = [_as_of(through, b) for b in blades if b.added_seq <= through]
        card = tx.records.model(rotor.model_id, rotor.model_version)
        events = read_entries(tx.connection, rotor_id, 0, through)
        network = adopted_at(tx, rotor, through).network
    readings = effective(entries_of(events))
    if not readings:
        raise InputError(
            "readings",
            0,
            f"count for rotor {rotor_id} through entry {through}",
            "post inspections, then ask for a diagnosis again",
        )
    card = science.vary(card, network)
    particles = min(rotor.particles, MOST_PARTICLES)
    known = {b.id: b.known for b in blades if b.known is not None}
    spec = RotorSpec(
        rotor.origin or rotor.id, tuple(b.id for b in blades), particles, rotor.seed, known
    )
    compare_h = float(request["horizon_h"]) if request["compare"] else None
    families = request["families"]
    asked = (blades, readings, families, compare_h)
    found = science.diagnose(card, spec, *asked, progress, kept, heed)
    rests_on = {
        "rotor": rotor_id,
        "through_seq": through,
        "events_digest": digest_of(readings),
        "model": card.id,
        "model_version": card.version,
        "model_digest": card.digest,
        "particles": particles,
        "seed": rotor.seed,
    }
    told: Json = plain(found) | {"rests_on": rests_on}
    return told


def _as_of(through: int, blade: BladeRecord) -> BladeRecord:
    """The blade as of an entry: what retires later is there still."""
    later = blade.retired_seq is not None and blade.retired_seq > through
    return replace(blade, retired_seq=None) if later else blade


def plain(value: Any) -> Any:
    """What JSON can hold: a number that is not finite becomes null.

    >>> plain({"p": float("nan"), "z": (1.0, float("inf"))})
    {'p': None, 'z': [1.0, None]}
    """
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
