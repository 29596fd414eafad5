"""Models, jobs, rotors and blades."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import lru_cache
from typing import Any

from sqlalchemy import Connection, RowMapping, bindparam, insert, select, update
from sqlalchemy.dialects import postgresql, sqlite

from service import tracing
from service.errors import DamagedRotorError, NotFoundError
from service.ports import BladeRecord, JobRecord, Json, ModelCard, ResidualRecord, RotorRecord
from service.store import tables as t
from service.store.engine import now_s
from service.store.gathered import Gathered, InexactError, Told
from service.store.log import notify
from service.store.parts import json_parts

ROTOR = (
    *(column for column in t.rotor.c),
    *(t.cursor.c[n] for n in ("applied_seq", "version", "dirty", "attempts", "blocked")),
    *(t.cursor.c[n] for n in ("last_error", "last_error_event")),
)
ROTOR_NAMES = [column.name for column in ROTOR]
FEW = 8  # names that are looked up by themselves
MOST_CARDS = 64
UNFINISHED = ("queued", "running")
LISTED = ("verdict", "names")
BLADE = [column for column in t.blade.c if column.name != "rotor_id"]
BLADE_NAMES = [column.name for column in BLADE]
# Nearly every request asks these: a statement is built and understood once.
_ROTOR = select(*ROTOR).join(t.cursor).where(t.rotor.c.id == bindparam("rotor"))
_MODEL = (
    select(t.model.c.card)
    .where(t.model.c.id == bindparam("model"))
    .order_by(t.model.c.created_at.desc())
)
_VERSION = _MODEL.where(t.model.c.version == bindparam("version"))
_OF_ROTOR = t.blade.c.rotor_id == bindparam("rotor")
BLADES = Gathered(select(*BLADE).where(_OF_ROTOR))
_SOME_BLADES = select(t.blade.c.id).where(
    _OF_ROTOR, t.blade.c.id.in_(bindparam("ids", expanding=True))
)
_BLADE_IDS = Gathered(select(t.blade.c.id).where(_OF_ROTOR))
_ONE_BLADE = select(*BLADE).where(_OF_ROTOR, t.blade.c.id == bindparam("blade"))


def insert_new(connection: Connection, table: Any, values: Json) -> bool:
    """Insert a row unless its key is there; whether it was inserted."""
    dialect = sqlite if connection.dialect.name == "sqlite" else postgresql
    statement = dialect.insert(table).values(values).on_conflict_do_nothing()
    return connection.execute(statement.returning(table.c.id)).first() is not None


class SqlRecords:
    """The `Records` of one transaction.

    cards   versions of models that this process has met: they never change
    """

    def __init__(
        self, connection: Connection, cards: dict[tuple[str, str], ModelCard] | None = None
    ) -> None:
        self._connection = connection
        self._cards = {} if cards is None else cards

    def put_model(self, card: ModelCard, source: Json, *, newest: bool = False) -> None:
        """Make a version known; `newest`: the one that new rotors get, though it was known."""
        values = {
            "id": card.id,
            "version": card.version,
            "digest": card.digest,
            "source": json.dumps(source),
            "card": json.dumps(card.to_json()),
            "created_at": now_s(),
        }
        if not insert_new(self._connection, t.model, values) and newest:
            own = (t.model.c.id == card.id) & (t.model.c.version == card.version)
            self._connection.execute(update(t.model).where(own).values(created_at=now_s()))

    def model_sources(self) -> list[tuple[ModelCard, Json]]:
        """Every version of every model, with where it comes from."""
        query = select(t.model.c.card, t.model.c.source).order_by(t.model.c.id, t.model.c.version)
        rows = self._connection.execute(query)
        return [(_card(row.card), json.loads(row.source)) for row in rows]

    def model(self, model_id: str, version: str | None = None) -> ModelCard:
        if version is None:
            text = self._connection.execute(_MODEL, {"model": model_id}).scalar()
        elif (known := self._cards.get((model_id, version))) is not None:
            return known
        else:
            asked = {"model": model_id, "version": version}
            text = self._connection.execute(_VERSION, asked).scalar()
        if text is None and version is not None:
            remedy = f"GET /v1/models/{model_id} is the newest one, or GET /v1/models lists all"
            raise NotFoundError(f"model {model_id} of version", version, remedy)
        if text is None:
            raise NotFoundError("model", model_id, "GET /v1/models lists those that exist")
        card = _card(text)
        if len(self._cards) >= MOST_CARDS:
            self._cards.clear()
        self._cards[card.id, card.version] = card
        return card

    def models(self, after: str, limit: int) -> list[ModelCard]:
        ids = select(t.model.c.id).where(t.model.c.id > after).distinct().order_by(t.model.c.id)
        return [self.model(name) for name in self._connection.execute(ids.limit(limit)).scalars()]

    def put_job(
        self, job_id: str, kind: str, request: Json, rotor_id: str | None = None
    ) -> JobRecord:
        statement = insert(t.job).values(
            id=job_id,
            kind=kind,
            status="queued",
            request=json.dumps(request),
            attempts=0,
            fence=0,
            created_at=now_s(),
            rotor_id=rotor_id,
            traceparent=tracing.current(),
        )
        self._connection.execute(statement)
        notify(self._connection, "bladetwin_work")
        return self.job(job_id)

    def job(self, job_id: str) -> JobRecord:
        query = select(t.job).where(t.job.c.id == job_id)
        row = self._connection.execute(query).mappings().one_or_none()
        if row is None:
            raise NotFoundError("job", job_id, "use the id of the answer to the POST")
        return _job(row)

    def jobs_of(self, rotor_id: str, kind: str, before: str | None, limit: int) -> list[JobRecord]:
        """Jobs of a rotor whose ids lie below one, the greatest first; of a result `LISTED`."""
        columns = [column for column in t.job.c if column.name not in ("result", "kept")]
        query = select(*columns, json_parts(t.job.c.result, *LISTED).label("parts"))
        query = query.where(t.job.c.rotor_id == rotor_id, t.job.c.kind == kind)
        if before is not None:
            query = query.where(t.job.c.id < before)
        query = query.order_by(t.job.c.id.desc()).limit(limit)
        return [_listed(row) for row in self._connection.execute(query).mappings()]

    def unfinished(self, rotor_id: str, kind: str) -> list[JobRecord]:
        """Jobs of a rotor that are queued or running, the oldest first."""
        query = select(t.job).where(
            t.job.c.rotor_id == rotor_id, t.job.c.kind == kind, t.job.c.status.in_(UNFINISHED)
        )
        rows = self._connection.execute(query.order_by(t.job.c.id)).mappings()
        return [_job(row) for row in rows]

    def residuals(self, rotor_id: str) -> ResidualRecord:
        """What the diagnosing workers kept last."""
        r = t.residual.c
        query = select(r.version, r.body, r.alarms, r.computed_at, r.error)
        row = self._connection.execute(query.where(r.rotor_id == rotor_id)).one_or_none()
        if row is None:
            return ResidualRecord(0, None, 0, None, None)
        return ResidualRecord(**dict(row._mapping) | {"body": _read(row.body)})

    def cancel_job(self, job_id: str) -> None:
        """End a job that is queued or running; its worker's fence holds no longer."""
        own = (t.job.c.id == job_id) & t.job.c.status.in_(UNFINISHED)
        end = (
            update(t.job)
            .where(own)
            .values(
                status="cancelled",
                fence=t.job.c.fence + 1,
                owner=None,
                lease_until=None,
                kept=None,
                finished_at=now_s(),
            )
        )
        self._connection.execute(end)

    def put_rotor(self, rotor: RotorRecord, blades: Sequence[BladeRecord]) -> bool:
        """Write a new rotor with its blades and a dirty cursor; False: the id is taken.

        One whose `created_at` is 0 is created now.
        """
        values = {name: getattr(rotor, name) for name in t.rotor.c.keys()}  # noqa: SIM118
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

    def rotor(self, rotor_id: str) -> RotorRecord:
        row = self._connection.execute(_ROTOR, {"rotor": rotor_id}).one_or_none()
        if row is None:
            raise NotFoundError("rotor", rotor_id, "POST /v1/rotors creates it")
        return rotor_of(row._mapping)

    def rotors(
        self, after: str, limit: int, only: Sequence[str] | None = None
    ) -> list[RotorRecord]:
        """Rotors by name after one name; `only` names those that may be listed."""
        query = select(*ROTOR).join(t.cursor).where(t.rotor.c.id > after).order_by(t.rotor.c.id)
        if only is not None:
            query = query.where(t.rotor.c.id.in_(only))
        return [rotor_of(row._mapping) for row in self._connection.execute(query.limit(limit))]

    def blades(self, rotor_id: str) -> list[BladeRecord]:
        """Blades by id in byte order: digests rest on it, and databases sort text differently."""
        return self.told_blades(rotor_id, BLADES.told(self._connection, {"rotor": rotor_id}))

    def told_blades(self, rotor_id: str, told: Told) -> list[BladeRecord]:
        """The same where the text of `BLADES` was read with something else."""
        try:
            return list(_told_blades(rotor_id, told))
        except InexactError:
            return _sorted_blades(rotor_id, BLADES.single(self._connection, {"rotor": rotor_id}))

    def blade_ids(self, rotor_id: str, among: Collection[str] | None = None) -> set[str]:
        """The rotor's blades by name; those `among` some, where these are given."""
        if among is not None and len(among) <= FEW:
            asked = {"rotor": rotor_id, "ids": sorted(among)}
            return set(self._connection.execute(_SOME_BLADES, asked).scalars())
        return {name for (name,) in _BLADE_IDS.rows(self._connection, {"rotor": rotor_id})}

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


