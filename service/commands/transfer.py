"""`bladetwin export` and `bladetwin import`: a rotor as one file.

Between databases it is a bundle; other formats are for other tools (`service.commands.files`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from core.errors import InputError
from service.commands import Json, opened, say
from service.commands.files import Form, Wanted, check, write
from service.settings import Settings


def export(
    rotor: Annotated[str, typer.Argument(help="Id of the rotor.")],
    file: Annotated[Path, typer.Argument(help="The file to write.")],
    force: Annotated[bool, typer.Option(help="Replace the file if it is there.")] = False,
    form: Annotated[
        Form,
        typer.Option(
            "--format",
            help="bundle: for `bladetwin import`; csv, parquet, sensorthings: readings; netcdf: "
            "draws for ArviZ; vtu, pvd, npz, arrow: a field.",
        ),
    ] = Form.BUNDLE,
    blade: Annotated[str | None, typer.Option(help="Of this blade alone.")] = None,
    prediction: Annotated[
        bool, typer.Option("--prediction", help="csv, sensorthings: a blade's prediction.")
    ] = False,
    quantity: Annotated[
        str | None, typer.Option(help="Of a field or prediction; default: the model's first.")
    ] = None,
    times: Annotated[
        str | None, typer.Option(help="Hours with commas between; default: the model's instants.")
    ] = None,
    count: Annotated[int | None, typer.Option(help="Draws; default: 1000.")] = None,
    version: Annotated[
        int | None, typer.Option(help="Of the posterior; default: the newest.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a rotor, its blades, network and whole log into one file; or what other tools read."""
    from service.handlers.transfer_out import export_rotor
    from service.release import release

    wanted = Wanted(form, blade, prediction, quantity, times, count, version)
    check(wanted)
    if file.exists() and not force:
        raise InputError("FILE", str(file), "is there already", "choose another, or add --force")
    if not file.absolute().parent.is_dir():
        raise InputError("FILE", str(file), "is in a folder that does not exist", "make it first")
    settings = Settings.load()
    if form is not Form.BUNDLE:
        with opened(settings, looks=True) as store:
            write(store, settings, rotor, wanted, file)
        size = file.stat().st_size
        facts = {"rotor": rotor, "format": form.value, "file": str(file), "bytes": size}
        say(facts, [f"rotor {rotor}: {form.value} in {file} ({size} bytes)"], as_json=as_json)
        return
    with opened(settings, looks=True) as store:
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
    from service.handlers.transfer_in import import_rotor as use

    settings = Settings.load()
    with opened(settings) as store:
        done = use(store, make_science(settings, store), file, as_id)
    told = done.to_json()
    state = told["state"]
    lines = [f"rotor {told['rotor']}: {told['entries']} entries, {told['blades']} blades"]
    lines[0] += "" if told["new"] else ", as it was here before"
    if state is not None:
        digest = f"{state['digest'][:16]}…"
        lines.append(f"sealed where it came from, through {state['through_seq']}: {digest}")
    say(told, lines, as_json=as_json)
