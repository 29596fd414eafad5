"""API keys: made, listed, revoked, recognised."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from core.errors import InputError
from service import tokens
from service.access import SCOPES, Act, KeyRecord, Scope
from service.errors import FaultsError, NotFoundError
from service.ports import Store

NAME = re.compile(r"[^\x00-\x1f\x7f]{1,100}")
ROTOR = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:@+\-]{0,99}")
LONGEST_DAYS = 36_525.0


@dataclass(frozen=True, slots=True)
class Recognised:
    """What a token is: a usable key, or the reason why it is none (for the log alone)."""

    key: KeyRecord | None
    reason: str = ""


def create_key(
    store: Store,
    name: str,
    scopes: Sequence[str],
    rotors: Sequence[str] = (),
    days: float | None = None,
    act: Act | None = None,
) -> tuple[KeyRecord, str]:
    """A new key and its token, which is not kept and cannot be shown again.

    rotors   the only rotors that the key knows, there already or not; none: all
    days     after which it expires; None: never
    act      the command, for the audit trail

    Raises FaultsError, which names every fault.
    """
    faults: list[InputError] = []
    if not NAME.fullmatch(name):
        remedy = "say who uses it, in 1 … 100 characters"
        faults.append(InputError("name", name, "is no name for a key", remedy))
    if not scopes:
        remedy = f"give one or more of {', '.join(SCOPES)}"
        faults.append(InputError("scope", None, "is missing", remedy))
    faults += [
        InputError("scope", scope, "is no scope", f"use {', '.join(SCOPES)}")
        for scope in scopes
        if scope not in SCOPES
    ]
    faults += [
        InputError("rotor", rotor, "cannot be a rotor's id", "give an id as in POST /v1/rotors")
        for rotor in rotors
        if not ROTOR.fullmatch(rotor)
    ]
    if days is not None and not 0 < days <= LONGEST_DAYS:
        remedy = f"give more than 0 and at most {LONGEST_DAYS:g} days"
        faults.append(InputError("days", days, "is no time of life", remedy))
    if faults:
        raise FaultsError(faults)
    held: tuple[Scope, ...] = tuple(scope for scope in SCOPES if scope in scopes)
    only = tuple(sorted(set(rotors))) or None
    key_id, token = tokens.new_token()
    key = KeyRecord(key_id, name, tokens.digest(token), held, only, created_at=0.0)
    with _acting(store, act, key_id).write() as tx:
        return tx.keys.put(key, None if days is None else days * 86_400.0), token


def list_keys(store: Store) -> list[tuple[KeyRecord, str]]:
    """Every key and its status, the oldest first."""
    with store.read() as tx:
        keys, now = tx.keys.all()
    return [(key, key.status(now)) for key in keys]


def _acting(store: Store, act: Act | None, key_id: str) -> Store:
    """The store for a command about one key."""
    return store if act is None else store.acting_for(replace(act, path=f"{act.path} {key_id}"))


def revoke_key(store: Store, key_id: str, act: Act | None = None) -> tuple[KeyRecord, bool]:
    """The key is accepted no more, from the next request on; whether it was until now."""
    with _acting(store, act, key_id).write() as tx:
        revoked = tx.keys.revoke(key_id)
        found = tx.keys.find(key_id)
        if found is None:
            raise NotFoundError("key", key_id, "`bladetwin keys list` shows those that exist")
        return found[0], revoked


def recognise(store: Store, token: str) -> Recognised:
    """The usable key whose token this is.

    A digest is compared even where no key has the id, so that both take the same time.
    """
    key_id = tokens.id_of(token)
    if key_id is None:
        return Recognised(None, "has not the shape of a key")
    with store.read() as tx:
        found = tx.keys.find(key_id)
    if not tokens.matches(token, None if found is None else found[0].digest) or found is None:
        return Recognised(None, f"key {key_id} is not known, or its secret is another")
    key, now = found
    status = key.status(now)
    return Recognised(key) if status == "usable" else Recognised(None, f"key {key_id} is {status}")
