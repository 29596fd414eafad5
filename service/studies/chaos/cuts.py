"""Faults of the database: away, cut off, locked by another process, full; and of its clock."""

from __future__ import annotations

import multiprocessing
import resource
import signal
import sqlite3
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from sqlalchemy import event

from service.errors import LostLeaseError, StoreAwayError
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from service.studies.chaos import chaos, traffic
from service.studies.chaos.bench import LEASE_S, Bench
from service.studies.chaos.clock import Clock
from service.studies.chaos.postgres import Server
from service.worker import claiming

Progress = Callable[[int], None]
LOCKED_S = 33.0  # SQLite's writers wait 30 s
PAUSE_S = 0.5
HOUR = 3600.0


def under_load(url: str, trials: int, seed: int, disturb: Callable[[], str]) -> Sequence[str]:
    """Something is done to the database `trials` times while clients post and workers apply."""
    plan = chaos.Plan(traffic.make(5, 40 * trials, 6, seed), trials, 6, seed, settle_s=180.0)

    def done(_processes: object) -> str:
        what = disturb()
        time.sleep(PAUSE_S)
        return what

    found, ledger, facts = chaos.disturbed(plan, url, lambda n: None, disturb=done)
    with tempfile.TemporaryDirectory(prefix="bladetwin-calm-") as folder:
        calm = chaos.undisturbed(plan, f"sqlite:///{Path(folder) / 'calm.db'}")
    told = chaos.verdict(found, ledger, calm)
    outcome = "all acknowledged, applied once, sealed as undisturbed"
    if not told["passed"]:
        outcome = f"NOT WHOLE: {found.to_json()}, {ledger.breaches[:5]}"
    answers = ", ".join(f"{n} × {what}" for what, n in sorted(ledger.answers.items()))
    return [f"{outcome} ({answers})"] * sum(facts["kills"].values())


def cut_off(server: Server) -> str:
    """Every connection is ended by the server."""
    server.run(
        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
        "WHERE backend_type = 'client backend' AND pid <> pg_backend_pid()"
    )
    return "cut off"


def crash(server: Server) -> str:
    """The server ends at once, as after a crash, and recovers."""
    server.stop(signal.SIGQUIT)
    time.sleep(0.3)
    server.start()
    return "crashed"


