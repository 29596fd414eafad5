"""`bladetwin study chaos`."""

from __future__ import annotations

import os
import platform
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from service.progress import bar
from service.studies import app
from service.studies.result import commit, keep, write

Out = Annotated[Path | None, typer.Option(help="Folder of the result.")]
Databases = Annotated[
    str, typer.Option(help="sqlite, postgresql or both; a PostgreSQL server is started for it.")
]


def machine() -> dict[str, Any]:
    """What a figure depends on."""
    load = [round(v, 1) for v in os.getloadavg()]
    return {
        "processors": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "load_when_begun": load,
    }


def end_in_order() -> None:
    """On SIGTERM a study ends as by an error: its processes and servers end with it."""
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))


@contextmanager
def databases(which: str) -> Iterator[list[tuple[str, list[str]]]]:
    """(name, two URLs of empty databases) of each database asked for."""
    from service.studies.chaos.postgres import Server

    if which not in ("sqlite", "postgresql", "both"):
        raise typer.BadParameter(f"{which!r} is none of sqlite, postgresql, both")
    found: list[tuple[str, list[str]]] = []
    with tempfile.TemporaryDirectory(prefix="bladetwin-chaos-") as folder:
        if which != "postgresql":
            found.append(("sqlite", [f"sqlite:///{folder}/{n}.db" for n in ("wild", "calm")]))
        if which == "sqlite":
            yield found
            return
        with Server() as server:
            server.run("CREATE DATABASE wild", "CREATE DATABASE calm")
            found.append(("postgresql", [server.url("wild"), server.url("calm")]))
            yield found


@app.command()
def chaos(
    rotors: Annotated[int, typer.Option(help="Rotors.")] = 20,
    readings: Annotated[int, typer.Option(help="Readings in all.")] = 10_000,
    kills: Annotated[int, typer.Option(help="How often a process is killed with -9.")] = 60,
    clients: Annotated[int, typer.Option(help="Clients that post side by side.")] = 8,
    blades: Annotated[int, typer.Option(help="Blades of each rotor.")] = 10,
    particles: Annotated[int, typer.Option(help="Particles per blade.")] = 64,
    science: Annotated[
        str, typer.Option(help="fake: the exact twin, quick; core: the blade physics.")
    ] = "fake",
    database: Databases = "both",
    seed: Annotated[int, typer.Option(help="Seed of the traffic and the kills.")] = 7,
    out: Out = None,
) -> None:
    """API and three workers killed while clients post: nothing lost, nothing applied twice."""
    from service.studies.chaos import chaos as study
    from service.studies.chaos import traffic

    if science not in ("fake", "core"):
        raise typer.BadParameter(f"{science!r} is neither fake nor core")
    end_in_order()
    began_on, made_by = machine(), commit()
    made = traffic.make(rotors, readings, blades, seed)
    lease_s = 2.0 if science == "fake" else 6.0
    pause_s = 0.0 if science == "fake" else 4.0
    plan = study.Plan(made, kills, clients, seed, particles, science, lease_s, pause_s=pause_s)
    results: dict[str, Any] = {}
    with databases(database) as chosen:
        for name, (wild, calm) in chosen:
            begun = time.monotonic()
            with bar(f"readings, {name}", made.readings) as step:
                found, ledger, facts = study.disturbed(plan, wild, step)
            told = study.verdict(found, ledger, study.undisturbed(plan, calm))
            told |= {"seconds": round(time.monotonic() - begun, 1)}
            results[name] = facts | told
    head = {
        "seed": seed,
        "machine": began_on,
        "science": science,
        "rotors": rotors,
        "blades": blades,
        "particles": particles,
        "readings": made.readings,
        "requests": len(made.batches),
        "clients": clients,
        "lease_s": lease_s,
        "workers": 3,
    }
    passed = all(one["passed"] for one in results.values())
    write(head | {"passed": passed, "databases": results}, made_by, out)
    if not passed:
        raise typer.Exit(1)


@app.command()
def faults(
    names: Annotated[
        list[str] | None, typer.Argument(help="Faults, by the beginning of their name; all.")
    ] = None,
    trials: Annotated[int, typer.Option(help="How often each is tried.")] = 20,
    database: Databases = "both",
    seed: Annotated[int, typer.Option(help="Seed of the readings and of what is chosen.")] = 7,
    out: Out = None,
) -> None:
    """Each fault many times: killed, stopped, cut off, locked, full, clock, repeated, damaged."""
    from service.studies.chaos import faults as study
    from service.studies.chaos.postgres import Server

    end_in_order()
    began_on, made_by = machine(), commit()
    kinds = ("sqlite", "postgresql") if database == "both" else (database,)
    wanted = [n for n in study.NAMES if not names or any(n.startswith(one) for one in names)]
    if not wanted:
        raise typer.BadParameter(f"no fault begins so; there are: {', '.join(study.NAMES)}")
    rows: list[dict[str, Any]] = []
    head = {"seed": seed, "trials": trials, "machine": began_on}
    with ExitStack() as stack:
        server = stack.enter_context(Server()) if "postgresql" in kinds else None
        for name in wanted:
            fault = study.FAULTS.get(name)
            for kind in kinds if fault is None else [k for k in kinds if k in fault.on]:
                if fault is None and kind == "sqlite":
                    continue
                with study.database(kind, server) as url, bar(name[:24], trials) as step:
                    if fault is not None:
                        rows.append(study.tried(fault, kind, url, trials, seed, step))
                    elif name == study.FULL_DISK:
                        rows.append(study.tried_on_full_disk(trials, seed, step))
                    elif server is not None:
                        rows.append(study.tried_under_load(name, server, url, trials, seed))
                if out is not None:  # a study that is cut leaves what it has
                    keep(head | {"rows": rows}, made_by, out)
                    (out / "table.md").write_text(study.table(rows))
    passed = all(row["passed"] for row in rows)
    write(head | {"passed": passed, "rows": rows}, made_by, out)
    if not passed:
        raise typer.Exit(1)
