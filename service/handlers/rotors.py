"""Rotors and their blades."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

from core.errors import InputError
from service.adopted import Adopted, adopted_at
from service.digests import digest_of_rotor
from service.errors import ConflictError, FaultsError, NotFoundError
from service.handlers.blades import blades_at
from service.handlers.no_longer import no_longer
from service.ports import (
    Adopt,
    BladeRecord,
    Diagnose,
    Json,
    ModelCard,
    RotorRecord,
    Science,
    StateRecord,
    Store,
    Transaction,
    Which,
)
from service.slots import faults_together
from service.variant import check_known

NEWEST = Which()


@dataclass(frozen=True, slots=True)
class RotorView:
    """A rotor as it stands: place in the log, blades, the newest posterior's record.

    adopted   the effects that are in the model of this posterior
    lost      of each diagnosis behind them the readings that it used and that count no longer
    """

    rotor: RotorRecord
    blades: tuple[BladeRecord, ...]
    state: StateRecord | None
    adopted: Adopted
    lost: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def has_applied(self, seq: int) -> bool:
        """Every entry up to `seq` counts in the newest posterior."""
        return has_applied(self.rotor, seq)


def has_applied(rotor: RotorRecord, seq: int) -> bool:
    """Every entry up to `seq` counts in the newest posterior."""
    return rotor.version > 0 and rotor.applied_seq >= seq


def find_rotor(store: Store, rotor_id: str) -> RotorRecord:
    """The rotor's row and where its cursor stands."""
    with store.read() as tx:
        return tx.records.rotor(rotor_id)


def check_network(store: Store, science: Science, model_id: str, network: Json | None) -> ModelCard:
    """The model's newest version; refuses a network that it cannot be varied to."""
    with store.read() as tx:
        card = _registered(tx, model_id, science.builtins)
    science.vary(card, network)
    return card


def _registered(tx: Transaction, model_id: str, builtins: Sequence[str] = ()) -> ModelCard:
    try:
        return tx.records.model(model_id)
    except NotFoundError as error:
        built_in = f'POST /v1/models {{"builtin": "{model_id}"}} registers it'
        remedy = built_in if model_id in builtins else error.remedy
        raise FaultsError([InputError("model", model_id, "is not registered", remedy)]) from None


def create_rotor(
    store: Store,
    rotor_id: str,
    model_id: str,
    blades: Sequence[BladeRecord],
    particles: int,
    seed: int,
    network: Json | None = None,
    adopt: Adopt = "never",
    card: ModelCard | None = None,
    diagnose: Diagnose = "never",
) -> tuple[RotorRecord, tuple[BladeRecord, ...], bool]:
    """A new rotor, or the one that is there with the same content; whether it is new.

    network   what it varies of the model's network
    adopt     whether a diagnosis that names an effect is adopted by itself
    card      the version that the network was checked against (`check_network`); None: the newest
    diagnose  whether a diagnosis is asked for by itself
    """
    names = [blade.id for blade in blades]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        fault = InputError("blades", twice, "are named twice", "give each blade its own id")
        raise FaultsError([fault])
    if found := faults_together(blades):
        raise FaultsError(found)
    ordered = tuple(sorted(blades, key=lambda blade: blade.id))
    asks = (particles, seed, network, adopt, diagnose)
    digest = digest_of_rotor(rotor_id, model_id, ordered, *asks)
    with store.write() as tx:
        card = _registered(tx, model_id) if card is None else card
        check_known(card.network, [(f"blades[{i}].", blade) for i, blade in enumerate(blades)])
        rotor = RotorRecord(
            rotor_id,
            model_id,
            card.version,
            particles,
            seed,
            head_seq=0,
            digest=digest,
            created_at=0.0,
            network=network,
            adopt=adopt,
            diagnose=diagnose,
        )
        new = tx.records.put_rotor(rotor, ordered)
        stored = tx.records.rotor(rotor_id)
    if not new and stored.digest != digest:
        raise ConflictError("rotor", rotor_id, "choose a new id")
    return stored, ordered, new


