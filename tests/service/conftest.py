"""A wired service over either database, with the exact twin as its science."""

from __future__ import annotations

import asyncio
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import uvicorn
from fastapi import FastAPI
from fastapi.routing import _IncludedRouter
from sqlalchemy import literal
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Receive, Scope, Send

from core.observation import Inspection
from service.api.loopback import keys_required
from service.api.server import Protocol
from service.bootstrap import make_app, make_worker
from service.fake import FakeScience
from service.handlers.inspections import Item, post_inspections
from service.handlers.keys import create_key
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.settings import Settings
from service.store.engine import is_sqlite, open_engine
from service.store.unit_of_work import SqlStore
from service.worker import claiming, clock
from service.worker.loop import Worker


@pytest.fixture
def settings(database_url: str) -> Settings:
    return Settings(
        database_url=database_url, science="fake", lease_s=30.0, retry_base_s=0.0, seal_after_s=0.0
    )


@pytest.fixture
def science() -> FakeScience:
    return FakeScience()


@pytest.fixture
def store(settings: Settings, science: FakeScience) -> Iterator[SqlStore]:
    opened = SqlStore(open_engine(settings.database_url))
    register_builtins(opened, science)
    yield opened
    opened.close()


@pytest.fixture
def long_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """No lease is older than the database's server, which a test may have started a moment ago."""
    for module in (claiming, clock):  # what a statement is kept by, and what it asks
        monkeypatch.setattr(module, "begun_s", lambda: literal(0.0))


@pytest.fixture
def elsewhere(
    store: SqlStore, request: pytest.FixtureRequest, tmp_path: Path, sqlite_template: Path
) -> Iterator[SqlStore]:
    """An empty, migrated database of the other kind, without any model."""
    if is_sqlite(store.engine):
        databases = request.getfixturevalue("databases")
        name = databases.take()
        url = databases.url(name)
    else:
        shutil.copy(sqlite_template, tmp_path / "elsewhere.db")
        url = f"sqlite:///{tmp_path / 'elsewhere.db'}"
    opened = SqlStore(open_engine(url))
    yield opened
    opened.close()
    if is_sqlite(store.engine):
        databases.give(name)


@pytest.fixture
def worker(store: SqlStore, science: FakeScience, settings: Settings) -> Worker:
    return make_worker(store, science, settings, "worker-1")


@pytest.fixture
def diagnoser(store: SqlStore, science: FakeScience, settings: Settings) -> Worker:
    return make_worker(store, science, settings, "diagnoser-1", "diagnose")


@pytest.fixture
def follow(worker: Worker, diagnoser: Worker) -> Callable[[], None]:
    """Let both workers do all that there is to do."""

    def work() -> None:
        for _ in range(4):
            worker.drain()
            diagnoser.drain()

    return work


REST_S = 10.0  # and no longer for one that does not end: what it leaves open is told later


class Switch:
    """One HTTP server for all tests; `app` is the application of the present test."""

    app: ASGIApp

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self.app(scope, receive, send)


