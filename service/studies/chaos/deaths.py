"""Faults of processes: killed at a named point, stopped beyond the lease, stopped in a commit."""

from __future__ import annotations

import os
import signal
import sqlite3
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial

import httpx
from sqlalchemy import select

from service.client import Client
from service.errors import StoreAwayError
from service.free_port import free_port
from service.ports import Json
from service.store import tables as t
from service.store.engine import transaction
from service.studies.chaos import traps
from service.studies.chaos.bench import LEASE_S, Bench
from service.studies.chaos.processes import Child, Kind, forked
from service.studies.chaos.traps import Point

DIES_WITHIN_S = 120.0
GRACE_S = 2.0  # asked of a takeover, beyond the lease
LONG_S = 10.0  # so that no other worker comes between the claim and the commit
NOWHERE = Point("executed", "nothing says this")


def begin(
    bench: Bench,
    kind: Kind,
    owner: str,
    point: Point,
    number: int,
    delay_s: float,
    lease_s: float = LEASE_S,
) -> Child:
    """Start a process with a trap."""
    settings = bench.settings.model_copy(update={"lease_s": lease_s})
    environ = {**os.environ, **settings.environ()}
    return forked(traps.main, point, number, delay_s)(kind, owner, environ)


def worker_dies(point: Point) -> Callable[[Bench, int], str]:
    """A worker kills itself there; another one takes over when the lease is over."""

    def trial(bench: Bench, number: int) -> str:
        bench.rotor(f"r{number}")
        child = begin(bench, "all", f"dying-{number}", point, signal.SIGKILL, 0.0)
        child.end(DIES_WITHIN_S)
        waited = bench.settle()
        bench.post(f"r{number}", "later")
        bench.settle()
        if waited < GRACE_S:
            return f"taken over within {GRACE_S:g} s"
        return f"taken over {'within' if waited < LEASE_S + GRACE_S else 'later than'} lease + 2 s"

    return trial


def api_dies(point: Point) -> Callable[[Bench, int], str]:
    """The API kills itself while it answers a post; the client sends the same again."""

    def trial(bench: Bench, number: int) -> str:
        rotor, port = bench.rotor(f"r{number}"), free_port()
        settings = bench.settings.model_copy(update={"port": port})
        start = forked(traps.main, point, signal.SIGKILL)
        child = start("api", "api", {**os.environ, **settings.environ()})
        reading = bench.reading("last")
        body: Json = {"id": "last", "blade": reading.blade, "quantity": "elongation"}
        body |= {"time_h": reading.time_h, "value": float(reading.values[0])}
        seen = "answered"
        with Client(f"http://127.0.0.1:{port}", timeout=DIES_WITHIN_S) as client:
            client.ready(DIES_WITHIN_S)
            try:
                client.post_inspections(rotor, [body])
            except httpx.TransportError:
                seen = "no answer"
        child.end(DIES_WITHIN_S)
        with bench.store.read() as tx:
            stored = tx.log.find(rotor, "last") is not None
        bench.post(rotor, "last")
        bench.settle()
        there = "stored" if stored else "not stored"
        return f"{seen}, {there}; acknowledged when sent again"

    return trial


def stopped_beyond_lease(
    bench: Bench, trials: int, progress: Callable[[int], None]
) -> Sequence[str]:
    """SIGSTOP while it computes, SIGCONT after another one has applied the same and more."""
    outcomes = []
    child = begin(bench, "all", "sleeper", NOWHERE, signal.SIGSTOP, 1.2 * LEASE_S)
    try:
        for number in range(trials):
            rotor = bench.rotor(f"r{number}")
            if not held(bench, rotor, "sleeper"):
                outcomes.append("was not held: the trial did not happen")
                continue
            time.sleep(bench.chosen.uniform(0.0, LEASE_S / 2))
            stop_outside_transaction(bench, child, rotor)
            bench.post(rotor, "meanwhile")
            waited = bench.settle()
            child.signal(signal.SIGCONT)
            time.sleep(1.3 * LEASE_S)
            bench.post(rotor, "after")
            bench.settle()
            outcomes.append("taken over; its commit came too late" if waited < 10 else "late")
            progress(number + 1)
    finally:
        child.signal(signal.SIGCONT)
        child.kill()
    return outcomes


