"""Rotors and blades; models by `service.store.models`, jobs by `service.store.jobs`."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, astuple
from functools import lru_cache
from typing import Any

from sqlalchemy import Result, Row, bindparam, insert, select, update

from service.digests import digest_of_policy
from service.errors import DamagedRotorError, NotFoundError
from service.ports import Adopt, BladeRecord, Diagnose, ModelCard, Policy, RotorRecord
from service.store import tables as t
from service.store.commits import notify
from service.store.engine import insert_new, now_s
from service.store.gathered import Gathered, InexactError, Told
from service.store.models import SqlModels

ROTOR = (
    *(column for column in t.rotor.c),
    *(t.cursor.c[n] for n in ("applied_seq", "version", "dirty", "attempts", "blocked")),
    *(t.cursor.c[n] for n in ("last_error", "last_error_event")),
)
ROTOR_NAMES = [column.name for column in ROTOR]
POLICY = ("adopt_now", "diagnose_now", "policy_at", "policy_digest")
FEW = 8  # names that are looked up by themselves
BLADE = [column for column in t.blade.c if column.name != "rotor_id"]
BLADE_NAMES = [column.name for column in BLADE]
# Nearly every request asks these: a statement is built and understood once.
_ROTOR = select(*ROTOR).join(t.cursor).where(t.rotor.c.id == bindparam("rotor"))
_STANDING = (
    select(*ROTOR, t.state.c.digest)
    .join(t.cursor)
    .outerjoin(
        t.state,
        (t.state.c.rotor_id == t.cursor.c.rotor_id) & (t.state.c.version == t.cursor.c.version),
    )
    .where(t.rotor.c.id == bindparam("rotor"))
)
_OF_ROTOR = t.blade.c.rotor_id == bindparam("rotor")
_BLADES = Gathered(select(*BLADE).where(_OF_ROTOR))
BLADES = {split: _BLADES.column(split) for split in (False, True)}
_SOME_BLADES = select(t.blade.c.id).where(
    _OF_ROTOR, t.blade.c.id.in_(bindparam("ids", expanding=True))
)
_COVERING = (
    select(t.rotor.c.model_id, t.rotor.c.model_version, t.blade.c.id)
    .outerjoin(
        t.blade,
        (t.blade.c.rotor_id == t.rotor.c.id) & t.blade.c.id.in_(bindparam("ids", expanding=True)),
    )
    .where(t.rotor.c.id == bindparam("rotor"))
)
_BLADE_IDS = Gathered(select(t.blade.c.id).where(_OF_ROTOR))
_ONE_BLADE = select(*BLADE).where(_OF_ROTOR, t.blade.c.id == bindparam("blade"))


class SqlRecords(SqlModels):
    """The `Records` of one transaction: rotors and blades, and with them models and jobs."""

    def put_rotor(self, rotor: RotorRecord, blades: Sequence[BladeRecord]) -> bool:
        """Write a new rotor with its blades and a dirty cursor; False: the id is taken.

        One whose `created_at` is 0 is created now.
        """
        own = [name for name in t.rotor.c.keys() if name not in POLICY]  # noqa: SIM118
        values = {name: getattr(rotor, name) for name in own} | _policy_row(rotor.policy)
        values |= {"created_at": rotor.created_at or now_s(), "network": _text(rotor.network)}
        if not insert_new(self._connection, t.rotor, values):
            return False
        self._connection.execute(
            insert(t.cursor).values(
                rotor_id=rotor.id,
                applied_seq=0,
                version=0,
                dirty=True,
                dirty_since=now_s(),
                fence=0,
                sealing=False,
                attempts=0,
                blocked=False,
            )
        )
        for blade in blades:
            self.put_blade(rotor.id, blade)
        notify(self._connection, "bladetwin_work")
        return True

    def put_policy(self, rotor_id: str, adopt: Adopt, diagnose: Diagnose) -> None:
        at = float(self._connection.execute(select(now_s())).scalar_one())
        digest = digest_of_policy(rotor_id, adopt, diagnose, at)
        row = update(t.rotor).where(t.rotor.c.id == rotor_id)
        self._connection.execute(row.values(_policy_row(Policy(adopt, diagnose, at, digest))))
        judged = update(t.residual).where(t.residual.c.rotor_id == rotor_id)
        self._connection.execute(judged.values(judged=0))
        notify(self._connection, "bladetwin_work")

    def rotor(self, rotor_id: str) -> RotorRecord:
        return rotor_of(found_of(rotor_id, self._connection.execute(_ROTOR, {"rotor": rotor_id})))

    def standing(self, rotor_id: str) -> tuple[RotorRecord, str | None]:
        row = found_of(rotor_id, self._connection.execute(_STANDING, {"rotor": rotor_id}))
        return rotor_of(row[:-1]), row[-1]

    def rotors(
        self, after: str, limit: int, only: Sequence[str] | None = None
    ) -> list[RotorRecord]:
        """Rotors by name after one name; `only` names those that may be listed."""
        query = select(*ROTOR).join(t.cursor).where(t.rotor.c.id > after).order_by(t.rotor.c.id)
        if only is not None:
            query = query.where(t.rotor.c.id.in_(only))
        return [rotor_of(row) for row in self._connection.execute(query.limit(limit))]

    def blades(self, rotor_id: str) -> list[BladeRecord]:
        """Blades by id in byte order: digests rest on it, and databases sort text differently."""
        return self.blades_of(rotor_id, _BLADES.told(self._connection, {"rotor": rotor_id}))

    def blades_of(self, rotor_id: str, told: Told) -> list[BladeRecord]:
        """The same, of whom a text of them (`BLADES`) was read before."""
        try:
            return list(_told_blades(rotor_id, told))
        except InexactError:
            return _sorted_blades(rotor_id, _BLADES.single(self._connection, {"rotor": rotor_id}))

    def blade_ids(self, rotor_id: str, among: Collection[str] | None = None) -> set[str]:
        """The rotor's blades by name; those `among` some, where these are given."""
        if among is not None and len(among) <= FEW:
            asked = {"rotor": rotor_id, "ids": sorted(among)}
            return set(self._connection.execute(_SOME_BLADES, asked).scalars())
        return {name for (name,) in _BLADE_IDS.rows(self._connection, {"rotor": rotor_id})}

    def covering(self, rotor_id: str, among: Collection[str]) -> tuple[ModelCard, set[str]]:
        """The card of the rotor's model, and which of these names are blades of the rotor."""
        if len(among) > FEW:
            rotor = self.rotor(rotor_id)
            blades = self.blade_ids(rotor_id, among)
            return self.model(rotor.model_id, rotor.model_version), blades
        asked = {"rotor": rotor_id, "ids": sorted(among)}
        rows = self._connection.execute(_COVERING, asked).all()
        if not rows:
            raise NotFoundError("rotor", rotor_id, "POST /v1/rotors creates it")
        blades = {row.id for row in rows if row.id is not None}
        card = self.model(rows[0].model_id, rows[0].model_version)
        self._met.put_blades(rotor_id, card, blades)
        return card, blades

    def blade(self, rotor_id: str, blade_id: str) -> BladeRecord | None:
        asked = {"rotor": rotor_id, "blade": blade_id}
        row = self._connection.execute(_ONE_BLADE, asked).one_or_none()
        return None if row is None else blade_of(rotor_id, tuple(row))

    def put_blade(self, rotor_id: str, blade: BladeRecord) -> None:
        values = asdict(blade) | {"rotor_id": rotor_id, "known": _text(blade.known)}
        self._connection.execute(insert(t.blade).values(values))

    def retire_blade(self, rotor_id: str, blade_id: str, seq: int) -> None:
        key = (t.blade.c.rotor_id == rotor_id) & (t.blade.c.id == blade_id)
        self._connection.execute(update(t.blade).where(key).values(retired_seq=seq))


