"""Every stored part of a rotor held against what it was called when it was written.

The log has a digest in each entry, numbers without a gap and a head; the rotor has its digest, and
blades have entries of the log (`service.store.creation`); a version has its digest, made from the
SHA-256 of its arrays, and the digest of the readings that it rests on, which the log gives again;
an array row has the SHA-256 of its bytes. What does not agree is a `Finding`.

Rows are read one by one in one snapshot, so that neither size nor a worker at work matters.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, Literal

from sqlalchemy import Connection, select

from core.errors import BladetwinError
from core.log import effective
from core.readings import digest_of
from service.entries import body_problem, entries_of
from service.errors import NotFoundError
from service.ports import Event, Json, ModelCard, Science
from service.store import creation, intact
from service.store import tables as t
from service.store.encoding import DamagedArrayError, Encoded, decode
from service.store.entries import read_entries
from service.store.kept import stored
from service.store.named import digests
from service.store.versions import ENDED

Part = Literal["log", "rotor", "blade", "state", "array", "model"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One damaged part.

    part      log, rotor, blade, state, array or model
    name      of the entry, the rotor, blade, array or model; of a state its version
    version   that the row belongs to; None: of no version
    """

    part: Part
    rotor: str | None
    version: int | None
    name: str
    problem: str

    @property
    def from_log(self) -> bool:
        """Whether the log alone can make it again."""
        return self.part in ("state", "array")

    def to_json(self) -> Json:
        return asdict(self)

    def __str__(self) -> str:
        where = "" if self.version is None else f", version {self.version}"
        whose = "" if self.rotor is None else f"rotor {self.rotor}{where}: "
        return f"{whose}{self.part} {self.name}: {self.problem}"


def audit(connection: Connection, rotor_id: str) -> list[Finding]:
    """Everything of a rotor that is not what was written."""
    events, lost = audit_source(connection, rotor_id)
    sound = not any(one.part == "log" for one in lost)
    arrays = list(_of_arrays(connection, rotor_id))
    return [*lost, *_of_states(connection, rotor_id, events if sound else [], sound), *arrays]


def audit_source(connection: Connection, rotor_id: str) -> tuple[list[Event], list[Finding]]:
    """A rotor's log, and what is wrong with it, with the rotor's row or with a blade's: what every
    version is computed from, and nothing makes again."""
    head = select(t.rotor.c.head_seq).where(t.rotor.c.id == rotor_id)
    head_seq = connection.execute(head).scalar()
    if head_seq is None:
        raise NotFoundError("rotor", rotor_id, "GET /v1/rotors lists those that exist")
    events = read_entries(connection, rotor_id, 0, 2**62)
    lost = list(_of_log(rotor_id, head_seq, events))
    odd = creation.problems(connection, rotor_id, None if lost else events)
    lost += [Finding(part, rotor_id, None, name, problem) for part, name, problem in list(odd)]
    return events, lost


def _of_log(rotor_id: str, head_seq: int, events: list[Event]) -> Iterator[Finding]:
    for place, event in enumerate(events, 1):
        if event.seq != place:
            missing = f"entry {place} is missing"
            yield Finding("log", rotor_id, None, str(place), missing)
            return
        problem = body_problem(event)
        if problem is not None:
            yield Finding("log", rotor_id, None, event.event_id, problem)
    if head_seq != len(events):
        problem = f"the rotor's head is {head_seq}, the log ends at {len(events)}"
        yield Finding("log", rotor_id, None, str(head_seq), problem)


def _of_states(
    connection: Connection, rotor_id: str, events: list[Event], sound: bool
) -> Iterator[Finding]:
    rested: dict[int, str] = {}
    newest = None
    for row in connection.execute(stored(rotor_id).order_by(t.state.c.version)):
        newest = row.version
        names = digests(connection, rotor_id, row.version)
        found = intact.problems(row, names)
        if sound and row.through_seq not in rested:
            counts = effective(entries_of([e for e in events if e.seq <= row.through_seq]))
            rested[row.through_seq] = digest_of(counts)
        if sound and rested[row.through_seq] != row.events_digest:
            found.append(
                f"it rests on readings of digest {row.events_digest[:12]}…, the log through "
                f"{row.through_seq} has {rested[row.through_seq][:12]}…"
            )
        if found:
            yield Finding("state", rotor_id, row.version, str(row.version), "; ".join(found))
    query = select(t.cursor.c.version).where(t.cursor.c.rotor_id == rotor_id)
    cursor = connection.execute(query).scalar() or 0
    if cursor != (newest or 0):
        missing = f"the newest version, {cursor}, is not stored"
        yield Finding("state", rotor_id, cursor, str(cursor), missing)


def _of_arrays(connection: Connection, rotor_id: str) -> Iterator[Finding]:
    a = t.state_array.c
    keys = select(a.name, a.version).where(a.rotor_id == rotor_id).order_by(a.version, a.name)
    for key in connection.execute(keys).all():
        problem = array_problem(array_row(connection, rotor_id, key.name, key.version))
        if problem is not None:
            yield Finding("array", rotor_id, key.version, key.name, problem)


def array_row(connection: Connection, rotor_id: str, name: str, version: int) -> Encoded:
    """The row of this very version."""
    a = t.state_array.c
    query = select(a.encoding, a.dtype, a.shape, a.sha256, a.data).where(
        a.rotor_id == rotor_id, a.name == name, a.version == version
    )
    return Encoded(**connection.execute(query).one()._mapping)


def array_problem(row: Encoded) -> str | None:
    """What is wrong with a row of array bytes; None: nothing."""
    if not row.dtype:
        return None if row == ENDED else "the name ended here, but the row is not empty"
    try:
        decode("bytes", row)
    except (DamagedArrayError, ValueError) as error:
        return str(error)
    return None


def audit_artefact(
    files: Callable[[str], bytes], science: Science, card: ModelCard
) -> list[Finding]:
    """A model of users' runs: its file, and the card that the file gives again."""
    try:
        again = science.opened(card.id, files(str(card.summary["artefact"])))
    except BladetwinError as error:
        return [Finding("model", None, None, f"{card.id} {card.version}", str(error))]
    if json.dumps(again.to_json(), sort_keys=True) == json.dumps(card.to_json(), sort_keys=True):
        return []
    problem = "the registered card is not that of its file"
    return [Finding("model", None, None, f"{card.id} {card.version}", problem)]


def audit_models(connection: Connection, builtin: Mapping[str, Any]) -> list[Finding]:
    """Registered models held against this release's built-in ones.

    builtin   the card of each, or the error that kept it from being loaded
    """
    found = []
    for name, card in builtin.items():
        if isinstance(card, BladetwinError):
            found.append(Finding("model", None, None, name, str(card)))
            continue
        key = (t.model.c.id == card.id) & (t.model.c.version == card.version)
        row = connection.execute(select(t.model).where(key)).one_or_none()
        if row is None:
            continue
        stands: Any = None
        with suppress(ValueError):
            stands = json.loads(row.card)
        if row.digest != card.digest or stands != json.loads(json.dumps(card.to_json())):
            problem = "the registered card is not that of the release's model of this version"
            found.append(Finding("model", None, None, f"{card.id} {card.version}", problem))
    return found
