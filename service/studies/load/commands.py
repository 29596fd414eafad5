"""`bladetwin study load`."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from service.progress import bar
from service.studies import app
from service.studies.chaos.commands import Databases, end_in_order, machine
from service.studies.result import commit, write

DURABLE = ("synchronous_commit=on", "max_connections=300")
# what a database does by itself, with the moment: it may be what a slow spell is about
TELLING = ("log_checkpoints=on", "log_autovacuum_min_duration=0", "log_line_prefix=%m ")


@contextmanager
def places(which: str) -> Iterator[list[tuple[str, Any, Path]]]:
    """(name, makes the URL of an empty database, folder of its files) of each database."""
    from service.studies.chaos.postgres import Server

    if which not in ("sqlite", "postgresql", "both"):
        raise typer.BadParameter(f"{which!r} is none of sqlite, postgresql, both")
    with ExitStack() as stack:
        found: list[tuple[str, Any, Path]] = []
        if which != "postgresql":
            folder = Path(
                stack.enter_context(tempfile.TemporaryDirectory(prefix="bladetwin-load-"))
            )
            found.append(("sqlite", lambda name: f"sqlite:///{folder / name}.db", folder))
        if which != "sqlite":
            server = stack.enter_context(Server((*DURABLE, *TELLING)))

            def made(name: str) -> str:
                server.run(f"CREATE DATABASE {name}")
                return server.url(name)

            found.append(("postgresql", made, server.folder))
        yield found


@app.command()
def load(
    minutes: Annotated[float, typer.Option(min=0.05, help="How long.")] = 60.0,
    rate: Annotated[float, typer.Option(min=0, help="Readings posted a second.")] = 30.0,
    reads: Annotated[float, typer.Option(min=0, help="Reads a second.")] = 100.0,
    rotors: Annotated[int, typer.Option(min=1, help="Rotors.")] = 100,
    blades: Annotated[int, typer.Option(min=1, help="Blades of each rotor.")] = 100,
    workers: Annotated[int, typer.Option(min=1, help="Workers of the server.")] = 1,
    api_processes: Annotated[
        int, typer.Option(min=1, help="Processes of the server that answer requests.")
    ] = 1,
    science: Annotated[
        str, typer.Option(help="fake: the exact twin; core: the blade physics.")
    ] = "fake",
    particles: Annotated[int, typer.Option(min=16, help="Particles per blade.")] = 64,
    database: Databases = "sqlite",
    window_s: Annotated[float, typer.Option(min=1, help="Length of a window, s.")] = 10.0,
    posts_ms: Annotated[
        float, typer.Option(min=0, help="Largest p99 of an acknowledgement, ms; 0: not judged.")
    ] = 250.0,
    reads_ms: Annotated[
        float, typer.Option(min=0, help="Largest p99 of a read, ms; 0: not judged.")
    ] = 100.0,
    scaling: Annotated[
        int, typer.Option(min=0, help="Entries of a backlog for one worker and two; 0: none.")
    ] = 4000,
    pairs: Annotated[int, typer.Option(min=1, help="Backlogs worked off by each of them.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of what is asked, and when.")] = 7,
    out: Annotated[Path | None, typer.Option(help="Folder of the result.")] = None,
) -> None:
    """A real server under load: latencies, memory and backlog over time, and what grows."""
    from service.studies.load import aims, backlog
    from service.studies.load import run as study
    from service.studies.load.plots import course_plot
    from service.studies.load.table import table

    if science not in ("fake", "core"):
        raise typer.BadParameter(f"{science!r} is neither fake nor core")
    end_in_order()
    began_on, made_by = machine(), commit()
    plan = study.Plan(
        minutes,
        rate,
        reads,
        rotors,
        blades,
        workers,
        api_processes,
        science,
        particles,
        window_s,
        seed,
    )
    asked = {name: ms for name, ms in (("posts", posts_ms), ("reads", reads_ms)) if ms > 0}
    results: dict[str, Any] = {}
    with places(database) as chosen, tempfile.TemporaryDirectory(prefix="bladetwin-log-") as logs:
        for name, url, folder in chosen:
            begun, log = time.monotonic(), Path(logs) / name
            with bar(f"seconds, {name}", round(60 * minutes)) as step:
                told = study.loaded(plan, url("loaded"), folder, log, step)
            told["faults"] = aims.faults(told, asked)
            told["passed"] = not told["faults"]
            if scaling:
                rows = []
                with bar(f"backlogs, {name}", 2 * pairs) as step:
                    for number, n in enumerate(aims.order(pairs)):
                        rows.append(
                            backlog.worked_off(plan, url(f"backlog_{number}"), n, scaling, log)
                        )
                        step(number + 1)
                told |= {"scaling": rows, "gain": aims.gain(rows)}
            results[name] = told | {"seconds": round(time.monotonic() - begun, 1)}
            if out is not None and (folder / "log").exists():
                out.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(folder / "log", out / f"{name}.log")
    passed = all(one["passed"] for one in results.values())
    head = {"machine": began_on, **asdict(plan), "aims_ms": asked, "passed": passed}
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        for name, one in results.items():
            title = (
                f"{rotors} rotors × {blades} blades on {name}: {rate:g} posts/s, {reads:g} reads/s"
            )
            course_plot(one["samples"], title, out / f"{name}.png", asked)
        (out / "table.md").write_text(table(head, results))
    write(head | {"databases": results}, made_by, out)
    if not passed:
        raise typer.Exit(1)
