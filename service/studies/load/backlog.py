"""A backlog that waits before a worker starts, and how fast so many workers seal it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np

from core.errors import BladetwinError
from core.observation import Inspection
from service.environment import PREFIX
from service.ports import Json
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from service.studies.load import demand
from service.studies.load.run import Plan
from service.worker.supervise import same_code


def worked_off(plan: Plan, database_url: str, workers: int, entries: int, log: Path) -> Json:
    """Entries a second that a backlog is sealed at by so many worker processes.

    Every rotor has the same number of readings, waiting before a worker starts. The clock runs
    from the first version to the last seal, so that starting Python does not count.
    """
    from service.bootstrap import make_science, prepare
    from service.handlers.inspections import Item, post_inspections
    from service.handlers.models import register_builtins
    from service.handlers.rotors import create_rotor
    from service.ports import BladeRecord

    settings = plan.settings(database_url)
    store = SqlStore(open_engine(database_url))
    prepare(store, settings)
    register_builtins(store, make_science(settings, store))
    each = max(1, entries // plan.rotors)
    for number in range(plan.rotors):
        name = demand.rotor_name(number)
        blades = [BladeRecord(demand.blade_name(i)) for i in range(plan.blades)]
        create_rotor(store, name, "rotor-blade", blades, plan.particles, plan.seed)
        readings = [
            Inspection(
                f"i{i}", blades[i % plan.blades].id, "elongation", 1000.0 + i, np.array([0.1])
            )
            for i in range(each)
        ]
        post_inspections(store, name, [Item("", one) for one in readings])
    outside = {k: v for k, v in os.environ.items() if not k.startswith(PREFIX)}
    command = [sys.executable, "-P", "-m", "service.cli", "worker"]
    environ = same_code(outside | settings.environ())
    with log.open("ab") as out:
        children = [subprocess.Popen(command, env=environ, stderr=out) for _ in range(workers)]
        try:
            first, last = _versions(store, plan.rotors)
        finally:
            for child in children:
                child.send_signal(signal.SIGTERM)
            for child in children:
                with suppress(subprocess.TimeoutExpired):
                    child.wait(30)
                if child.poll() is None:
                    child.kill()
            store.close()
    seconds = max(last - first, 1e-9)
    return {
        "workers": workers,
        "entries": each * plan.rotors,
        "seconds": round(seconds, 2),
        "entries_per_s": round(each * plan.rotors / seconds, 1),
        "rotors_per_s": round(plan.rotors / seconds, 2),
    }


def _versions(store: SqlStore, rotors: int) -> tuple[float, float]:
    """When the first version was written and when the last rotor was sealed, by the database."""
    from sqlalchemy import func, select

    from service.store import tables as t

    end = time.monotonic() + 3600
    while time.monotonic() < end:
        with store.read() as tx:
            left = select(func.count()).select_from(t.cursor).where(t.cursor.c.dirty)
            if tx.connection.execute(left).scalar() == 0:
                when = select(func.min(t.outbox.c.at), func.max(t.outbox.c.at))
                first, last = tx.connection.execute(when).one()
                return float(first), float(last)
        time.sleep(0.2)
    raise BladetwinError(f"a backlog of {rotors} rotors was not worked off within an hour")