@lru_cache(maxsize=64)
def _card(text: str) -> ModelCard:
    """Cards never change, and every read looks at one."""
    return ModelCard.from_json(json.loads(text))


def _job(row: RowMapping | dict[str, Any]) -> JobRecord:
    return JobRecord(
        id=row["id"],
        kind=row["kind"],
        status=row["status"],
        request=json.loads(row["request"]),
        created_at=row["created_at"],
        result=_read(row["result"]),
        error=row["error"],
        attempts=row["attempts"],
        finished_at=row["finished_at"],
        rotor_id=row["rotor_id"],
        progress=_read(row["progress"]),
    )


def _listed(row: RowMapping) -> JobRecord:
    values = json.loads(row["parts"] or "[]")
    parts = dict(zip(LISTED, values, strict=False))
    told = parts if any(value is not None for value in values) else None
    return replace(_job({**row, "result": None}), result=told)


def rotor_of(row: Mapping[Any, Any]) -> RotorRecord:
    """The columns of `ROTOR`, whatever else is in the row."""
    try:
        network = _read(row["network"])
    except ValueError as error:
        problem = f"rotor {row['id']}: its row's network is no JSON: {error}"
        raise DamagedRotorError(row["id"], [problem]) from None
    return RotorRecord(**{name: row[name] for name in ROTOR_NAMES} | {"network": network})


@lru_cache(maxsize=256)
def _told_blades(rotor_id: str, told: Told) -> tuple[BladeRecord, ...]:
    """(Reads of a rotor look at all of its blades, and those seldom change.)"""
    return tuple(_sorted_blades(rotor_id, BLADES.read(told)))


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