def locked(bench: Bench, trials: int, progress: Progress) -> Sequence[str]:
    """Another process holds SQLite's write lock for longer than the busy timeout, on as many
    databases at once."""
    folder = Path(bench.url.removeprefix("sqlite:///")).parent
    benches = [Bench(f"sqlite:///{folder / f'locked-{n}.db'}", bench.seed) for n in range(trials)]
    for one in benches:
        one.rotor("r1")
    context = multiprocessing.get_context("forkserver")
    ready, files = context.Event(), [one.url.removeprefix("sqlite:///") for one in benches]
    holder = context.Process(target=_hold, args=(files, LOCKED_S, ready))
    holder.start()
    ready.wait(60)
    told: dict[int, str] = {}

    def attempt(number: int) -> None:
        one = benches[number]
        told[number] = "a post was not refused"
        try:
            one.post("r1", "meanwhile")
        except StoreAwayError as error:
            told[number] = f"a post is told 503 ({error.cause}) after 30 s"
        progress(len(told))

    threads = [threading.Thread(target=attempt, args=(n,)) for n in range(trials)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    holder.join()
    outcomes = []
    for number, one in enumerate(benches):
        one.post("r1", "meanwhile")
        one.settle()
        faults = one.check().faults
        whole = "acknowledged when sent again" if not faults else f"NOT WHOLE: {faults}"
        outcomes.append(f"{told[number]}, {whole}")
        one.close()
    return outcomes


def _hold(files: Sequence[str], seconds: float, ready: Any) -> None:
    connections = [sqlite3.connect(file, isolation_level=None) for file in files]
    for connection in connections:
        connection.execute("BEGIN IMMEDIATE")
    ready.set()
    time.sleep(seconds)


def disk_full(bench: Bench, number: int) -> str:
    """SQLite may not take another page: what it says of a full disk (SQLITE_FULL)."""
    rotor = bench.rotor(f"r{number}")
    engine = open_engine(bench.url)
    room = bench.chosen.randrange(0, 6)

    def limit(connection: Any, record: Any) -> None:
        pages = connection.execute("PRAGMA page_count").fetchone()[0]
        connection.execute(f"PRAGMA max_page_count = {pages + room}")

    event.listen(engine, "connect", limit)
    full = SqlStore(engine)
    posted, refused = 0, ""
    for i in range(2000):
        try:
            bench.post(rotor, f"more{i}", full)
            posted += 1
        except StoreAwayError as error:
            refused = f"503 ({getattr(error.__cause__, 'orig', error)})"
            break
    try:
        bench.worker("on-full-disk", full).drain()
        worked = "the worker still had room"
    except StoreAwayError:
        worked = "the worker waits"
    full.close()
    bench.post(rotor, f"more{posted}")
    bench.settle()
    return f"posts until full, then {refused}; {worked}; goes on when there is room"


def file_too_large(bench: Bench, number: int) -> str:
    """The file system refuses to write more (RLIMIT_FSIZE: EFBIG), in a process of its own."""
    rotor = bench.rotor(f"r{number}")
    context = multiprocessing.get_context("forkserver")
    mine, other = context.Pipe()
    room = bench.chosen.randrange(0, 200_000)
    process = context.Process(target=_write_until, args=(bench.url, bench.seed, rotor, room, other))
    process.start()
    other.close()
    told = None
    try:
        while True:
            said = mine.recv()
            if isinstance(said, tuple):
                bench.acknowledged[said[0]] = said[1]
            else:
                told = said
    except EOFError:
        pass
    process.join()
    bench.settle()
    return f"posts until the limit, then {told}; goes on when there is room"


def _write_until(url: str, seed: int, rotor: str, room: int, told: Any) -> None:
    bench = Bench(url, seed)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    file = url.removeprefix("sqlite:///")
    with closing(sqlite3.connect(file)) as connection:  # the WAL begins anew, and has to grow
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    size = Path(file).stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + room, resource.RLIM_INFINITY))
    try:
        for i in range(5000):
            bench.post(rotor, f"more{i}")
            told.send(((rotor, f"more{i}"), bench.acknowledged[rotor, f"more{i}"]))
        told.send("nothing was refused")
    except StoreAwayError as error:
        told.send(f"503 ({error.cause})")
    except Exception as error:
        told.send(f"UNFORESEEN {error!r}")


def clock_jumps(bench: Bench, number: int) -> str:
    """The clock jumps while a worker computes; it dies, or goes on as if nothing had been."""
    rotor = bench.rotor(f"r{number}")
    ahead = bench.chosen.choice([-24 * HOUR, -HOUR, -2.0, 2.0, HOUR, 24 * HOUR])
    dies = bench.chosen.random() < 0.5
    store = bench.open()
    clock = Clock(store.engine)
    updater = bench.worker("first", store).updater
    lease = claiming.claim(store.engine, "first", LEASE_S)
    assert lease is not None
    task = updater.read(lease)
    state = updater.compute(task, quick=True)
    clock.ahead = ahead
    other = bench.worker("other", store)
    begun = time.monotonic()
    while not other.updater.run_once() and dies and time.monotonic() - begun < 60:
        time.sleep(0.02)
    waited = time.monotonic() - begun
    if not dies:
        with suppress(LostLeaseError):
            updater.commit(lease, task, state, updater.change(task, state))
    other.drain()
    clock.ahead = 0.0
    bench.settle()
    bench.post(rotor, "after")
    bench.settle()
    store.close()
    way = "back" if ahead < 0 else "forward"
    end = "dead worker's rotor taken over" if dies else "the worker goes on"
    return f"set {way}: {end}" + ("" if waited < 10 * LEASE_S + 3 else f", LATE: {waited:.0f} s")
