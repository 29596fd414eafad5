"""A rotor comes from a file that another database wrote, entry for entry.

The file (`service.handlers.transfer_out`) holds what the posterior is a function of, not the
posterior: a worker computes it from the log, and its sealed state is bit-identical to the
original's. Under another id the rotor keeps the old one as its `origin`, by which its random
numbers are drawn.

Every line is held against the log's own digests before the one transaction that writes it all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from core.errors import InputError
from service import bundle
from service.digests import as_created, digest_of_rotor
from service.errors import ConflictError, NotFoundError
from service.handlers.transfer_bodies import ManifestBody
from service.handlers.transfer_lines import (
    CHUNK,
    NamedLine,
    RotorLine,
    checked_log,
    held,
    parsed,
    policy_of,
    read_blades,
    read_events,
)
from service.ports import (
    BladeRecord,
    Event,
    Json,
    ModelCard,
    RotorRecord,
    Science,
    Store,
    Transaction,
)


@dataclass(frozen=True, slots=True)
class Imported:
    """The rotor as it now stands; `new` is False where it had been there before."""

    rotor: RotorRecord
    blades: int
    entries: int
    state: Json | None
    new: bool

    def to_json(self) -> Json:
        return {
            "rotor": self.rotor.id,
            "origin": self.rotor.origin,
            "model": self.rotor.model_id,
            "model_version": self.rotor.model_version,
            "blades": self.blades,
            "entries": self.entries,
            "state": self.state,
            "new": self.new,
        }


def import_rotor(store: Store, science: Science, path: Path, as_id: str | None = None) -> Imported:
    """Write the rotor of a file; the same file again gives the same answer.

    as_id   its id here; default: the one it had
    Raises BundleError for a file that is damaged or contradicts itself, ConflictError where the id
    is taken by another rotor, InputError for a model that is not registered here.
    """
    with open(path, "rb") as handle:
        file = bundle.opened(path, handle)
        told = parsed(file, RotorLine, next(file.rows("rotor.json"), {}), "rotor.json")
        parsed(file, ManifestBody, file.manifest, "manifest.json")
        card = _registered(store, science, told)
        with held(file, "rotor.json: network"):
            varied = science.vary(card, told.network)
        blades = read_blades(file, told, varied)
        asked = lambda network: science.vary(card, network)  # noqa: E731
        count = checked_log(file, blades, varied, told.network, asked)
        name = told.id if as_id is None else _named(as_id)
        origin = told.origin or told.id
        asks = (told.particles, told.seed, told.network, told.adopt, told.diagnose)
        digest = digest_of_rotor(name, told.model, as_created(blades), *asks)
        record = RotorRecord(
            name,
            told.model,
            told.model_version,
            told.particles,
            told.seed,
            head_seq=count,
            digest=digest,
            created_at=told.created_at or 0.0,
            network=told.network,
            adopt=told.adopt,
            diagnose=told.diagnose,
            policy=None if told.policy is None else policy_of(name, told.policy),
            origin=None if origin == name else origin,
        )
        with store.write() as tx:
            new = tx.records.put_rotor(record, blades)
            if new:
                for chunk in _chunks(read_events(file)):
                    tx.log.restore(name, chunk)
            else:
                _same(tx, record, blades, read_events(file))
            stored = tx.records.rotor(name)
    return Imported(stored, len(blades), count, file.manifest.get("state"), new)


def _named(text: str) -> str:
    try:
        return NamedLine(id=text).id
    except ValidationError:
        remedy = "use letters, digits and . _ : @ + - (no slash, no space), at most 100"
        raise InputError("--as", text, "is no id", remedy) from None


def _registered(store: Store, science: Science, told: RotorLine) -> ModelCard:
    """The model's card, registered here if this release has that very version."""
    remedy = "run the release that has it, or set BLADETWIN_MODEL_DIR to the folder of that model"
    with store.read() as tx:
        try:
            card = tx.records.model(told.model, told.model_version)
        except NotFoundError:
            if told.model not in science.builtins:
                raise _absent(tx, told) from None
            card = science.builtin(told.model)
    if (card.version, card.digest) != (told.model_version, told.model_digest):
        problem = f"is not the model here, which is {card.version} ({card.digest[:12]}…)"
        asked = f"{told.model} {told.model_version} ({told.model_digest[:12]}…)"
        raise InputError("model of the file", asked, problem, remedy)
    with store.write() as tx:
        tx.records.put_model(card, {"builtin": card.id})
    return card


def _absent(tx: Transaction, told: RotorLine) -> InputError:
    """That a model of runs is not here, or in other versions only."""
    known = "register it first (`bladetwin model register`), or upload its runs"
    try:
        newest = tx.records.model(told.model).version
    except NotFoundError:
        problem = "is no built-in model, and none that is registered here"
        return InputError("model of the file", told.model, problem, known)
    asked, problem = f"{told.model} {told.model_version}", "is a version that is not registered "
    problem += f"here; the newest of that id is {newest}"
    return InputError("model of the file", asked, problem, known.replace("it", "that one", 1))


def _chunks(events: Iterable[Event]) -> Iterator[list[Event]]:
    going = iter(events)
    while chunk := list(islice(going, CHUNK)):
        yield chunk


def _same(
    tx: Transaction, record: RotorRecord, blades: list[BladeRecord], events: Iterable[Event]
) -> None:
    """ConflictError unless the rotor that is there begins with the file's."""
    stored = tx.records.rotor(record.id)
    remedy = "import it under another id, with --as"
    if (stored.digest, stored.origin) != (record.digest, record.origin):
        raise ConflictError("rotor", record.id, remedy)
    if stored.head_seq < record.head_seq:
        have = f"{record.id} (here {stored.head_seq} entries, in the file {record.head_seq})"
        raise ConflictError("rotor", have, remedy)
    key: Callable[[Event], tuple[Any, ...]] = lambda e: (e.seq, e.event_id, e.digest)  # noqa: E731
    for chunk in _chunks(events):
        there = tx.log.entries(record.id, chunk[0].seq - 1, chunk[-1].seq, CHUNK)
        if list(map(key, there)) != list(map(key, chunk)):
            raise ConflictError("rotor", record.id, remedy)
