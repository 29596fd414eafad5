"""The one place that wires settings, store, science, workers and the API."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from core.errors import InputError
from service.errors import KeysMissingError, SchemaError
from service.handlers.keys import list_keys
from service.ports import Science
from service.settings import Settings
from service.store.backup import sqlite_path
from service.store.engine import is_sqlite, open_engine
from service.store.migrate import migrate, newest, revisions, standing
from service.store.unit_of_work import SqlStore
from service.worker.claiming import Role
from service.worker.deliver import Deliverer
from service.worker.loop import Worker, owner_name
from service.worker.wake import open_wake

if TYPE_CHECKING:
    from fastapi import FastAPI

    from service.api.together import Together

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


def prepare(store: SqlStore, settings: Settings, *, looks: bool = False) -> None:
    """Migrate where the settings say so; SchemaError where this release may not run on it.

    looks   at what is there already, which is neither made nor migrated unless the settings say
            `always`: an empty database would be sound, and a newer schema may be one that the
            service, of an older release, cannot run on

    InputError: there is no SQLite file to look at.
    """
    path = sqlite_path(settings.database_url)
    if looks and path is not None and not (path.is_file() and path.stat().st_size):
        problem = f"names no database: there is none at {path.absolute()}"
        remedy = "run it in the folder of the service, or set {} as the service has it"
        name = "BLADETWIN_DATABASE_URL"
        raise InputError(name, settings.database_url, problem, remedy.format(name))
    wanted = settings.migrate == "always" or (
        settings.migrate == "auto" and is_sqlite(store.engine) and not looks
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


def make_app(
    store: SqlStore, science: Science, settings: Settings, together: Together | None = None
) -> FastAPI:
    """The API over an open, migrated store. Workers do without it, and load nothing of it.

    together   what other API processes of the same service count
    """
    from service.api.app import create_app
    from service.api.services import Services
    from service.api.waiting import Changes

    changes = Changes(lambda: open_wake(store.engine, "bladetwin_applied", settings.poll_ms))
    needed, known = _release()

    return create_app(
        Services(store, science, settings, changes),
        lambda: standing(store.engine, needed, known),
        together,
    )


def make_worker(
    store: SqlStore,
    science: Science,
    settings: Settings,
    owner: str | None = None,
    role: Role = "all",
) -> Worker:
    remedy = partial(_remedy, store)
    return Worker(store, science, settings, owner or owner_name(), role, remedy)


def make_deliverer(store: SqlStore, settings: Settings, owner: str) -> Deliverer:
    return Deliverer(store.engine, settings, owner, remedy=partial(_remedy, store))


def _remedy(store: SqlStore) -> str | None:
    return standing(store.engine, *_release())[1]
