"""`bladetwin export` and `bladetwin import`: a rotor as one file, between databases."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from core.errors import InputError
from service.commands import Json, opened, say
from service.settings import Settings


def export(
    rotor: Annotated[str, typer.Argument(help="Id of the rotor.")],
    file: Annotated[Path, typer.Argument(help="The file to write.")],
    force: Annotated[bool, typer.Option(help="Replace the file if it is there.")] = False,
    as_json: Json = False,
) -> None:
    """Write a rotor, its blades, network and whole log into one file."""
    from service.handlers.transfer import export_rotor
    from service.release import release

    if file.exists() and not force:
        raise InputError("FILE", str(file), "is there already", "choose another, or add --force")
    if not file.absolute().parent.is_dir():
        raise InputError("FILE", str(file), "is in a folder that does not exist", "make it first")
    settings = Settings.load()
    with opened(settings) as store:
        manifest = export_rotor(store, rotor, file, release())
    size = file.stat().st_size
    text = f"rotor {rotor}: {manifest['head_seq']} entries in {file} ({size} bytes)"
    say(manifest | {"file": str(file), "bytes": size}, [text], as_json=as_json)


def import_rotor(
    file: Annotated[
        Path,
        typer.Argument(help="A file that `bladetwin export` wrote.", exists=True, dir_okay=False),
    ],
    as_id: Annotated[str | None, typer.Option("--as", help="Its id here.")] = None,
    as_json: Json = False,
) -> None:
    """Write the rotor of a file into the database; a worker then computes its posterior.

    The same file again gives the same answer and no second rotor.
    """
    from service.bootstrap import make_science
    from service.handlers.transfer import import_rotor as use

    settings = Settings.load()
    with opened(settings) as store:
        done = use(store, make_science(settings), file, as_id)
    told = done.to_json()
    state = told["state"]
    lines = [f"rotor {told['rotor']}: {told['entries']} entries, {told['blades']} blades"]
    lines[0] += "" if told["new"] else ", as it was here before"
    if state is not None:
        digest = f"{state['digest'][:16]}…"
        lines.append(f"sealed where it came from, through {state['through_seq']}: {digest}")
    say(told, lines, as_json=as_json)
