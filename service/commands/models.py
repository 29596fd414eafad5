"""`bladetwin model …` for runs of a user's own: convert, check, train, register, upload, sample.

`refine` has a module of its own.

What is wrong with runs is listed fault by fault on stderr, and the exit status is 1; warnings go
there as well. With ``--json`` both are in the one object on stdout.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from core.errors import FaultsError, InputError
from service.commands import Json, opened, say
from service.settings import Settings

if TYPE_CHECKING:
    from core.archive.faults import Findings

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
ROW = "{:<22} {:<8} {:>10} {:>10} {:>10} {:>10} {:>8}  {}"


def add(models: typer.Typer) -> None:
    """Put the commands below ``bladetwin model``."""
    from service.commands.refine import refine

    for command in (convert, check, train, register, upload, sample, refine):
        models.command()(command)


def convert(
    file: Annotated[
        Path, typer.Argument(help="A table (.csv) or a numpy archive (.npz).", exists=True)
    ],
    out: Annotated[Path, typer.Option(help="The netCDF file to write.")],
    inputs: Annotated[
        list[str] | None, typer.Option("--input", help="Column that is an input; again for more.")
    ] = None,
    field: Annotated[
        list[str] | None,
        typer.Option(help="Point data and unit, as in 'temperature [K]'; again for more."),
    ] = None,
    points_unit: Annotated[str, typer.Option(help="Unit of the meshes' points.")] = "mm",
    node: Annotated[
        list[str] | None, typer.Option(help="A node with a name, as in tip=12; again for more.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Write runs as netCDF, from a table of curves, a table of mesh files, or a numpy archive.

    A table with a column `file` names mesh files (VTU, VTK, XDMF …), one for each run and instant.
    """
    from core.archive.arrays import convert_arrays
    from core.archive.meshes import convert_meshes
    from core.archive.table import HEADER, convert_table, read_table

    with telling(as_json):
        if file.suffix == ".npz":
            told = convert_arrays(file, out)
        elif field or "file" in read_table(file).units:
            fields: dict[str, str] = {}
            for text in field or ():
                match = HEADER.fullmatch(text)
                if match is None or match.group(2) is None:
                    raise InputError("field", text, "has no unit", "write 'temperature [K]'")
                fields[match.group(1)] = match.group(2)
            told = convert_meshes(
                file, out, fields, inputs=inputs, points_unit=points_unit, named=_named(node or [])
            )
        else:
            told = convert_table(file, out, inputs=inputs)
    shown = f"inputs {', '.join(map(str, _list(told['inputs'])))}; quantities "
    shown += ", ".join(map(str, _list(told["quantities"])))
    say(told | {"file": str(out)}, [f"{out}: {told['runs']} runs; {shown}"], as_json=as_json)


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
        told: dict[str, Any] = {"runs": len(chosen), "inputs": inputs, "warnings": _told(found)}
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

    with telling(as_json):
        if out.exists() and any(out.iterdir()):
            raise InputError("out", str(out), "is not empty", "name a new folder")
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
    told |= {"runs": surrogate.manifest["runs"], "quality": rows, "warnings": _told(found)}
    lines = [f"{out}: version {version}, {told['runs']} runs", *table(rows)]
    say(told, lines, as_json=as_json)


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
    from service.client import Client

    with tempfile.TemporaryDirectory(prefix="bladetwin-upload-") as scratch:
        file = runs
        if runs.is_dir():
            file = Path(scratch) / "runs.nc"
            Archive.open(runs).to_netcdf(file)
        with Client(url, key=key) as twin, steps(quiet=as_json) as progress:
            job = twin.upload_model(
                name, file, network.read_bytes(), leave_out=leave_out or (), progress=progress
            )
    result = job["result"] or {}
    for one in result.get("warnings", []) if not as_json else ():
        typer.echo(f"warning: {_sentence(one)}", err=True)
    if job["status"] != "done":
        if as_json:
            typer.echo(json.dumps(job))
        for one in result.get("faults", []) if not as_json else ():
            typer.echo(f"fault: {_sentence(one)}", err=True)
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


def table(rows: dict[str, Any]) -> list[str]:
    """Held-out errors by quantity, against spread and expected noise."""
    heads = ("quantity", "unit", "rms", "95 %", "spread", "noise", "of it", "verdict")
    lines = [ROW.format(*heads)]
    for name, row in rows.items():
        numbers = (f"{row[key]:.3g}" for key in ("rms", "p95", "spread", "noise"))
        share = f"{100 * row['share_of_spread']:.1f} %"
        verdict = f"{row['verdict']} (worst: run {row['worst']}, {row['worst_rms']:.3g})"
        lines.append(ROW.format(name, row["unit"], *numbers, share, verdict))
    return lines


@contextmanager
def telling(as_json: bool) -> Iterator[None]:
    """Every fault on a line of its own, and exit status 1."""
    try:
        yield
    except FaultsError as error:
        warnings = getattr(error, "warnings", ())
        if as_json:
            told = {"faults": [one.to_json() for one in error.faults]}
            typer.echo(json.dumps(told | {"warnings": [one.to_json() for one in warnings]}))
        for one in warnings if not as_json else ():
            typer.echo(f"warning: {one}", err=True)
        for one in error.faults if not as_json else ():
            typer.echo(f"fault: {one}", err=True)
        count = len(error.faults)
        typer.echo(f"bladetwin: refused for {count} fault{'s' * (count != 1)}", err=True)
        raise typer.Exit(1) from None


def warn(found: Findings, as_json: bool) -> None:
    """Warnings on stderr, where they are not in the object."""
    for one in found.warnings if not as_json else ():
        typer.echo(f"warning: {one}", err=True)


@contextmanager
def steps(*, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A bar for each kind of step, on a terminal."""
    from contextlib import ExitStack

    from service.progress import bar

    shown: dict[str, Callable[[int], None]] = {}
    with ExitStack() as bars:

        def progress(what: str, done: int, total: int) -> None:
            if what not in shown:
                shown[what] = bars.enter_context(bar(what, total, quiet=quiet))
            shown[what](done)

        yield progress


def _named(texts: list[str]) -> dict[str, int]:
    found = {}
    for text in texts:
        name, _, number = text.partition("=")
        if not name or not number.isdigit():
            raise InputError("node", text, "is no name and number", "write tip=12")
        found[name] = int(number)
    return found


def _list(value: object) -> list[object]:
    return list(value) if isinstance(value, list) else []


def _told(found: Findings) -> list[dict[str, object]]:
    return [one.to_json() for one in found.warnings]


def _sentence(one: dict[str, Any]) -> str:
    return f"{one['field']} = {one['value']!r} {one['problem']}. To mend it: {one['remedy']}."
