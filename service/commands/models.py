"""`bladetwin model …` for runs of a user's own: check, train, register, upload, sample.

`convert` and `refine` have modules of their own. How what is wrong with runs is told:
`service.commands.telling`.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from core.errors import InputError
from service.commands import Json, opened, say
from service.commands.convert import convert
from service.commands.reach import reached
from service.commands.telling import sentence, steps, table, telling, warn, warnings_of
from service.settings import Settings

Runs = Annotated[
    Path, typer.Argument(help="Runs: a netCDF file, or a folder of `model sample`.", exists=True)
]
Network = Annotated[
    Path, typer.Option("--network", help="The network's declaration, YAML or JSON.", exists=True)
]
LeaveOut = Annotated[
    list[str] | None,
    typer.Option("--leave-out", help="Label of a run to leave out; again for more."),
]


def add(models: typer.Typer) -> None:
    """Put the commands below ``bladetwin model``."""
    from service.commands.refine import refine

    for command in (convert, check, train, register, upload, sample, refine):
        models.command()(command)


def check(runs: Runs, network: Network, leave_out: LeaveOut = None, as_json: Json = False) -> None:
    """Tell everything that is wrong with runs, without training on them. Exit status 1: faults."""
    from core.archive.opening import opened as source_of
    from core.archive.take import take
    from service.declared import read_file

    with telling(as_json), tempfile.TemporaryDirectory(prefix="bladetwin-check-") as folder:
        declared = read_file(network)
        with source_of(runs) as source:
            archive, found, chosen = take(
                source, declared, Path(folder) / "runs", leave_out=leave_out or ()
            )
        warn(found, as_json)
        inputs = [item.name for item in archive.declaration.inputs]
        told: dict[str, Any] = {
            "runs": len(chosen),
            "inputs": inputs,
            "warnings": warnings_of(found),
        }
    say(told, [f"{runs}: {len(chosen)} runs can be trained on"], as_json=as_json)


def train(
    runs: Runs,
    network: Network,
    out: Annotated[Path, typer.Option(help="Folder of the model; empty or not there yet.")],
    leave_out: LeaveOut = None,
    seed: Annotated[int, typer.Option(help="Seed of the folds and of the reduction.")] = 0,
    as_json: Json = False,
) -> None:
    """Train a model on runs; a table tells how far it is off at runs that were left out.

    Exit status 1: the runs have faults, or a quantity is not learnt from them.
    """
    from core.archive.opening import opened as source_of
    from core.model import Model
    from core.surrogate.own import make
    from service.declared import read_file
    from service.packed import write_network

    with telling(as_json), _whole(out):
        declared = read_file(network)
        with source_of(runs) as source, steps(quiet=as_json) as progress:
            surrogate, found = make(
                source, declared, out, leave_out=leave_out or (), seed=seed, progress=progress
            )
        write_network(out, declared)
        version = Model.of(declared, surrogate).version
        warn(found, as_json)
    rows = surrogate.manifest["quality"]
    told: dict[str, Any] = {"folder": str(out), "version": version, "digest": surrogate.digest}
    told |= {"runs": surrogate.manifest["runs"], "quality": rows, "warnings": warnings_of(found)}
    lines = [f"{out}: version {version}, {told['runs']} runs", *table(rows)]
    say(told, lines, as_json=as_json)


@contextmanager
def _whole(out: Path) -> Iterator[None]:
    """A folder that is empty or not there is as it was where what fills it fails."""
    there = out.exists()
    if there and not out.is_dir():
        raise InputError("out", str(out), "is no folder", "name a new one")
    if there and any(out.iterdir()):
        raise InputError("out", str(out), "is not empty", "name a new folder")
    try:
        yield
    except BaseException:
        shutil.rmtree(out, ignore_errors=True)
        if there:
            out.mkdir(exist_ok=True)
        raise


def register(
    folder: Annotated[
        Path,
        typer.Argument(help="Folder of `bladetwin model train`.", exists=True, file_okay=False),
    ],
    name: Annotated[str, typer.Argument(help="Id that the model is to have.")],
    as_json: Json = False,
) -> None:
    """Put a trained model into the database; for archives that are too large to upload."""
    import re

    from service.bootstrap import make_science
    from service.handlers.models import register_trained
    from service.names import ID_PATTERN
    from service.packed import pack

    if not re.fullmatch(ID_PATTERN, name) or len(name) > 100:
        remedy = "use letters, digits and . _ : @ + - (no slash, no space), 100 at most"
        raise InputError("name", name, "is no id", remedy)
    settings = Settings.load()
    artefact = pack(folder)
    with opened(settings) as store:
        card = register_trained(store, make_science(settings, store), name, artefact)
    told = {"model": card.id, "version": card.version, "digest": card.digest}
    say(told, [f"model {card.id}: version {card.version}"], as_json=as_json)


def upload(
    runs: Runs,
    network: Network,
    name: Annotated[str, typer.Option(help="Id that the model is to have.")],
    leave_out: LeaveOut = None,
    url: Annotated[str, typer.Option(help="Of the service.")] = "http://127.0.0.1:8000",
    key: Annotated[str | None, typer.Option(help="An API key with read and operate.")] = None,
    as_json: Json = False,
) -> None:
    """Send runs and network to a service, which trains the model; waits for it.

    Exit status 1: the service refuses them, or a quantity is not learnt from them.
    """
    from core.archive import Archive

    with tempfile.TemporaryDirectory(prefix="bladetwin-upload-") as scratch:
        file = runs
        if runs.is_dir():
            file = Path(scratch) / "runs.nc"
            Archive.open(runs).to_netcdf(file)
        with reached(url, key) as twin, steps(quiet=as_json) as progress:
            job = twin.upload_model(
                name, file, network.read_bytes(), leave_out=leave_out or (), progress=progress
            )
    result = job["result"] or {}
    for one in result.get("warnings", []) if not as_json else ():
        typer.echo(f"warning: {sentence(one)}", err=True)
    if job["status"] != "done":
        if as_json:
            typer.echo(json.dumps(job))
        for one in result.get("faults", []) if not as_json else ():
            typer.echo(f"fault: {sentence(one)}", err=True)
        typer.echo(f"bladetwin: {name} was not trained: job {job['id']} {job['status']}", err=True)
        raise typer.Exit(1)
    lines = [f"model {name}: version {result['version']}", *table(result["quality"])]
    say(result, lines, as_json=as_json)


def sample(
    url: Annotated[str, typer.Argument(help="Of the UM-Bridge server.")],
    network: Network,
    out: Annotated[Path, typer.Option(help="Folder of the runs; goes on where it was cut.")],
    times: Annotated[str, typer.Option(help="Hours of the outputs, as in 0,500,1000,4000.")],
    design: Annotated[int, typer.Option(min=2, help="Number of points.")],
    model: Annotated[str | None, typer.Option(help="Its name, where several are served.")] = None,
    config: Annotated[str, typer.Option(help="JSON of the model's options.")] = "{}",
    seed: Annotated[int, typer.Option(help="Seed of the design.")] = 0,
    timeout: Annotated[float, typer.Option(help="Longest wait for one run, s.")] = 3600.0,
    as_json: Json = False,
) -> None:
    """Run a model that is served over UM-Bridge at maximin points of the network's bounds.

    Runs that are there are kept: the same command goes on. Exit status 1: some runs failed; the
    others are there, and the same command tries those again.
    """
    import httpx

    from service import sampling
    from service.declared import read_file
    from service.progress import bar

    with telling(as_json):
        declared = read_file(network)
        try:
            hours = [float(one) for one in times.split(",")]
            options = json.loads(config)
        except ValueError as error:
            raise InputError(
                "times or config", str(error), "cannot be read", "see --help"
            ) from None
        with (
            httpx.Client(base_url=url, timeout=timeout) as http,
            bar("runs", design, quiet=as_json) as shown,
        ):
            served = sampling.Served(http, model, options)
            done = sampling.sample(
                served, declared, str(out), hours, design, seed=seed, progress=shown
            )
    failed = [{"run": k, "error": why} for k, why in done.failed]
    lines = [f"{out}: {done.done} of {design} runs", *(f"run {k}: {why}" for k, why in done.failed)]
    told = {"folder": str(out), "runs": done.done, "design": design, "failed": failed}
    say(told, lines, as_json=as_json)
    if failed:
        raise typer.Exit(1)
