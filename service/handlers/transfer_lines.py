"""The lines of a rotor's file, each held against its own digest and against those before it.

What comes out of here could have been written by the service itself: blades that the creation and
the log's own entries give, readings that the model can use, numbers without a gap.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, StringConstraints, ValidationError

from core.errors import BladetwinError, InputError
from core.observation import Inspection, check
from service.adopted import KINDS, Adopted
from service.bundle import Bundle, BundleError
from service.digests import as_created, digest_of_blade, digest_of_policy, digest_of_rotor
from service.entries import UNREADABLE, body_problem
from service.handlers.transfer_bodies import AdoptionBody, ReadingBody, first_fault
from service.names import ID_PATTERN, TEXT_PATTERN
from service.ports import Adopt, BladeRecord, Diagnose, Event, Json, ModelCard, Policy
from service.variant import check_known

CHUNK = 500  # entries that are read or written at once
Id = Annotated[str, StringConstraints(max_length=100, pattern=ID_PATTERN)]
Text = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=TEXT_PATTERN)]
Name = Annotated[str, StringConstraints(max_length=200, pattern=TEXT_PATTERN)]
Seq = Annotated[int, Field(ge=0, lt=2**62)]
Moment = Annotated[FiniteFloat, Field(ge=0, lt=1e11)]  # s since 1970


class Line(BaseModel):
    """A line of the file."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


L = TypeVar("L", bound=BaseModel)


class PolicyLine(Line):
    adopt: Adopt
    diagnose: Diagnose
    at: Moment
    digest: Name


class RotorLine(Line):
    id: Id
    model: Id
    model_version: Name
    model_digest: Name
    particles: Annotated[int, Field(ge=16, le=1_000_000)]
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    network: Json | None
    origin: Id | None
    digest: Name
    adopt: Adopt = "never"
    diagnose: Diagnose = "never"
    policy: PolicyLine | None = None
    created_at: Moment | None = None


class BladeLine(Line):
    id: Id
    slot: Text | None
    lot: Text | None
    coating_lot: Text | None
    installed_at: Text | None
    time_h0: FiniteFloat | None
    added_seq: Seq
    retired_seq: Seq | None
    known: dict[Id, FiniteFloat] | None


class EntryLine(Line):
    seq: Seq
    event_id: Annotated[str, StringConstraints(max_length=240, pattern=TEXT_PATTERN)]
    kind: Annotated[str, StringConstraints(max_length=20)]
    replaces: Id | None
    blade: Id | None
    time_h: FiniteFloat | None
    body: str
    digest: Annotated[str, StringConstraints(max_length=64, pattern=r"^[0-9a-f]+$")]
    received_at: Moment
    posted_by: Annotated[str, StringConstraints(max_length=40, pattern=TEXT_PATTERN)] | None = None


class NamedLine(Line):
    id: Id


def parsed(file: Bundle, kind: type[L], row: Json, where: str) -> L:
    try:
        return kind.model_validate(row)
    except ValidationError as error:
        raise BundleError(file.path, f"{where}: {first_fault(error)}") from None


@contextmanager
def held(file: Bundle, where: str) -> Iterator[None]:
    """What comes of fields of another type, deep inside what the science reads, is told as damage.

    BundleError: the science cannot read it.
    """
    try:
        yield
    except UNREADABLE as error:
        raise BundleError(file.path, f"{where}: {type(error).__name__}: {error}") from None


def read_events(file: Bundle) -> Iterator[Event]:
    for number, row in enumerate(file.rows("log.jsonl"), 1):
        yield Event(**parsed(file, EntryLine, row, f"log.jsonl, line {number}").model_dump())


