"""Commands that operate a service: replay, verify, export, import, backup, restore, umbridge.

Each opens the database that the settings name and needs no running service; beside one it goes
through the same leases as a worker. `health`, `inspect` and `policy` ask
a service that runs.

    0   sound, the same, or mended        3   damage, or a difference, that the log can mend
    1   refused; one line says why        4   damage that the log cannot mend
    2   the command line is wrong
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.settings import Settings

if TYPE_CHECKING:
    from service.store.unit_of_work import SqlStore

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
DIFFERS, LOST = 3, 4


def say(data: dict[str, Any], lines: list[str], *, as_json: bool) -> None:
    """Lines for people, or one object for programs."""
    typer.echo(json.dumps(data) if as_json else "\n".join(lines))


@contextmanager
def opened(settings: Settings, *, looks: bool = False) -> Iterator[SqlStore]:
    """The database of the settings, with this release's schema; closed at the end.

    looks   only at what is there (`service.bootstrap.prepare`)
    """
    from service.bootstrap import make_store, prepare

    store = make_store(settings)
    try:
        prepare(store, settings, looks=looks)
        yield store
    finally:
        store.close()


def register(app: typer.Typer) -> None:
    """Add every command of this room."""
    from service.commands import backup, health, inspect, policy, replay, transfer, umbridge

    app.command()(replay.replay)
    app.command()(replay.verify)
    app.command()(transfer.export)
    app.command("import")(transfer.import_rotor)
    app.command()(backup.backup)
    app.command()(backup.restore)
    app.command()(health.health)
    app.command()(inspect.inspect)
    app.command()(policy.policy)
    app.command()(umbridge.umbridge)
