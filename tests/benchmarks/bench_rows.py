"""A hundred rows of SQLite among threads: one by one, by `fetchall`, and gathered as one row.

    python tests/benchmarks/bench_rows.py [SECONDS]

A file of 100 rotors of 100 blades. Threads ask for the blades of rotors in turn, as an API's do;
beside them at times one more that only computes, as one that writes an answer does. Told are the
questions answered a second and the 99th percentile of one, each with the switch interval that
Python sets (5 ms) and with the API's. By hand one would write ``execute(query)`` or ``.all()``.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from sqlalchemy import Connection, Engine, bindparam, select

from service.bootstrap import make_science, make_store, prepare
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.processes import SWITCH_S
from service.settings import Settings
from service.store import tables as t
from service.store.engine import transaction
from service.store.gathered import Gathered
from service.store.records import BLADE

Ask = Callable[[Connection, str], object]
QUERY = select(*BLADE).where(t.blade.c.rotor_id == bindparam("rotor"))
GATHERED = Gathered(QUERY)
WAYS: dict[str, Ask] = {
    "one by one": lambda c, rotor: [tuple(row) for row in c.execute(QUERY, {"rotor": rotor})],
    "fetchall": lambda c, rotor: [tuple(row) for row in c.execute(QUERY, {"rotor": rotor}).all()],
    "gathered": lambda c, rotor: GATHERED.rows(c, {"rotor": rotor}),
}
COUNT = 100


def filled(folder: str) -> Engine:
    """A database with rotors and blades."""
    url = f"sqlite:///{Path(folder) / 'rows.db'}"
    settings = Settings.load({}, database_url=url, migrate="always", science="fake")
    store = make_store(settings)
    prepare(store, settings)
    register_builtins(store, make_science(settings, store))
    blades = [BladeRecord(f"B{b:03d}", time_h0=0.1 * b) for b in range(COUNT)]
    for number in range(COUNT):
        create_rotor(store, f"r{number}", "rotor-blade", blades, 64, 7)
    return store.engine


def measured(engine: Engine, ask: Ask, threads: int, computing: int, seconds: float) -> str:
    """Questions a second and their 99th percentile, ms."""
    took: list[list[float]] = [[] for _ in range(threads)]
    end = time.monotonic() + seconds

    def asking(number: int) -> None:
        turn = number
        while (begun := time.monotonic()) < end:
            with transaction(engine, write=False) as connection:
                ask(connection, f"r{(7 * turn) % COUNT}")
            took[number].append(time.monotonic() - begun)
            turn += threads

    def computes() -> None:
        while time.monotonic() < end:
            sum(range(1000))

    running = [threading.Thread(target=asking, args=(n,)) for n in range(threads)]
    running += [threading.Thread(target=computes) for _ in range(computing)]
    for one in running:
        one.start()
    for one in running:
        one.join()
    every = np.concatenate([np.array(one) for one in took])
    return f"{len(every) / seconds:8,.0f}/s {1e3 * np.percentile(every, 99):7.1f} ms"


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 3.0
    with TemporaryDirectory() as folder:
        engine = filled(folder)
        cases = [(threads, computing) for computing in (0, 1) for threads in (1, 8, 32)]
        heads = [f"{n} thread(s){' + 1 computing' if c else ''}" for n, c in cases]
        print(f"{'':26}" + "".join(f"{head:>28}" for head in heads))
        for name, ask in WAYS.items():
            for interval in (0.005, SWITCH_S):
                sys.setswitchinterval(interval)
                told = [measured(engine, ask, n, c, seconds) for n, c in cases]
                print(f"{name + f', {1e3 * interval:g} ms':26}" + "".join(f"{x:>28}" for x in told))
        engine.dispose()


if __name__ == "__main__":
    main()
