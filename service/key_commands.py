"""The commands for API keys and for the audit trail. They speak to the database, not to the API:
who may make keys is who may reach the database.
"""

from __future__ import annotations

import getpass
import json
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.access import COMMAND, Act, KeyRecord
from service.settings import Settings

if TYPE_CHECKING:
    from service.ports import Store

keys = typer.Typer(help="API keys.", no_args_is_help=True)
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


@contextmanager
def opened(*, looks: bool = False) -> Iterator[Store]:
    """The store of BLADETWIN_DATABASE_URL with this release's schema.

    looks   only at what is there (`service.bootstrap.prepare`)
    """
    from service.bootstrap import make_store, prepare

    settings = Settings.load()
    store = make_store(settings)
    try:
        prepare(store, settings, looks=looks)
        yield store
    finally:
        store.close()


def act_of(what: str) -> Act:
    """A command as the audit trail tells it, with the user of the operating system."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):
        user = f"uid {os.getuid()}"
    return Act(None, f"{COMMAND}, {user}"[:200], None, secrets.token_hex(8), what, what)


def key_out(key: KeyRecord, status: str) -> dict[str, Any]:
    """A key as it is shown; its digest is not."""
    from service.api.services import moment

    return {
        "id": key.id,
        "name": key.name,
        "scopes": list(key.scopes),
        "rotors": None if key.rotors is None else list(key.rotors),
        "status": status,
        "created_at": moment(key.created_at),
        "expires_at": moment(key.expires_at),
        "revoked_at": moment(key.revoked_at),
    }


def line_of(key: KeyRecord, status: str) -> str:
    told = key_out(key, status)
    only = "all rotors" if told["rotors"] is None else "rotors " + ", ".join(told["rotors"])
    until = f"until {told['expires_at']}" if told["expires_at"] else "without end"
    return f"{key.id}  {status}  {key.name}: {', '.join(key.scopes)}; {only}; {until}"


@keys.command("create")
def create(
    name: Annotated[str, typer.Argument(help="Who uses the key.")],
    scope: Annotated[
        list[str], typer.Option(help="read, ingest or operate; may be given several times.")
    ],
    rotor: Annotated[
        list[str] | None, typer.Option(help="The only rotor that it knows; several: again.")
    ] = None,
    days: Annotated[float | None, typer.Option(help="Days until it expires.")] = None,
    as_json: Json = False,
) -> None:
    """Make an API key. It is shown this once; the database keeps its SHA-256 alone."""
    from service.handlers.keys import create_key

    with opened() as store:
        key, token = create_key(store, name, scope, rotor or (), days, act_of("keys create"))
    if as_json:
        typer.echo(json.dumps(key_out(key, "usable") | {"key": token}))
        return
    typer.echo(line_of(key, "usable"))
    typer.echo(f"\n{token}\n\nKeep it: it is not shown again. Authorization: Bearer {token[:7]}…")


@keys.command("list")
def list_all(as_json: Json = False) -> None:
    """Every key, usable or not; no secret."""
    from service.handlers.keys import list_keys

    with opened(looks=True) as store:
        found = list_keys(store)
    if as_json:
        typer.echo(json.dumps({"items": [key_out(*one) for one in found]}))
        return
    typer.echo("\n".join(line_of(*one) for one in found) or "no keys")


@keys.command("revoke")
def revoke(
    key_id: Annotated[str, typer.Argument(metavar="ID", help="As `bladetwin keys list` shows.")],
    as_json: Json = False,
) -> None:
    """Accept a key no more, from the next request on."""
    from service.handlers.keys import revoke_key

    with opened(looks=True) as store:
        key, now = revoke_key(store, key_id, act_of("keys revoke"))
    if as_json:
        typer.echo(json.dumps(key_out(key, "revoked")))
        return
    typer.echo(f"key {key.id} ({key.name}) {'is' if now else 'was already'} revoked")


def audit(
    rotor: Annotated[str | None, typer.Option(help="Of this rotor alone.")] = None,
    key: Annotated[str | None, typer.Option(help="By this key's id alone.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=100_000, help="At most so many.")] = 50,
    before: Annotated[int | None, typer.Option(help="Below this id; for the next page.")] = None,
    as_json: Json = False,
) -> None:
    """Who changed what, the newest first."""
    from service.api.routers.audit import row_out
    from service.handlers.audit import list_audit

    with opened(looks=True) as store:
        rows = [row_out(row) for row in list_audit(store, before, limit, rotor, key)]
    if as_json:
        typer.echo(json.dumps({"items": rows}))
        return
    if not rows:
        of = f" of rotor {rotor!r}" if rotor else ""
        typer.echo(f"nothing is recorded{of}{f' by key {key!r}' if key else ''}")
    for row in rows:
        who = f"{row['who']} ({row['key']})" if row["key"] else row["who"]
        what = row["path"] if " " in row["path"] else f"{row['what'].split(' ')[0]} {row['path']}"
        told = " ".join(str(part) for part in (row["status"] or "", row["problem"] or "") if part)
        where = f" from {row['address']}" if row["address"] else ""
        told += _entries(row["entries"])
        typer.echo(f"{row['id']}  {row['at']}  {who}{where}: {what} {told}".rstrip())


def _entries(entries: dict[str, int] | None) -> str:
    """Which entries of the rotor's log a request appended.

    >>> _entries({"first_seq": 64, "last_seq": 87}), _entries({"first_seq": 3, "last_seq": 3})
    (', entries 64 to 87', ', entry 3')
    """
    if entries is None:
        return ""
    first, last = entries["first_seq"], entries["last_seq"]
    return f", entry {first}" if first == last else f", entries {first} to {last}"
