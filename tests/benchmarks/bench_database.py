"""What each transaction costs PostgreSQL, and on paper where one server of it saturates.

    python tests/benchmarks/bench_database.py [READINGS] [PARTICLES]

On a PostgreSQL of its own that commits durably (fsync, WAL): a rotor of 100 blades with PARTICLES
each and the blade physics. Of each kind of transaction the processor time of all of the server's
processes, the write-ahead log that it makes, and the processor time of the process that asks:

    post        one reading into the log
    apply       from the claim to the committed provisional state
    seal        what follows: the sealed state with every blade's particles
    read        a blade's prediction;  again: the same with its ETag, unchanged

On paper: n workers, each computing for `own` seconds and then in the database for `db` seconds of
one of its c processors, which others wait for. Simulated event by event with the measured times,
exponentially distributed about them (`closed`); the asymptote is the server's own limit, c / db.
A disk that takes `DISK_MIB_S` of write-ahead log is a limit beside it.
"""

from __future__ import annotations

import heapq
import sys
import time
from collections.abc import Callable
from pathlib import Path

import service.one_thread  # noqa: F401  before numpy, as every command does

# isort: split
import numpy as np
import psycopg

from service.bootstrap import make_science, make_store, make_worker, prepare
from service.handlers import reads
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.questions import question
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord, Which
from service.settings import Settings
from service.studies.chaos.postgres import Server
from tests.benchmarks.bench_update import NAMES, elongations

DURABLE = ("fsync=on", "synchronous_commit=on", "full_page_writes=on", "max_wal_size=4GB")
BUSY = 0.7
"""Share of a processor above which queues grow long."""
DISK_MIB_S = 500
Cost = tuple[float, float, float, float]


class Meter:
    """Server and client time, WAL and wall time between `start` and `stop`."""

    def __init__(self, folder: Path, url: str) -> None:
        self._folder = str(folder)
        self._probe = psycopg.connect(url.replace("+psycopg", ""), autocommit=True)
        self._mine = self._probe.info.backend_pid

    def _server_s(self) -> float:
        """Of the server's processes: the postmaster and its children, the probe's own left out."""
        pid = int((Path(self._folder) / "data" / "postmaster.pid").read_text().split()[0])
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        told = [
            Path(f"/proc/{one}/schedstat") for one in (pid, *children) if int(one) != self._mine
        ]
        return sum(int(one.read_text().split()[0]) for one in told if one.exists()) / 1e9

    def _wal(self) -> int:
        row = self._probe.execute("SELECT pg_current_wal_insert_lsn() - '0/0'::pg_lsn").fetchone()
        assert row is not None
        return int(row[0])

    def of(self, action: Callable[[], None], times: int) -> Cost:
        """Means of one action: server s, client s, wall s, WAL bytes."""
        before = (self._server_s(), time.process_time(), time.perf_counter(), self._wal())
        for _ in range(times):
            action()
        after = (self._server_s(), time.process_time(), time.perf_counter(), self._wal())
        server, client, wall, wal = ((b - a) / times for a, b in zip(before, after, strict=True))
        return server, client, wall, wal


def plus(first: Cost, second: Cost) -> Cost:
    return tuple(a + b for a, b in zip(first, second, strict=True))  # type: ignore[return-value]