class RunningServer:
    """uvicorn on a free port of the loopback, in a thread of its own, on what the service uses."""

    def __init__(self) -> None:
        self.switch = Switch()
        config = uvicorn.Config(
            self.switch,
            http=Protocol,
            host="127.0.0.1",
            port=0,
            lifespan="off",
            log_config=None,
        )
        self.server = uvicorn.Server(config)
        self.loop = (config.get_loop_factory() or asyncio.new_event_loop)()
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()
        while not self.server.started:
            time.sleep(0.005)
        self.port = self.server.servers[0].sockets[0].getsockname()[1]

    def _run(self) -> None:
        asyncio.set_event_loop(self.loop)
        self.loop.run_until_complete(self.server.serve())
        self.loop.close()

    def do(self, coroutine: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result()

    def rest(self) -> None:
        """Let requests end whose answers have gone out, as a server does that is stopped: a row of
        the audit trail may come after, and the store is closed next."""
        end = time.monotonic() + REST_S
        while self.server.server_state.tasks and time.monotonic() < end:
            time.sleep(0.002)

    def stop(self) -> None:
        self.server.should_exit = True
        self.thread.join()


@pytest.fixture(scope="session")
def server() -> Iterator[RunningServer]:
    running = RunningServer()
    yield running
    running.stop()


MADE: list[BaseRoute] = []
DOCUMENTS: dict[bool, dict[str, Any]] = {}


def alike(app: FastAPI, *, keys: bool) -> None:
    """Let an application take over what is the same in all and takes longer than most tests.

    FastAPI works out the routes of an included router at an application's first request, and the
    document when it is first asked for. Routes find store and settings by the request, so those of
    the first application serve every other; the document differs by `keys` alone.
    """
    own = app.router.routes
    included = [at for at, route in enumerate(own) if isinstance(route, _IncludedRouter)]
    MADE[:] = MADE or [own[at] for at in included]
    for at, route in zip(included, MADE, strict=True):
        own[at] = route
    if keys not in DOCUMENTS:
        DOCUMENTS[keys] = app.openapi()
    app.openapi_schema = DOCUMENTS[keys]


@contextmanager
def served(
    store: SqlStore, science: FakeScience, settings: Settings, server: RunningServer
) -> Iterator[httpx.Client]:
    """A client of the whole application, over a real connection."""
    app = make_app(store, science, settings)
    alike(app, keys=keys_required(settings))
    lifespan = app.router.lifespan_context(app)
    server.switch.app = app
    server.do(lifespan.__aenter__())
    url = f"http://127.0.0.1:{server.port}"
    with httpx.Client(base_url=url, timeout=60, verify=False) as client:  # nor reads certificates
        yield client
    server.rest()
    server.do(lifespan.__aexit__(None, None, None))


@pytest.fixture
def api(
    store: SqlStore, science: FakeScience, settings: Settings, server: RunningServer
) -> Iterator[httpx.Client]:
    """A program on the server's machine: it needs no key."""
    with served(store, science, settings, server) as client:
        yield client


@pytest.fixture
def serving(
    store: SqlStore, science: FakeScience, settings: Settings, server: RunningServer
) -> Callable[..., AbstractContextManager[httpx.Client]]:
    """Serve with other settings: ``with serving(keys="always") as client``."""

    def serve(**given: Any) -> AbstractContextManager[httpx.Client]:
        return served(store, science, settings.model_copy(update=given), server)

    return serve


@pytest.fixture
def key(store: SqlStore) -> Callable[..., dict[str, str]]:
    """The header of a new key: ``key("read", rotors=["r1"])``."""

    def make(*scopes: str, name: str = "tests", **given: Any) -> dict[str, str]:
        _, token = create_key(store, name, scopes, **given)
        return {"Authorization": f"Bearer {token}"}

    return make


@pytest.fixture
def rotor(store: SqlStore) -> str:
    """A rotor with three blades."""
    blades = [BladeRecord(name) for name in ("B1", "B2", "B3")]
    create_rotor(store, "r1", "rotor-blade", blades, 64, 7)
    return "r1"


@pytest.fixture
def reading() -> Callable[..., Inspection]:
    """A reading of elongation; what is given replaces the default."""

    def make(name: str, **given: Any) -> Inspection:
        value = given.pop("value", 0.11)
        fields = {"blade": "B1", "quantity": "elongation", "time_h": 8000.0} | given
        return Inspection(id=name, values=np.array([value]), **fields)

    return make


@pytest.fixture
def post(store: SqlStore) -> Callable[..., int]:
    """Append readings to a rotor's log; the last sequence number."""

    def append(rotor_id: str, *readings: Inspection) -> int:
        answers = post_inspections(store, rotor_id, [Item("", one) for one in readings])
        return max(answer.seq for answer in answers)

    return append
