"""Versions of models, with the card of each and where it comes from.

A version's row never changes but for its `created_at`: of an id the newest version is the one that
new rotors get, and a rotor stays with the version that it was created with.
"""

from __future__ import annotations

import json
from functools import lru_cache

from sqlalchemy import Connection, bindparam, func, select, update

from core.errors import InputError
from service.errors import NotFoundError
from service.ports import Json, ModelCard
from service.store import tables as t
from service.store.engine import insert_new, now_s
from service.store.jobs import SqlJobs
from service.store.met import Met

# Nearly every request asks these: a statement is built and understood once.
_MODEL = (
    select(t.model.c.card)
    .where(t.model.c.id == bindparam("model"))
    .order_by(t.model.c.created_at.desc())
)
_VERSION = _MODEL.where(t.model.c.version == bindparam("version"))


TICK_S = 0.001  # SQLite's clock tells no less


class SqlModels(SqlJobs):
    """The models of one transaction, and its jobs.

    met   models and blades that this process has read
    """

    def __init__(self, connection: Connection, met: Met | None = None) -> None:
        super().__init__(connection)
        self._met = Met() if met is None else met

    def put_model(self, card: ModelCard, source: Json, *, newest: bool = False) -> None:
        """Make a version known; `newest`: the one that new rotors get, though it was known.

        Raises InputError where it was, with other families: these are no part of a version.
        """
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
            text = self._connection.execute(select(t.model.c.card).where(own)).scalar_one()
            if _card(text).network.families != card.network.families:
                raise InputError(
                    f"families of model {card.id}",
                    [f.name for f in card.network.families],
                    f"are others than those of its version {card.version}, which is the same in "
                    "all else, and a version that is there never changes",
                    "give the model another id, or its rotors' diagnoses these families",
                )
            self._connection.execute(update(t.model).where(own).values(created_at=now_s()))
        if newest:
            self._after_the_others(card)

    def _after_the_others(self, card: ModelCard) -> None:
        """Later than the other versions, though they were registered within the same tick."""
        c = t.model.c
        others = select(func.max(c.created_at)).where(c.id == card.id, c.version != card.version)
        latest = self._connection.execute(others).scalar()
        if latest is not None:
            tied = (c.id == card.id) & (c.version == card.version) & (c.created_at <= latest)
            later = update(t.model).where(tied).values(created_at=latest + TICK_S)
            self._connection.execute(later)

    def model_sources(self) -> list[tuple[ModelCard, Json]]:
        """Every version of every model, with where it comes from."""
        query = select(t.model.c.card, t.model.c.source).order_by(t.model.c.id, t.model.c.version)
        rows = self._connection.execute(query)
        return [(_card(row.card), json.loads(row.source)) for row in rows]

    def model(self, model_id: str, version: str | None = None) -> ModelCard:
        if version is None:
            text = self._connection.execute(_MODEL, {"model": model_id}).scalar()
        elif (known := self._met.card(model_id, version)) is not None:
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
        self._met.put_card(card)
        return card

    def models(self, after: str, limit: int) -> list[ModelCard]:
        ids = select(t.model.c.id).where(t.model.c.id > after).distinct().order_by(t.model.c.id)
        return [self.model(name) for name in self._connection.execute(ids.limit(limit)).scalars()]


@lru_cache(maxsize=64)
def _card(text: str) -> ModelCard:
    """Cards never change, and every read looks at one."""
    return ModelCard.from_json(json.loads(text))