def measured(readings: int, particles: int) -> dict[str, Cost]:
    """The table, by kind of transaction."""
    with Server(DURABLE) as server:
        server.run("CREATE DATABASE bench")
        settings = Settings.load(
            {}, database_url=server.url("bench"), migrate="always", seal_after_s=0.0
        )
        store = make_store(settings)
        prepare(store, settings)
        science = make_science(settings, store)
        register_builtins(store, science)
        create_rotor(store, "r", "rotor-blade", [BladeRecord(n) for n in NAMES], particles, 7)
        first = elongations(1)
        post_inspections(store, "r", [Item("", one) for one in first])
        worker = make_worker(store, science, settings)
        worker.drain()
        meter = Meter(server.folder, server.url("bench"))
        more = iter(elongations(2)[len(first) :][:readings])
        costs: dict[str, list[Cost]] = {"post": [], "apply": [], "seal": []}
        for one in more:
            item = Item("", one)
            costs["post"].append(
                meter.of(lambda item=item: post_inspections(store, "r", [item]), 1)
            )
            costs["apply"].append(meter.of(lambda: worker.updater.run_once(), 1))
            costs["seal"].append(meter.of(lambda: worker.drain(), 1))
        told = {name: tuple(np.mean(found, axis=0)) for name, found in costs.items()}

        def read() -> None:
            found = reads.basis(store, science, "r", Which(), NAMES[3])
            asked = question(found.card, "elongation", [8e3, 24e3, 5e4], None, 0.95)
            reads.predict(store, science, found, asked)

        told["read"] = meter.of(read, 10 * readings)
        told["read again"] = meter.of(
            lambda: reads.basis(store, science, "r", Which(), NAMES[3]), 25 * readings
        )
        store.close()
    return told  # type: ignore[return-value]


def closed(workers: int, own_s: float, db_s: float, processors: int, seed: int = 7) -> float:
    """Transactions a second of `workers` that compute and then ask a database that they share.

    >>> round(closed(1, 0.09, 0.01, 2), 0)  # nobody waits: 1 / 0.1 s
    10.0
    >>> 190 < closed(100, 0.09, 0.01, 2) < 202  # saturated: 2 / 0.01 s
    True
    """
    rng = np.random.default_rng(seed)
    ready = [(float(rng.exponential(own_s)), k) for k in range(workers)]
    free = [0.0] * processors
    heapq.heapify(ready)
    heapq.heapify(free)
    count, end = 20_000, 0.0
    for _ in range(count):
        at, worker = heapq.heappop(ready)
        begun = max(at, heapq.heappop(free))
        end = begun + float(rng.exponential(db_s))
        heapq.heappush(free, end)
        heapq.heappush(ready, (end + float(rng.exponential(own_s)), worker))
    return count / end


def main(readings: int, particles: int) -> None:
    costs = measured(readings, particles)
    print("| transaction | PostgreSQL, processor | WAL | asking process, processor | wall |")
    print("|---|--:|--:|--:|--:|")
    for name, (server, client, wall, wal) in costs.items():
        shown = f"{1e3 * server:.1f} ms | {wal / 1024:.0f} KiB | {1e3 * client:.1f} ms"
        print(f"| {name} | {shown} | {1e3 * wall:.1f} ms |")
    server, client, _, wal = plus(plus(costs["post"], costs["apply"]), costs["seal"])
    print(f"\na reading posted, applied and sealed: PostgreSQL {1e3 * server:.0f} ms and ")
    print(f"{wal / 2**20:.2f} MiB of WAL, workers and API {1e3 * client:.0f} ms")
    disk = DISK_MIB_S * 2**20 / wal
    print(f"a disk that takes {DISK_MIB_S} MiB/s of WAL: at most {disk:.0f} of them a second")
    for processors in (2, 8, 32):
        limit = min(processors / server, disk)
        day = 86_400 * BUSY * limit
        print(
            f"PostgreSQL of {processors} processors: at most {limit:.0f} readings a second, sealed "
            f"each on its own; {day / 1e6:.2f} million a day at {BUSY:.0%} load, with "
            f"{limit * BUSY * wal / 2**20:.0f} MiB/s of WAL and {limit * BUSY * client:.0f} "
            f"processors of workers; at a reading a blade a week {day * 7 / 100:,.0f} rotors of "
            "100 blades"
        )
        rates = ", ".join(
            f"{n}: {closed(n, client, server, processors):.1f}" for n in (1, 2, 4, 8, 16, 32, 64)
        )
        print(f"  readings a second by workers (simulated): {rates}")


if __name__ == "__main__":
    words = sys.argv[1:] + ["40", "10000"][len(sys.argv) - 1 :]
    main(int(words[0]), int(words[1]))