def found_of(rotor_id: str, result: Result[Any]) -> Row[Any]:
    """The one row of a query for a rotor."""
    row = result.one_or_none()
    if row is None:
        raise NotFoundError("rotor", rotor_id, "POST /v1/rotors creates it")
    return row


def rotor_of(row: Sequence[Any]) -> RotorRecord:
    """A rotor of the values of `ROTOR`."""
    values = dict(zip(ROTOR_NAMES, row, strict=True))
    now = [values.pop(name) for name in POLICY]
    policy = None if now == [None] * len(POLICY) else Policy(*now)
    try:
        return RotorRecord(**values | {"network": _read(values["network"]), "policy": policy})
    except ValueError as error:
        problem = f"rotor {values['id']}: its row's network is no JSON: {error}"
        raise DamagedRotorError(values["id"], [problem]) from None


def _policy_row(policy: Policy | None) -> dict[str, Any]:
    told = (None,) * len(POLICY) if policy is None else astuple(policy)
    return dict(zip(POLICY, told, strict=True))


@lru_cache(maxsize=256)
def _told_blades(rotor_id: str, told: Told) -> tuple[BladeRecord, ...]:
    """(Reads of a rotor look at all of its blades, and those seldom change.)"""
    return tuple(_sorted_blades(rotor_id, _BLADES.read(told)))


def _sorted_blades(rotor_id: str, rows: Iterable[tuple[Any, ...]]) -> list[BladeRecord]:
    return sorted((blade_of(rotor_id, row) for row in rows), key=lambda blade: blade.id)


def blade_of(rotor_id: str, row: tuple[Any, ...]) -> BladeRecord:
    values = dict(zip(BLADE_NAMES, row, strict=True))
    try:
        return BladeRecord(**values | {"known": _read(values["known"])})
    except ValueError as error:
        problem = f"rotor {rotor_id}: blade {values['id']}: what its row knows is no JSON: {error}"
        raise DamagedRotorError(rotor_id, [problem]) from None


def _text(value: object) -> str | None:
    return None if value is None else json.dumps(value)


def _read(text: str | None) -> Any:
    return None if text is None else json.loads(text)
