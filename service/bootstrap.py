"""The one place that wires settings, store, science, workers and the API."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable
from functools import cache, partial
from types import FrameType
from typing import TYPE_CHECKING, Any, cast

from service import tracing
from service.arenas import give_back, share_arenas
from service.errors import KeysMissingError, SchemaError
from service.handlers.keys import list_keys
from service.handlers.models import register_builtins
from service.pauses import set_aside
from service.ports import Science
from service.settings import Settings
from service.store.engine import is_sqlite, open_engine
from service.store.migrate import migrate, newest, revisions, standing
from service.store.unit_of_work import SqlStore
from service.telemetry import configure_logs
from service.worker.claiming import Role
from service.worker.deliver import Deliverer
from service.worker.loop import Worker, end_with_parent, owner_name, run_worker
from service.worker.supervise import Supervisor
from service.worker.wake import open_wake

if TYPE_CHECKING:
    from fastapi import FastAPI

log = logging.getLogger("bladetwin")


def make_science(settings: Settings, store: SqlStore, *, kept: bool = False) -> Science:
    """The science that the settings name; imported only here and only when asked for.

    Models of users' own runs come from the store. `kept`: states are made with kept machine code
    only, else CompiledError, after which the process is to run again (`service.kernels`).
    """
    if settings.science == "fake":
        from service.fake import FakeScience

        return FakeScience()
    from service.science import CoreScience

    return CoreScience(settings.model_dir, files=store.blob, kept=kept)


class Later:
    """What stands for a science until it is first asked for something.

    A worker that only diagnoses has nothing to do for most of its life; what it would load is a
    hundred megabytes and seconds of a processor.
    """

    def __init__(self, make: Callable[[], Science]) -> None:
        self._made = cache(make)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._made(), name)


def make_store(settings: Settings) -> SqlStore:
    return SqlStore(open_engine(settings.database_url), settings.cache_mb)


def prepare(store: SqlStore, settings: Settings) -> None:
    """Migrate where the settings say so; SchemaError where this release may not run on it."""
    wanted = settings.migrate == "always" or (
        settings.migrate == "auto" and is_sqlite(store.engine)
    )
    needed = newest()
    if wanted:
        found: str | None = migrate(store.engine)
    else:
        found, do = standing(store.engine, needed, revisions())
        if do is not None:
            raise SchemaError(
                f"the database has schema {found}, this release needs {needed}. To mend it: {do}."
            )
    if found != needed:
        log.warning("the database has the newer schema %s; this release (%s) may run on it, "
                    "and should be upgraded", found, needed)  # fmt: skip


def check_keys(store: SqlStore, settings: Settings) -> None:
    """KeysMissingError where requests need a key and there is none that would be accepted."""
    from service.api.loopback import keys_required

    if not keys_required(settings):
        return
    if not any(status == "usable" for _, status in list_keys(store)):
        raise KeysMissingError(settings.host)


@cache
def _release() -> tuple[str, frozenset[str]]:
    """The newest revision and every one that is known: files, which a process reads once."""
    return newest(), revisions()


def make_app(store: SqlStore, science: Science, settings: Settings) -> FastAPI:
    """The API over an open, migrated store. Workers do without it, and load nothing of it."""
    from service.api.app import create_app
    from service.api.services import Services
    from service.api.waiting import Changes

    changes = Changes(lambda: open_wake(store.engine, "bladetwin_applied", settings.poll_ms))
    needed, known = _release()

    return create_app(
        Services(store, science, settings, changes), lambda: standing(store.engine, needed, known)
    )


def make_worker(
    store: SqlStore,
    science: Science,
    settings: Settings,
    owner: str | None = None,
    role: Role = "all",
) -> Worker:
    return Worker(store, science, settings, owner or owner_name(), role)


def worker_command(owner: str, role: Role) -> list[str]:
    """The command line of a worker that ends with its parent."""
    command = [sys.executable, "-P", "-m", "service.cli", "worker", "--role", role]
    return [*command, "--owner", owner, "--end-with-parent"]


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


def serve(settings: Settings) -> None:
    """API and workers until SIGTERM or SIGINT; returns when all have ended."""
    from service.api.server import server as make_server

    share_arenas()
    give_back()
    configure_logs(settings.log_level)
    tracing.begin(settings, "api", owner_name())
    store = make_store(settings)
    science = make_science(settings, store)
    prepare(store, settings)
    check_keys(store, settings)
    register_builtins(store, science)
    app = make_app(store, science, settings)
    server = make_server(app, settings)

    # A signal before uvicorn listens for it ends the server as soon as it has begun. uvicorn raises
    # it again when it has ended; the workers are still to be stopped.
    def stop(signum: int, frame: FrameType | None) -> None:
        server.should_exit = True

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    supervisor = Supervisor(
        store.engine, worker_roles(settings), worker_command, settings.environ()
    )
    supervisor.start()
    set_aside()
    sys.setswitchinterval(SWITCH_S)
    try:
        server.run()
    finally:
        supervisor.stop()
        store.close()
        tracing.end()


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
    share_arenas()
    give_back()
    configure_logs(settings.log_level)
    owner = owner or owner_name()
    tracing.begin(settings, role, owner)
    store = make_store(settings)
    try:
        if not with_parent:
            prepare(store, settings)
        if role == "deliver":
            run_worker(Deliverer(store.engine, settings, owner))
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
