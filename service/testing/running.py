"""A whole service in this process: the application, a database, workers in threads."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, cast

import httpx
from sqlalchemy import event

from core.errors import BladetwinError, InputError
from service.access import SCOPES
from service.api.loopback import keys_required
from service.bootstrap import Later, make_app, make_science, make_worker
from service.client.transports import PATIENCE_S
from service.handlers.keys import create_key
from service.handlers.models import register_builtins
from service.ports import Science
from service.processes import worker_roles
from service.settings import Settings
from service.store.engine import open_engine, transaction
from service.store.migrate import migrate
from service.store.unit_of_work import SqlStore
from service.testing.inside import Inside
from service.testing.transport import AsyncTransport, Transport
from service.worker.claiming import Role
from service.worker.deliver import Deliverer
from service.worker.loop import Stoppable

if TYPE_CHECKING:
    from fastapi import FastAPI

URL = "http://127.0.0.1"
DEFAULTS: dict[str, Any] = {"sealers": 0, "seal_after_s": 0.0, "retry_base_s": 0.01}
"""What is other than in `Settings`: one worker seals as well, and nothing is waited for."""
END_S = 120.0


class WorkerDiedError(BladetwinError):
    """A worker's thread ended by an error, which is the cause; `role` is the worker's."""

    def __init__(self, role: Role, error: BaseException) -> None:
        self.role = role
        super().__init__(f"the worker `{role}` died: {type(error).__name__}: {error}")
        self.__cause__ = error


class Running:
    """The service, from entering to leaving; `settings` are those that it has.

    science   core: the blade physics; fake: the exact Gaussian twin; or a `Science` of your own,
              which the application and the workers share
    given     settings by their names in `Settings`, e.g. keys="always"

    Leaving ends threads and removes the database; it raises WorkerDiedError where one died.
    """

    settings: Settings

    def __init__(self, science: str | Science, given: dict[str, Any]) -> None:
        self._science = science
        self._given = given
        self._ends = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as ends:
            folder = Path(ends.enter_context(TemporaryDirectory(prefix="bladetwin-")))
            self.settings = _settings(folder, self._science, self._given)
            self._store = SqlStore(_engine(folder), self.settings.cache_mb)
            ends.callback(self._store.close)
            science = self._make()
            register_builtins(self._store, science)
            app = make_app(self._store, science, self.settings)
            self._inside = ends.enter_context(_loop(app))
            ends.enter_context(self._working())
            self._ends = ends.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._ends.close()
        died = self._inside.error
        if died is None or died is error:
            return
        if error is None:
            raise died
        error.add_note(str(died))

    def http(self, key: str | None = None) -> httpx.Client:
        """A connection for `Client`, or for requests of one's own."""
        headers = _headers(key)
        transport = Transport(self._inside)
        return httpx.Client(
            transport=transport, base_url=URL, timeout=PATIENCE_S, headers=headers, trust_env=False
        )

    def async_http(self, key: str | None = None) -> httpx.AsyncClient:
        """The same for `AsyncClient`."""
        headers = _headers(key)
        transport = AsyncTransport(self._inside)
        return httpx.AsyncClient(
            transport=transport, base_url=URL, timeout=PATIENCE_S, headers=headers, trust_env=False
        )

    def key(self, *scopes: str, name: str = "tests", **given: Any) -> str:
        """A new API key: ``key("read", rotors=["r1"], days=1)``; no scope: every scope."""
        return create_key(self._store, name, scopes or SCOPES, **given)[1]

    def own_key(self) -> str | None:
        """A key with every scope where requests need one."""
        return self.key(name="in memory") if keys_required(self.settings) else None

    def _make(self) -> Science:
        if isinstance(self._science, str):
            return make_science(self.settings, self._store)
        return self._science

    def _worker(self, role: Role, owner: str) -> Stoppable:
        if role == "deliver":
            return Deliverer(self._store.engine, self.settings, owner)
        science = cast("Science", Later(self._make))  # each has its own, as each process has
        return make_worker(self._store, science, self.settings, owner, role)

    @contextmanager
    def _working(self) -> Iterator[None]:
        """Workers, a thread each, which are stopped and waited for at the end."""
        hands: list[tuple[Stoppable, threading.Thread]] = []
        try:
            for number, role in enumerate(worker_roles(self.settings)):
                worker = self._worker(role, f"memory-{number}")
                name = f"bladetwin-{role}"
                thread = threading.Thread(
                    target=self._work, args=(worker, role), name=name, daemon=True
                )
                thread.start()
                hands.append((worker, thread))
            yield
        finally:
            for worker, _ in hands:
                worker.stop()
            _wake(self._store)
            for _, thread in hands:
                thread.join(END_S)
            if late := [thread.name for _, thread in hands if thread.is_alive()]:
                raise TimeoutError(f"{', '.join(late)} did not end within {END_S:g} s")

    def _work(self, worker: Stoppable, role: Role) -> None:
        try:
            worker.run()
        except BaseException as error:
            self._inside.fail(WorkerDiedError(role, error))


def _wake(store: SqlStore) -> None:
    """A commit, by which workers that sleep wake and see that they are to end."""
    with transaction(store.engine, write=True) as connection:
        connection.exec_driver_sql("PRAGMA user_version = 1")


def _headers(key: str | None) -> dict[str, str]:
    return {} if key is None else {"Authorization": f"Bearer {key}"}


def _settings(folder: Path, science: str | Science, given: dict[str, Any]) -> Settings:
    """Of the keywords alone; the environment of the tests does not count."""
    for name in ("database_url", "database_url_file", "science", "host", "port", "api_processes"):
        if name in given:
            remedy = "leave it out, or run `bladetwin serve`"
            raise InputError(name, given[name], "is not for a service in memory", remedy)
    named = {"science": science} if isinstance(science, str) else {}
    url = f"sqlite:///{folder / 'bladetwin.db'}"
    return Settings.load({}, database_url=url, **named, **(DEFAULTS | given))


@cache
def _empty() -> bytes:
    """A migrated database without rows, as its file."""
    with TemporaryDirectory(prefix="bladetwin-") as folder:
        path = Path(folder, "empty.db")
        engine = open_engine(f"sqlite:///{path}")
        migrate(engine)
        engine.dispose()
        return path.read_bytes()


def _engine(folder: Path) -> Any:
    """An engine over a new database; nothing is flushed to disk, for nothing is to be kept."""
    path = folder / "bladetwin.db"
    path.write_bytes(_empty())
    engine = open_engine(f"sqlite:///{path}")
    event.listen(
        engine, "connect", lambda made, record: made.execute("PRAGMA synchronous=OFF").close()
    )
    return engine


@contextmanager
def _loop(app: FastAPI) -> Iterator[Inside]:
    """The application's life in an event loop of its own thread."""
    begun: Future[tuple[Inside, asyncio.Event]] = Future()

    async def live() -> None:
        inside, end = Inside(app, asyncio.get_running_loop()), asyncio.Event()
        try:
            async with app.router.lifespan_context(app):
                begun.set_result((inside, end))
                await end.wait()
        except BaseException as error:
            if begun.done():
                raise
            begun.set_exception(error)
        await inside.close()

    thread = threading.Thread(
        target=partial(asyncio.run, live()), name="bladetwin-api", daemon=True
    )
    thread.start()
    inside, end = begun.result()
    loop = inside.loop
    try:
        yield inside
    finally:
        loop.call_soon_threadsafe(end.set)
        thread.join(END_S)
        for one in threading.enumerate():
            if getattr(one, "loop", None) is loop:  # those that answered, told to end by anyio
                one.join(END_S)
