"""A rotor's posterior made again from the log alone, to mend it.

`repair` mends what `service.store.audit` found by what the log gives (`service.worker.replay`),
under a lease like any update: entries that come meanwhile wait, and a worker at work is never
passed by.

    a sealed version          its rows are written again, where the replay has its digest
    another older version     is dropped, and answers like one that was thinned out
    another newest version    the rotor gets one more version, sealed, with all arrays written
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select, update

from service.errors import DamagedRotorError, HeldError
from service.ports import Json
from service.store import tables as t
from service.store.audit import Finding, array_problem, array_row, audit_source
from service.store.encoding import Encoded
from service.store.engine import snapshot, transaction
from service.store.kept import stored
from service.store.named import digests
from service.store.unit_of_work import SqlStore
from service.store.versions import ENDED, thin
from service.worker import claiming
from service.worker import lease as leases
from service.worker.lease import Lease
from service.worker.replay import Replayed, from_log
from service.worker.task import anew
from service.worker.update import Updater


@dataclass(frozen=True, slots=True)
class Repair:
    """What a repair did: versions written again, dropped, and the new version if one was made."""

    rotor: str
    restored: tuple[int, ...]
    dropped: tuple[int, ...]
    version: int | None

    def to_json(self) -> Json:
        return asdict(self)


def repair(
    updater: Updater, rotor_id: str, findings: Sequence[Finding], *, renew: bool = False
) -> Repair:
    """Mend the versions that the findings name; `renew`: make the newest again in any case.

    DamagedRotorError: the log, the rotor's row or a blade's is damaged. HeldError: a worker holds
    the rotor. LostLeaseError: somebody took it meanwhile.
    """
    engine = updater.engine
    with snapshot(engine) as connection:
        _, lost = audit_source(connection, rotor_id)
    if lost:
        raise DamagedRotorError(rotor_id, [str(one) for one in lost])
    lease = claiming.claim_rotor(engine, rotor_id, updater.owner, updater.settings.lease_s)
    if lease is None:
        with transaction(engine, write=False) as connection:
            query = select(t.cursor.c.owner).where(t.cursor.c.rotor_id == rotor_id)
            raise HeldError(rotor_id, connection.execute(query).scalar())
    restored: list[int] = []
    dropped: list[int] = []
    task = state = version = None
    try:
        with updater.heartbeats(lease):
            bad = _touched(updater.store, lease, findings)
            for number, row in sorted(bad.items()):
                if row is not None and _restore(updater, lease, row):
                    restored.append(number)
                elif row is not None:
                    dropped.append(number)
            if renew or (lease.version in bad and lease.version not in restored):
                task = anew(updater.store, updater.science, lease)
                state = updater.compute(task, quick=False)
        if task is not None and state is not None:
            version = updater.commit(lease, task, state, updater.change(task, state))
        _drop(updater, rotor_id, dropped)
    finally:
        leases.give_back(engine, lease)
    return Repair(rotor_id, tuple(restored), tuple(dropped), version)


def _touched(
    store: SqlStore, lease: Lease, findings: Sequence[Finding]
) -> dict[int, Row[Any] | None]:
    """The kept versions that have a damaged part; None: the row of the newest is gone."""
    with snapshot(store.engine) as connection:
        rows = connection.execute(stored(lease.rotor_id).order_by(t.state.c.version)).all()
        a = t.state_array.c
        keys = connection.execute(
            select(a.name, a.version).where(a.rotor_id == lease.rotor_id)
        ).all()
    own = [f for f in findings if f.rotor == lease.rotor_id]
    bad = {int(f.name) for f in own if f.part == "state"}
    for finding in (f for f in own if f.part == "array" and f.version is not None):
        later = [k.version for k in keys if k.name == finding.name and k.version > finding.version]
        until = min(later, default=2**62)
        bad |= {row.version for row in rows if finding.version <= row.version < until}
    there: dict[int, Row[Any] | None] = {row.version: row for row in rows if row.version in bad}
    if lease.version in bad:
        there.setdefault(lease.version, None)
    return there


def _restore(updater: Updater, lease: Lease, row: Row[Any]) -> bool:
    """Write a sealed version's rows again; False: the log does not give that version any more."""
    if not (row.sealed or '"sealed": true' in row.meta):
        return False
    through = lease.applied_seq if row.version == lease.version else row.through_seq
    made = from_log(updater.store, updater.science, row.rotor_id, through)
    with transaction(updater.engine, write=True) as connection:
        leases.keep(connection, lease)
        names = digests(connection, row.rotor_id, row.version)
        if row.digest != made.digest and names != made.sha256:
            return False
        values = {"digest": made.digest, "meta": made.meta, "through_seq": through}
        values |= {name: made.meta[name] for name in ("events_digest", "algorithm_version")}
        _write(connection, row, made, values)
    return True


def _write(connection: Connection, row: Row[Any], made: Replayed, values: Json) -> None:
    key = (t.state.c.rotor_id == row.rotor_id) & (t.state.c.version == row.version)
    text = json.dumps(values["meta"])
    connection.execute(update(t.state).where(key).values(**values | {"meta": text, "sealed": True}))
    a = t.state_array.c
    ended = digests(connection, row.rotor_id, row.version).keys() - made.arrays.keys()
    wanted: dict[str, Encoded] = {**made.arrays, **dict.fromkeys(ended, ENDED)}
    for name, one in wanted.items():
        latest = (
            select(a.version)
            .where(a.rotor_id == row.rotor_id, a.name == name, a.version <= row.version)
            .order_by(a.version.desc())
            .limit(1)
        )
        version = connection.execute(latest).scalar()
        place = row.version
        if version is not None:
            there = array_row(connection, row.rotor_id, name, version)
            if there.sha256 == one.sha256:
                if array_problem(there) is None:
                    continue
                place = version
        own = (a.rotor_id == row.rotor_id) & (a.name == name) & (a.version == place)
        connection.execute(delete(t.state_array).where(own))
        key_of = {"rotor_id": row.rotor_id, "name": name, "version": place}
        connection.execute(insert(t.state_array).values(key_of | asdict(one)))


def _drop(updater: Updater, rotor_id: str, versions: Sequence[int]) -> None:
    """Take older versions that cannot be made again out, and the arrays that only they used."""
    if not versions:
        return
    newest = select(t.cursor.c.version).where(t.cursor.c.rotor_id == rotor_id).scalar_subquery()
    own = (t.state.c.rotor_id == rotor_id) & t.state.c.version.in_(versions)
    with transaction(updater.engine, write=True) as connection:
        connection.execute(delete(t.state).where(own, t.state.c.version < newest))
    settings = updater.settings
    thin(updater.engine, rotor_id, settings.keep_versions, settings.checkpoint_every)
