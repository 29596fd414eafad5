"""A SQLite database as one file, while it is written to, and back.

SQLite's online backup copies all pages in one step inside one reading transaction: the copy is the
database as of one moment, writers go on beside it (they append to the write-ahead log, which the
reader does not block), and everything that was acknowledged before it began is in it. A copy of the
file alone is not: what was committed last stands in the write-ahead log beside it.

A file becomes visible under its name only when it is whole: it is written beside, checked, flushed
to disk, then linked to its name, which fails where the name is taken.

PostgreSQL has its own tools; `dump_command` and `restore_command` say how they are called.
"""

from __future__ import annotations

import errno
import os
import shlex
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from hashlib import file_digest
from pathlib import Path
from typing import Any

from sqlalchemy import URL, make_url

from core.errors import InputError
from service.errors import BackupError

BUSY_S = 30.0
HOLD = (
    "UPDATE delivery SET status = 'dead', not_before = NULL, "
    "last_error = 'held when a backup was restored' WHERE status = 'pending'"
)
NO_LINKS = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS)
NO_SYNC = (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS)
SIDES = ("-wal", "-shm", "-journal")


@dataclass(frozen=True, slots=True)
class Copied:
    """What a file holds: entries of all logs, rotors, and the revision of its schema.

    held   webhooks' deliveries that were pending and are not sent unasked
    """

    file: str
    bytes: int
    sha256: str
    schema: str | None
    rotors: int
    entries: int
    held: int = 0

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def sqlite_path(url: str) -> Path | None:
    """The file of a SQLite database; None: it is PostgreSQL."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite":
        return None
    return Path(parsed.database or "")


def backup_file(source: Path, target: Path) -> Copied:
    """Copy the database as it is at one moment into a new file.

    BackupError: the target is taken, the source is no database, or the copy is not sound.
    """
    if target.exists():
        raise BackupError(f"{target} is there already", "choose another name")
    if not source.is_file():
        raise BackupError(f"there is no database {source}", "name it by BLADETWIN_DATABASE_URL")
    return _copied(source, target)


def restore_file(
    backup: Path, target: Path, known: frozenset[str], *, hold: bool = False
) -> Copied:
    """Make the database `target` from a backup; a database that is there is never touched.

    known   the revisions that this release can migrate from
    hold    webhooks' deliveries that were pending then are dead here, to be sent on request

    BackupError: the target is taken, or the backup is not sound or of a newer release.
    """
    left = [Path(f"{target}{side}") for side in ("", *SIDES)]
    taken = [str(path) for path in left if path.exists() and path.stat().st_size]
    if taken:
        raise BackupError(
            f"{' and '.join(taken)} is there already",
            "stop the service and move it away, or name another file by BLADETWIN_DATABASE_URL",
        )
    with _read(backup) as connection:
        schema = _facts(connection, backup)[0]
    if schema not in known:
        raise BackupError(
            f"{backup} has schema {schema}, which this release does not know",
            "restore it with the release that wrote it, or a newer one",
        )
    for path in left:
        path.unlink(missing_ok=True)
    return _copied(backup, target, hold)


@contextmanager
def _read(path: Path) -> Iterator[sqlite3.Connection]:
    """A connection that cannot write; BackupError where the file is no database."""
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as opened:
            opened.execute(f"PRAGMA busy_timeout={int(1000 * BUSY_S)}")
            yield opened
    except sqlite3.Error as error:
        remedy = "see that it is whole, and that this user may read it and write in its folder"
        raise BackupError(f"{path} cannot be read as a database: {error}", remedy) from error


def _facts(connection: sqlite3.Connection, path: Path) -> tuple[str, int, int]:
    """Schema, rotors and entries; BackupError where it is none of ours."""
    names = {row[0] for row in connection.execute("SELECT name FROM sqlite_master")}
    if not {"alembic_version", "rotor", "event"} <= names:
        raise BackupError(f"{path} is no database of bladetwin", "check the file")
    schema = connection.execute("SELECT version_num FROM alembic_version").fetchone()
    rotors = connection.execute("SELECT count(*) FROM rotor").fetchone()[0]
    entries = connection.execute("SELECT count(*) FROM event").fetchone()[0]
    return (schema or ("none",))[0], rotors, entries


def _copied(source: Path, target: Path, hold: bool = False) -> Copied:
    part = target.with_name(f".{target.name}.{os.urandom(4).hex()}.part")
    try:
        os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        with _read(source) as opened, closing(sqlite3.connect(part)) as copy:
            with _room(target):
                copy_pages(opened, copy)
                # one file, without a write-ahead log beside it; whoever opens it chooses anew
                copy.execute("PRAGMA journal_mode=DELETE")
            held = _held(copy) if hold else 0
            wrong = [row[0] for row in copy.execute("PRAGMA integrity_check")]
            if wrong != ["ok"]:
                raise BackupError(f"{source} is damaged: {'; '.join(wrong[:3])}", "restore it")
            facts = _facts(copy, source)
        with part.open("rb+") as written:
            os.fsync(written.fileno())
            digest = file_digest(written, "sha256").hexdigest()
        try:
            _named(part, target)
        except FileExistsError:
            raise BackupError(f"{target} is there already", "choose another name") from None
        folder = os.open(target.absolute().parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        except OSError as error:
            if error.errno not in NO_SYNC:
                raise
        finally:
            os.close(folder)
    except OSError as error:
        problem = f"{target} cannot be written: {error.strerror or error}"
        raise BackupError(problem, "check folder and disk") from error
    finally:
        for side in ("", *SIDES):
            Path(f"{part}{side}").unlink(missing_ok=True)
    return Copied(str(target), target.stat().st_size, digest, *facts, held)


@contextmanager
def _room(target: Path) -> Iterator[None]:
    """BackupError where the copy, and not what is copied, is why it failed: the disk is full."""
    try:
        yield
    except sqlite3.Error as error:
        if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_FULL:
            raise
        problem = f"{target} cannot be written: {error}"
        raise BackupError(problem, "make room on the disk, or name another folder") from error


def _named(part: Path, target: Path) -> None:
    """Give a whole file its name; FileExistsError: it is taken.

    Disks without hard links (exFAT, some network shares) get an empty file of that name first.
    """
    try:
        os.link(part, target)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        part.replace(target)


def _held(copy: sqlite3.Connection) -> int:
    """Make pending deliveries dead; a schema from before webhooks has none."""
    names = copy.execute("SELECT count(*) FROM sqlite_master WHERE name = 'delivery'")
    if not names.fetchone()[0]:
        return 0
    with copy:
        return copy.execute(HOLD).rowcount


def copy_pages(source: sqlite3.Connection, copy: sqlite3.Connection) -> None:
    """All pages in one step, so that all are of one moment and no writer makes it begin again."""
    source.backup(copy, pages=-1)


def _libpq(url: str) -> str:
    """The URL as PostgreSQL's tools read it; the password stays out of the command line."""
    parsed = make_url(url)
    plain = URL.create(
        "postgresql", parsed.username, None, parsed.host, parsed.port, parsed.database, parsed.query
    )
    return plain.render_as_string(hide_password=False)


def dump_command(url: str, file: Path) -> str:
    """The command line that backs a PostgreSQL database up, safe while the service runs."""
    words = ["pg_dump", "--format=custom", f"--file={file}", f"--dbname={_libpq(url)}"]
    return shlex.join(words)


def restore_command(url: str, file: Path) -> str:
    """The command line that writes it into an empty database, all or nothing."""
    words = ["pg_restore", "--no-owner", "--no-privileges", "--exit-on-error"]
    return shlex.join([*words, "--single-transaction", f"--dbname={_libpq(url)}", str(file)])


def hold_command(url: str) -> str:
    """The command line that holds a restored PostgreSQL database's pending deliveries."""
    return shlex.join(["psql", f"--dbname={_libpq(url)}", f"--command={HOLD}"])


def for_postgres(*commands: str) -> InputError:
    """What `backup` and `restore` answer for PostgreSQL."""
    shown = ", then ".join(f"`{command}`" for command in commands)
    return InputError(
        "BLADETWIN_DATABASE_URL",
        "postgresql://…",
        "is PostgreSQL, which has its own tools",
        f"run {shown} (the password comes from PGPASSWORD or ~/.pgpass)",
    )
