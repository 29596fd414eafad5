"""`bladetwin backup` and `bladetwin restore`: the whole database as one file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.commands import Json, say
from service.settings import Settings

if TYPE_CHECKING:
    from service.store.backup import Copied


def backup(
    file: Annotated[Path, typer.Argument(help="The file to write; it must not exist.")],
    as_json: Json = False,
) -> None:
    """Copy a SQLite database into one file; safe while the service runs.

    Everything that was answered before the command began is in it. For PostgreSQL it names the
    pg_dump command and ends with exit status 1.
    """
    from service.store import backup as use

    url = Settings.load().database_url
    source = use.sqlite_path(url)
    if source is None:
        raise use.for_postgres(use.dump_command(url, file))
    _tell(use.backup_file(source, file), as_json)


def restore(
    file: Annotated[
        Path, typer.Argument(help="What `bladetwin backup` wrote.", exists=True, dir_okay=False)
    ],
    hold_webhooks: Annotated[
        bool,
        typer.Option(
            "--hold-webhooks",
            help="What was still to be sent to webhooks is dead, and sent when asked for.",
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Make the database of BLADETWIN_DATABASE_URL from a backup, where there is none yet.

    A database that is there is not touched. For PostgreSQL it names the pg_restore command and
    ends with exit status 1.
    """
    from service.store import backup as use
    from service.store.migrate import revisions

    url = Settings.load().database_url
    target = use.sqlite_path(url)
    if target is None:
        more = [use.hold_command(url)] if hold_webhooks else []
        raise use.for_postgres(use.restore_command(url, file), *more)
    _tell(use.restore_file(file, target, revisions(), hold=hold_webhooks), as_json)


def _tell(done: Copied, as_json: bool) -> None:
    line = f"{done.file}: {done.rotors} rotor(s), {done.entries} entries, schema {done.schema}"
    lines = [line, f"{done.bytes} bytes, SHA-256 {done.sha256}"]
    if done.held:
        lines.append(f"{done.held} deliveries to webhooks are held (dead) until they are asked for")
    say(done.to_json(), lines, as_json=as_json)
