"""A rotor asks for a diagnosis by itself: nobody has to look for the loop to be closed.

    ``diagnose: alarm``      when tests of its residuals alarm, and again when there is something
                             new to say:
        * a campaign, an instrument, a lot, a visit … alarms that did not under this model (a blade
          more beside them is none: under a model that lacks something they come one by one),
        * a quarter more readings count (`GROWN`): what could not be told apart then may be now,
        * the model is another one, something was adopted or backed out, and residuals alarm still
    ``diagnose: readings``   then, and with every quarter more readings though nothing alarms. What
                             fits well and forecasts badly (a coating that wears, fouling) does not
                             alarm: parameters imitate it, and a scan finds it all the same

A diagnosis takes minutes of a processor, so none is asked for with every version: a misfit that has
no name stays, and would be diagnosed after each reading.

While a diagnosis of the rotor is under way, whoever asked for it, nothing is asked; when it has
ended, and rests on the same readings, it was the answer. Otherwise it is judged anew: residuals are
looked at as they stand (`waiting`), so that none is missed for what went on when they came. Each
version is judged once (`residual.judged`), by one worker: under the rotor's lock. Where somebody
decides anew what the rotor asks for (`service.handlers.policy`), what stands is judged again.
Residuals under a model that was left since, for something was adopted or backed out, ask for
nothing: those of the version with the present model are on their way.

Every condition below is one function, so that a test can take it away and see the loss noticed.
"""

from __future__ import annotations

import json
import logging
from typing import Any

from sqlalchemy import ColumnElement, Row, exists, func, select, update

from core.errors import BladetwinError
from service.adopted import adopted_at
from service.handlers.diagnoses import KIND, ask_unasked
from service.ports import Json, Transaction
from service.store import tables as t
from service.store.engine import transaction
from service.store.jobs import UNFINISHED
from service.store.unit_of_work import SqlStore, SqlTransaction

log = logging.getLogger("bladetwin.worker")
r, j = t.residual.c, t.job.c
GROWN = 1.25  # times the readings
LOOKED_AT = 20  # diagnoses among which one may be the answer
SHOWN = 5


def waiting() -> ColumnElement[bool]:
    """Residuals are there, of a rotor that asks by itself, and this version was not judged yet."""
    policy = func.coalesce(t.rotor.c.diagnose_now, t.rotor.c.diagnose)
    asks = (policy == "alarm") & (r.alarms > 0) | (policy == "readings")
    return asks & r.body.is_not(None) & (r.judged < r.version)


def idle() -> ColumnElement[bool]:
    """No diagnosis of the rotor is queued or running."""
    own = (j.rotor_id == r.rotor_id, j.kind == KIND, j.status.in_(UNFINISHED))
    return ~exists().where(*own)


def alarming(body: Json) -> list[Json]:
    """The tests that alarm, the first in the tests' own order.

    >>> alarming({"tests": [{"grouping": "all", "value": "", "statistic": "mean", "alarm": True}]})
    [{'grouping': 'all', 'value': '', 'statistic': 'mean'}]
    """
    return [
        {name: one[name] for name in ("grouping", "value", "statistic")}
        for one in body["tests"]
        if one["alarm"]
    ]


def told(body: Json) -> Json:
    """What alarms, of how many readings, under which model.

    >>> test = {"grouping": "campaign", "value": "c2", "statistic": "mean", "alarm": True}
    >>> blade = test | {"grouping": "blade", "value": "B1"}
    >>> tests = [test, test | {"statistic": "variance"}, blade]
    >>> rests = {"version": 3, "model_digest": "a"}
    >>> now = told({"tests": tests, "visits": [{"readings": 9}] * 2, "rests_on": rests})
    >>> now["groups"], len(now["tests"]), now["readings"]
    ([['campaign', 'c2']], 3, 18)
    """
    rests, tests = body["rests_on"], alarming(body)
    groups = {(one["grouping"], one["value"]) for one in tests if one["grouping"] != "blade"}
    return {
        "version": rests["version"],
        "tests": tests,
        "groups": sorted(map(list, groups), key=str),
        "readings": sum(visit["readings"] for visit in body["visits"]),
        "model": rests["model_digest"],
    }


