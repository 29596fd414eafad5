"""The processes of a service: the API, further ones that answer beside it, workers by role.

`serve` is the first API process and starts all others, as its children. With
``BLADETWIN_API_PROCESSES`` above 1 further ones answer at the same port (`service.api.sockets`):
what a Python process can compute at a time is one processor's, and requests that wait behind one
another are what a slow 99th percentile is made of. Each has its own caches; what has to be one
(versions, keys, the log) is the database's. Rates are counted by each (`service.api.rate`).
"""

from __future__ import annotations

import os
import signal
import socket
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from types import FrameType
from typing import TYPE_CHECKING, Any, Literal, cast

from service import tracing
from service.arenas import give_back, share_arenas
from service.bootstrap import (
    Later,
    check_keys,
    make_app,
    make_deliverer,
    make_science,
    make_store,
    make_worker,
    prepare,
)
from service.handlers.models import register_builtins
from service.pauses import set_aside
from service.ports import Science
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from service.telemetry import configure_logs
from service.worker.claiming import Role
from service.worker.loop import end_with_parent, owner_name, run_worker
from service.worker.supervise import Supervisor

if TYPE_CHECKING:
    from service.api.server import Server
    from service.api.together import Together

PYTHON = [sys.executable, "-P", "-m", "service.cli"]


def worker_command(owner: str, role: Role) -> list[str]:
    """The command line of a worker that ends with its parent."""
    return [*PYTHON, "worker", "--role", role, "--owner", owner, "--end-with-parent"]


def worker_roles(settings: Settings) -> list[Role]:
    """What each worker of `serve` does: without sealers every worker applies and seals.

    Without workers `serve` is the API alone.
    """
    if settings.workers == 0:
        return []
    senders = settings.deliverers if settings.webhook_key_file else 0
    deliver: list[Role] = ["deliver"] * senders
    diagnose: list[Role] = ["diagnose"] * settings.diagnosers
    if settings.sealers == 0:
        both: list[Role] = ["all"] * settings.workers
        return both + diagnose + deliver
    apply: list[Role] = ["apply"] * settings.workers
    seal: list[Role] = ["seal"] * settings.sealers
    return apply + seal + diagnose + deliver


def api_command(place: int, counts: Sequence[int], owner: str, role: Literal["api"]) -> list[str]:
    """The command line of a further API process, which ends with its parent.

    counts   descriptors of the counts of every place
    """
    told = ",".join(map(str, counts))
    return [*PYTHON, role, "--place", str(place), "--counts", told, "--owner", owner]


def serve(settings: Settings, opened: Callable[[], None] | None = None) -> None:
    """API and workers until SIGTERM or SIGINT; returns when all have ended.

    opened   called as soon as requests are answered
    """
    _begin(settings, "api", owner_name())
    with ExitStack() as ends:
        ends.callback(tracing.end)
        listening = _listening(settings, ends)
        shared = listening[0] if settings.api_processes > 1 else None
        store = make_store(settings)
        ends.callback(store.close)
        science = make_science(settings, store)
        prepare(store, settings)
        check_keys(store, settings)
        register_builtins(store, science)
        peers, together = _peers(store, settings, shared, ends)
        server = _server(store, science, settings, together)

        def begin_stop() -> None:
            for peer in peers:
                peer.begin_stop()

        server.opened, server.closing = opened, begin_stop
        roles = worker_roles(settings)
        workers = Supervisor(store.engine, roles, worker_command, settings.environ())
        everybody: list[Supervisor[Any]] = [workers, *peers]
        for supervisor in everybody:
            ends.callback(supervisor.stop)
            supervisor.start()
        _answer(server, listening)


def answer(
    settings: Settings, *, place: int, listening: int, counts: Sequence[int], owner: str | None
) -> None:
    """A further API process, on a socket and over a store that `serve` has prepared."""
    end_with_parent()
    _begin(settings, "api", owner or owner_name())
    from service.api.together import Together

    with ExitStack() as ends:
        ends.callback(tracing.end)
        own = ends.enter_context(socket.socket(fileno=listening))
        store = make_store(settings)
        ends.callback(store.close)
        science = make_science(settings, store)
        _answer(_server(store, science, settings, Together(counts, place)), [own])


def _begin(settings: Settings, role: str, owner: str) -> None:
    share_arenas()
    give_back()
    configure_logs(settings.log_level)
    tracing.begin(settings, role, owner)


def _server(
    store: SqlStore, science: Science, settings: Settings, together: Together | None
) -> Server:
    """The server, which a signal ends as soon as it has begun: one may come before uvicorn listens
    for them. (uvicorn raises it again when it has ended; the workers are still to be stopped.)"""
    from service.api.server import server as make_server

    server = make_server(make_app(store, science, settings, together), settings)

    def stop(signum: int, frame: FrameType | None) -> None:
        server.should_exit = True

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    return server


def _answer(server: Server, listening: list[socket.socket]) -> None:
    set_aside()
    sys.setswitchinterval(SWITCH_S)
    server.run(listening)


def _listening(settings: Settings, ends: ExitStack) -> list[socket.socket]:
    """The sockets of this process; where it is one of several it has one, beside theirs."""
    from service.api.sockets import alone, first

    place = settings.host, settings.port
    made = alone(*place) if settings.api_processes == 1 else [first(*place)]
    return [ends.enter_context(one) for one in made]


def _peers(
    store: SqlStore, settings: Settings, listening: socket.socket | None, ends: ExitStack
) -> tuple[list[Supervisor[Literal["api"]]], Together | None]:
    """Who keeps each further API process alive, and what all count together."""
    if listening is None:
        return [], None
    from service.api.sockets import beside
    from service.api.together import Together, files

    number = settings.api_processes
    counts = [ends.enter_context(file).fileno() for file in files(number)]
    peers = [
        Supervisor[Literal["api"]](
            store.engine,
            ["api"],
            partial(api_command, place, counts),
            settings.environ(),
            inherited=counts,
            listens=partial(beside, listening),
        )
        for place in range(1, number)
    ]
    return peers, Together(counts, 0)


# How long a thread of the API that computes keeps the interpreter's lock from one that has a row of
# the database to take: a fifth of what Python sets (`tests/benchmarks/bench_rows.py`).
SWITCH_S = 0.001
SEALER_NICENESS, EMBEDDED_NICENESS = 10, 4


def step_back(niceness: int) -> None:
    """Let other processes go first, but not for ever: on a machine that others keep busy a sealer
    gets about a tenth of a processor. (With SCHED_IDLE it got nothing, and was not sealed at all.)
    """
    os.nice(max(0, niceness - os.nice(0)))


def work(settings: Settings, *, role: Role, owner: str | None, with_parent: bool) -> None:
    """One worker in this process until it is stopped; one that only seals or only diagnoses lets
    others go first."""
    if with_parent:
        end_with_parent()
    owner = owner or owner_name()
    _begin(settings, role, owner)
    store = make_store(settings)
    try:
        if not with_parent:
            prepare(store, settings)
        if role == "deliver":
            run_worker(make_deliverer(store, settings, owner))
            return
        if role in ("seal", "diagnose"):
            step_back(SEALER_NICENESS)
        elif with_parent:
            step_back(EMBEDDED_NICENESS)  # beside the API that started it
        make = partial(make_science, settings, store, kept=True)
        science = cast("Science", Later(make)) if role == "diagnose" else make()
        run_worker(make_worker(store, science, settings, owner, role))
    finally:
        store.close()
        tracing.end()