def stop_outside_transaction(bench: Bench, child: Child, rotor: str) -> None:
    """SIGSTOP; not while it holds a lock that others wait for, which is another fault.

    It may run on for a moment after the signal, and take a lock that nobody had when it was asked
    for; so it is seen to stand still before.
    """
    while True:
        child.signal(signal.SIGSTOP)
        stopped(child)
        if not locks(bench, rotor):
            return
        child.signal(signal.SIGCONT)
        time.sleep(0.02)


def locks(bench: Bench, rotor: str) -> bool:
    """Whether somebody holds the rotor's rows, or SQLite's write lock."""
    if bench.sqlite:
        with closing(sqlite3.connect(bench.url.removeprefix("sqlite:///"), timeout=0.3)) as probe:
            try:
                probe.execute("BEGIN IMMEDIATE")
            except sqlite3.OperationalError:
                return True
        return False
    try:
        with transaction(bench.store.engine, write=True) as connection:
            for column in (t.rotor.c.id, t.cursor.c.rotor_id):
                row = select(column).where(column == rotor).with_for_update(nowait=True)
                connection.execute(row)
    except StoreAwayError:
        return True
    return False


def held(bench: Bench, rotor: str, owner: str) -> bool:
    end = time.monotonic() + DIES_WITHIN_S
    query = select(t.cursor.c.owner).where(t.cursor.c.rotor_id == rotor)
    while time.monotonic() < end:
        with bench.store.read() as tx:
            if tx.connection.execute(query).scalar() == owner:
                return True
        time.sleep(0.005)
    return False


def stopped_in_commit(bench: Bench, trials: int, progress: Callable[[int], None]) -> Sequence[str]:
    """SIGSTOP with the commit's locks held: who waits for whom, and for how long.

    PostgreSQL ends such a transaction, or tells those who wait (`service.store.engine`); the trials
    run side by side. SQLite's writers wait for SIGCONT, which comes after a second.
    """
    point = traps.WORKER["update, before COMMIT"]
    if not bench.sqlite:
        return _side_by_side(bench, trials, point, progress)
    outcomes = []
    for number in range(trials):
        rotor = bench.rotor(f"r{number}")
        child = begin(bench, "all", f"stopping-{number}", point, signal.SIGSTOP, 0.0)
        stopped(child)
        again = threading.Timer(1.0, partial(child.signal, signal.SIGCONT))
        again.start()
        begun = time.monotonic()
        bench.post(rotor, "meanwhile")
        waited = time.monotonic() - begun
        again.join()
        bench.settle()
        child.kill()
        outcomes.append(f"a post waited {'until SIGCONT' if waited > 0.5 else 'not at all'}")
        progress(number + 1)
    return outcomes


def _side_by_side(
    bench: Bench, trials: int, point: Point, progress: Callable[[int], None]
) -> Sequence[str]:
    rotors = [bench.rotor(f"r{number}") for number in range(trials)]
    children = [
        begin(bench, "all", f"stopping-{number}", point, signal.SIGSTOP, 0.0, LONG_S)
        for number in range(trials)
    ]
    told: dict[str, str] = {}

    def post(rotor: str) -> None:
        begun = time.monotonic()
        try:
            bench.post(rotor, "meanwhile")
        except StoreAwayError as error:
            told[rotor] = f"a post is told 503 ({error.cause}), acknowledged when sent again"
        else:
            waited = time.monotonic() - begun > 0.5
            told[rotor] = f"a post waited {'until the database ended it' if waited else 'not'}"
        progress(len(told))

    try:
        for child in children:
            stopped(child)
        threads = [threading.Thread(target=post, args=(rotor,)) for rotor in rotors]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for child in children:
            child.signal(signal.SIGCONT)
        time.sleep(2 * LEASE_S)
        for rotor in rotors:
            bench.post(rotor, "meanwhile")
        bench.settle()
    finally:
        for child in children:
            child.kill()
    return [told[rotor] for rotor in rotors]


def stopped(child: Child) -> None:
    """Wait until the process is stopped by its signal, every thread of it."""
    end = time.monotonic() + DIES_WITHIN_S
    while time.monotonic() < end:
        if child.states() == {"T"}:
            return
        time.sleep(0.01)
    raise TimeoutError(f"process {child.pid} did not come to its point")