def new(now: Json, before: Json | None) -> bool:
    """Whether there is something to ask that was not asked before (`told`).

    >>> one = {"groups": [["campaign", "c2"]], "tests": [{}], "readings": 100, "model": "a"}
    >>> new(one, None), new(one, one), new(one | {"readings": 125}, one)
    (True, False, True)
    >>> new(one, one | {"groups": []}), new(one | {"groups": []}, one)
    (True, False)
    >>> new(one | {"model": "b"}, one), new(one | {"model": "b", "groups": [], "tests": []}, one)
    (True, False)
    """
    if before is None or now["readings"] >= GROWN * before["readings"]:
        return True
    more = [group for group in now["groups"] if group not in before["groups"]]
    return bool(more) or (bool(now["tests"]) and now["model"] != before["model"])


def remembered(now: Json, before: Json | None) -> Json:
    """What was asked so far: groups that alarmed under this model stay asked for.

    >>> one = {"groups": [["lot", "A"]], "readings": 9, "model": "a", "version": 1, "tests": []}
    >>> remembered(one | {"groups": [["campaign", "c2"]]}, one)
    {'groups': [['campaign', 'c2'], ['lot', 'A']], 'readings': 9, 'model': 'a'}
    """
    groups = list(now["groups"])
    if before is not None and before["model"] == now["model"]:
        groups += [group for group in before["groups"] if group not in groups]
    return {"groups": groups, "readings": now["readings"], "model": now["model"]}


def left(tx: Transaction, rotor_id: str, through: int) -> bool:
    """Whether the rotor's model is another one by now than that of an entry."""
    rotor = tx.records.rotor(rotor_id)
    return adopted_at(tx, rotor).count > adopted_at(tx, rotor, through).count


def answered(tx: Transaction, rotor_id: str, through: int) -> bool:
    """Whether a diagnosis is there that rests on these entries, or on more."""
    jobs = tx.records.jobs_of(rotor_id, KIND, None, LOOKED_AT)
    return any(job.status == "done" and job.request["through_seq"] >= through for job in jobs)


class Asking:
    """Asks for diagnoses, one rotor at a time."""

    def __init__(self, store: SqlStore) -> None:
        self.store = store

    def run_once(self) -> bool:
        """Judge the residuals of a rotor; False: none wait."""
        query = (
            select(r.rotor_id)
            .join(t.rotor, t.rotor.c.id == r.rotor_id)
            .where(waiting(), idle())
            .order_by(r.computed_at, r.rotor_id)
            .limit(1)
        )
        with transaction(self.store.engine, write=False) as connection:
            rotor_id = connection.execute(query).scalar()
        if rotor_id is None:
            return False
        with self.store.write() as tx:
            tx.log.lock(rotor_id)
            if (row := self.found(tx, rotor_id)) is None:
                return True
            values: Json = {"judged": row.version}
            try:
                values |= self.judge(tx, rotor_id, row)
            except (BladetwinError, ValueError, KeyError, TypeError) as error:
                # a damaged row ends no worker; the next version has another
                log.error("residuals of %s ask for nothing: %r", rotor_id, error)
            own = update(t.residual).where(r.rotor_id == rotor_id)
            tx.connection.execute(own.values(values))
        return True

    @staticmethod
    def found(tx: SqlTransaction, rotor_id: str) -> Row[Any, Any, Any] | None:
        """Residuals as they stand under the rotor's lock; None: somebody has judged them since."""
        query = select(r.version, r.body, r.asked).join(t.rotor, t.rotor.c.id == r.rotor_id)
        mine = query.where(r.rotor_id == rotor_id, waiting(), idle())
        return tx.connection.execute(mine).one_or_none()

    @staticmethod
    def judge(tx: SqlTransaction, rotor_id: str, row: Row[Any, Any, Any]) -> Json:
        """Ask, or leave it; what is to be kept of it."""
        body = json.loads(row.body)
        now, before = told(body), None if row.asked is None else json.loads(row.asked)
        through = int(body["rests_on"]["through_seq"])
        if not new(now, before) or left(tx, rotor_id, through):
            return {}
        if not answered(tx, rotor_id, through):
            because = {"version": now["version"], "readings": now["readings"]}
            because |= {"alarms": len(now["tests"]), "tests": now["tests"][:SHOWN]}
            job = ask_unasked(tx, rotor_id, through, because)
            log.info("diagnosis %s of %s: %d tests alarm", job.id, rotor_id, len(now["tests"]))
        return {"asked": json.dumps(remembered(now, before))}