def read_blades(file: Bundle, told: RotorLine, card: ModelCard) -> list[BladeRecord]:
    blades = []
    for number, row in enumerate(file.rows("blades.jsonl"), 1):
        line = parsed(file, BladeLine, row, f"blades.jsonl, line {number}")
        blades.append(BladeRecord(**line.model_dump() | {"known": line.known or None}))
    names = [blade.id for blade in blades]
    if names != sorted(set(names)):
        raise BundleError(file.path, "blades.jsonl is not ordered by id, or names a blade twice")
    check_known(card.network, [(f"blade {blade.id}: ", blade) for blade in blades])
    asks = (told.particles, told.seed, told.network, told.adopt, told.diagnose)
    made = digest_of_rotor(told.id, told.model, as_created(blades), *asks)
    if made != told.digest:
        raise BundleError(file.path, "rotor.json and blades.jsonl do not have the rotor's digest")
    now = told.policy
    if now is not None and policy_of(told.id, now).digest != now.digest:
        raise BundleError(file.path, "the policy in rotor.json does not have its digest")
    return blades


def policy_of(name: str, told: PolicyLine) -> Policy:
    """What a rotor of this name does by itself."""
    digest = digest_of_policy(name, told.adopt, told.diagnose, told.at)
    return Policy(told.adopt, told.diagnose, told.at, digest)


def checked_log(
    file: Bundle,
    blades: list[BladeRecord],
    card: ModelCard,
    network: Json | None,
    vary: Callable[[Json | None], object],
) -> int:
    """The number of entries, each of which agrees with its digest and with what came before.

    network   what the rotor was created with
    vary      makes the model of another one, or raises what is wrong with it
    """
    adopted = Adopted(network)
    by_id = {blade.id: blade for blade in blades}
    seen: dict[str, str] = {}
    moved: set[tuple[str, str]] = set()
    count = 0
    for count, event in enumerate(read_events(file), 1):
        if (problem := body_problem(event)) is None and event.kind in KINDS:
            adopted, problem = _changed(adopted, event, vary)
        elif problem is None:
            problem = _unfit(event, by_id, seen, card)
        if event.seq != count:
            problem = f"it has number {event.seq}"
        if problem is not None:
            raise BundleError(file.path, f"log.jsonl, line {count}, {event.event_id}: {problem}")
        seen[event.event_id] = event.kind
        if event.kind in ("blade", "retirement"):
            moved.add((event.kind, event.blade or ""))
    told = {("blade", b.id) for b in blades if b.added_seq > 0}
    told |= {("retirement", b.id) for b in blades if b.retired_seq is not None}
    if told != moved or count != file.manifest.get("head_seq"):
        raise BundleError(file.path, "blades.jsonl or the manifest does not agree with the log")
    return count


def _changed(
    adopted: Adopted, event: Event, vary: Callable[[Json | None], object]
) -> tuple[Adopted, str | None]:
    """What is in the model after an entry that adopts or backs out, and why it cannot stand."""
    try:
        AdoptionBody.model_validate(json.loads(event.body))
        after = adopted.after(event)
        vary(after.network)
    except ValidationError as error:
        return adopted, f"its body cannot be read: {first_fault(error)}"
    except (*UNREADABLE, BladetwinError) as error:
        return adopted, f"{type(error).__name__}: {error}"
    return after, None


def _unfit(
    event: Event, blades: dict[str, BladeRecord], seen: dict[str, str], card: ModelCard
) -> str | None:
    """Why an entry cannot stand where it does; None: it can."""
    if event.event_id in seen:
        return "an entry before it has the same id"
    if event.kind == "retraction":
        return None if seen.get(event.replaces or "") == "inspection" else "it retracts nothing"
    blade = blades.get(event.blade or "")
    if blade is None:
        return f"its blade, {event.blade!r}, is not in blades.jsonl"
    if event.kind == "blade":
        same = blade.added_seq == event.seq and digest_of_blade(blade) == event.digest
        return None if same else "blades.jsonl says something else of the blade"
    if event.kind == "retirement":
        return None if blade.retired_seq == event.seq else "blades.jsonl says otherwise"
    if blade.added_seq > event.seq:
        return f"its blade joined later, with entry {blade.added_seq}"
    try:
        body = json.loads(event.body)
        ReadingBody.model_validate(body)
        NamedLine(id=body["id"])
        check(Inspection.from_json(body), card.network, card)
    except ValidationError as error:
        return f"its body cannot be read: {first_fault(error)}"
    except InputError as error:
        return str(error)
    return None
