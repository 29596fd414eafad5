"""The command ``bladetwin``."""

from __future__ import annotations

import json
import sys
import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

import service.one_thread  # noqa: F401  before numpy
from core.errors import BladetwinError
from service import kernels
from service.adopt_command import adopt
from service.commands import builtin, campaigns, register
from service.commands import models as own_runs
from service.diagnose_command import diagnose
from service.environment import table
from service.errors import StoreAwayError
from service.key_commands import audit, keys
from service.progress import bar
from service.settings import Settings
from service.studies import app as studies

app = typer.Typer(
    name="bladetwin",
    help="Online digital twin of turbine rotor blades.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
models = typer.Typer(help="Models.", no_args_is_help=True)
own_runs.add(models)
models.command("runs")(campaigns.runs)
models.command("build")(builtin.build)
models.command("readings")(builtin.readings)
app.add_typer(models, name="model")
app.add_typer(studies, name="study")
app.add_typer(keys, name="keys")
app.command()(audit)
register(app)
app.command()(diagnose)
app.command()(adopt)

SETTINGS_HELP = "Settings (environment variables):\n\n" + "\n\n".join(
    f"{name} [{default}]: {meaning}" for name, default, meaning in table(Settings)
)
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


class WorkerRole(StrEnum):
    """What a worker does."""

    ALL = "all"
    APPLY = "apply"
    SEAL = "seal"
    DIAGNOSE = "diagnose"
    DELIVER = "deliver"


def say(data: dict[str, Any], text: str, *, as_json: bool) -> None:
    """One line for people, or one object for programs."""
    typer.echo(json.dumps(data) if as_json else text)


@app.command(epilog=SETTINGS_HELP)
def serve(
    host: Annotated[str | None, typer.Option(help="Overrides BLADETWIN_HOST.")] = None,
    port: Annotated[int | None, typer.Option(help="Overrides BLADETWIN_PORT.")] = None,
    workers: Annotated[int | None, typer.Option(help="Overrides BLADETWIN_WORKERS.")] = None,
    as_json: Json = False,
) -> None:
    """Serve the API and run the workers, until SIGTERM or Ctrl-C."""
    from service.processes import serve as run

    settings = Settings.load(host=host, port=port, workers=workers)
    facts = {"url": f"http://{settings.host}:{settings.port}", "workers": settings.workers}

    def opened() -> None:
        say(facts, f"bladetwin at {facts['url']}, {settings.workers} worker(s)", as_json=as_json)
        sys.stdout.flush()

    run(settings, opened)


@app.command()
def worker(
    role: Annotated[
        WorkerRole,
        typer.Option(
            help="apply entries, seal provisional posteriors, both (all), diagnose, or deliver "
            "to webhooks."
        ),
    ] = WorkerRole.ALL,
    owner: Annotated[str | None, typer.Option(hidden=True)] = None,
    end_with_parent: Annotated[bool, typer.Option("--end-with-parent", hidden=True)] = False,
) -> None:
    """Run one worker, here or on another machine, against BLADETWIN_DATABASE_URL."""
    from service.processes import work

    work(Settings.load(), role=role.value, owner=owner, with_parent=end_with_parent)


@app.command(hidden=True)
def api(
    place: Annotated[int, typer.Option()],
    socket: Annotated[int, typer.Option()],
    counts: Annotated[str, typer.Option()],
    owner: Annotated[str, typer.Option()],
) -> None:
    """A further API process of the `serve` that starts it, on descriptors that it inherits."""
    from service.processes import answer

    files = [int(one) for one in counts.split(",")]
    answer(Settings.load(), place=place, listening=socket, counts=files, owner=owner)


@app.command()
def migrate(
    patience: Annotated[
        float, typer.Option(help="Try for so long to have the tables of a PostgreSQL in use, s.")
    ] = 60.0,
    as_json: Json = False,
) -> None:
    """Bring the database to this release's schema."""
    from service.bootstrap import make_store
    from service.store.migrate import migrate as upgrade
    from service.store.migrate import newest

    store = make_store(Settings.load())
    try:
        revision = upgrade(store.engine, patience)
    finally:
        store.close()
    line = f"schema is at revision {revision}"
    if revision != (own := newest()):
        line += f", newer than this release's {own}, which may run on it; nothing was changed"
    say({"revision": revision}, line, as_json=as_json)


@app.command("compile")
def compile_kernels(as_json: Json = False) -> None:
    """Compile the kernels for this machine ahead of the first start, which would do it else.

    The machine code is kept beside the installed package, or in the user's cache folder where that
    cannot be written to.
    """
    from service.science import CoreScience

    start = time.monotonic()
    science = CoreScience(Settings.load().model_dir)
    with bar("compiling", len(science.builtins), quiet=as_json) as shown:
        for done, name in enumerate(science.builtins, start=1):
            science.warm(science.builtin(name))
            shown(done)
    seconds = round(time.monotonic() - start, 1)
    say({"seconds": seconds}, f"kernels are compiled ({seconds:g} s)", as_json=as_json)


@app.command()
def demo(
    keep: Annotated[bool, typer.Option(help="Leave the API up afterwards.")] = False,
    port: Annotated[int | None, typer.Option(help="Port of the demonstration's API.")] = None,
    particles: Annotated[int, typer.Option(help="Particles per blade.")] = 10_000,
    seed: Annotated[int, typer.Option(help="Seed of the rotor.")] = 0,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("bladetwin-demo"),
    effects: Annotated[
        bool, typer.Option("--effects", help="Readings with effects in them that the model lacks.")
    ] = False,
    as_json: Json = False,
) -> None:
    """The main job: a rotor of 100 blades over HTTP, held against finite-element truth."""
    from service.demo import run

    run(
        keep=keep,
        port=port,
        particles=particles,
        seed=seed,
        out=out,
        as_json=as_json,
        effects=effects,
    )


def main() -> None:
    """Entry point: an error of bladetwin, or of its files, is one line and exit status 1.

    A command that compiled kernels and must not compute with them begins again.
    """
    try:
        app()
    except kernels.CompiledError as error:
        kernels.again(error)
    except StoreAwayError as error:
        from service.store.engine import away

        typer.echo(f"bladetwin: {away(Settings.load().database_url, error)}", err=True)
        raise SystemExit(1) from None
    except BladetwinError as error:
        typer.echo(f"bladetwin: {error}", err=True)
        raise SystemExit(1) from None
    except TimeoutError as error:
        typer.echo(f"bladetwin: {error}. To mend it: wait longer, or read its log.", err=True)
        raise SystemExit(1) from None
    except OSError as error:
        where = f"{error.filename}: " if error.filename is not None else ""
        why = error.strerror or type(error).__name__
        remedy = "give a path that may be read or written, and room on the disk"
        typer.echo(f"bladetwin: {where}{why}. To mend it: {remedy}.", err=True)
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