def created_before(
    store: Store,
    rotor_id: str,
    model_id: str,
    blades: Sequence[BladeRecord],
    particles: int | None,
    seed: int,
    network: Json | None,
    adopt: Adopt,
    diagnose: Diagnose = "never",
) -> tuple[RotorRecord, tuple[BladeRecord, ...], bool] | None:
    """What `create_rotor` gives again for a rotor that is there, whatever models and settings have
    come since; None: there is none of this content. The request is judged (If-Match) and noted in
    the audit trail as one that creates is.

    particles   None: left to the service, which may have another number now
    """
    try:
        with store.read() as tx:
            stored = tx.records.rotor(rotor_id)
    except NotFoundError:
        return None
    ordered = tuple(sorted(blades, key=lambda blade: blade.id))
    count = stored.particles if particles is None else particles
    asks = (count, seed, network, adopt, diagnose)
    digest = digest_of_rotor(rotor_id, model_id, ordered, *asks)
    if digest != stored.digest:
        return None
    with store.write():
        return stored, ordered, False


def view_rotor(store: Store, rotor_id: str, which: Which = NEWEST) -> RotorView:
    """The rotor as it stands, with the blades and the posterior of the version asked for.

    DamagedRotorError: it is not what was written; a blocked one says by itself why it is.
    """
    with reading(store, rotor_id, which) as tx:
        if which.newest:
            return view_in(tx, rotor_id, checked=True)
        seen = tx.seen(rotor_id)
        seen.check()
        state = state_of(tx, rotor_id, which)
        adopted = adopted_at(tx, seen.rotor, state.through_seq, seen.changes)
        lost = _lost(tx, rotor_id, adopted, state.through_seq)
    blades = tuple(blades_at(seen.blades, state.through_seq))
    return RotorView(seen.rotor, blades, state, adopted, lost)


def view_in(tx: Transaction, rotor_id: str, *, checked: bool = False) -> RotorView:
    """The rotor as this transaction sees it; `checked`: a damaged one that is not blocked is
    refused."""
    seen = tx.seen(rotor_id)
    rotor = seen.rotor
    state = seen.state() if rotor.version else None
    through = 0 if state is None else state.through_seq
    adopted = adopted_at(tx, rotor, through, seen.changes)
    lost = _lost(tx, rotor_id, adopted, through)
    view = RotorView(rotor, seen.blades, state, adopted, lost)
    if checked and not rotor.blocked:
        seen.check()
    return view


def _lost(tx: Transaction, rotor_id: str, adopted: Adopted, head: int) -> dict[str, list[str]]:
    """Of each diagnosis in force the readings that count no longer as of an entry."""
    return {
        sheet.diagnosis: no_longer(tx, rotor_id, sheet.through, head) for sheet in adopted.sheets
    }


def reading(store: Store, rotor_id: str, which: Which) -> AbstractContextManager[Transaction]:
    """The transaction in which `state_of` finds the version asked for."""
    return store.read() if which.at is None else store.read_as_of(rotor_id, which.at)


def state_of(tx: Transaction, rotor_id: str, which: Which) -> StateRecord:
    """The version asked for."""
    if which.at is not None:
        return tx.states.as_of(rotor_id, which.at)
    return tx.states.get(rotor_id, which.version)


def list_rotors(
    store: Store, after: str, limit: int, only: Sequence[str] | None = None
) -> list[tuple[RotorRecord, tuple[bool, Json] | None]]:
    """Rotors in the order of their names, after one name, each with whether its newest version is
    sealed and that version's account; `only` names those that may be seen."""
    with store.read() as tx:
        rotors = tx.records.rotors(after, limit, only)
        told = tx.states.standing([rotor.id for rotor in rotors])
    return [(rotor, told.get(rotor.id)) for rotor in rotors]


def retry(store: Store, rotor_id: str) -> RotorRecord:
    """Let a blocked rotor be tried again."""
    with store.write() as tx:
        tx.log.free(rotor_id)
        return tx.records.rotor(rotor_id)
