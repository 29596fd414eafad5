"""The table of faults: each tried many times on each database, its outcomes in words."""

from __future__ import annotations

import os
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from service.ports import Json
from service.studies.chaos import cuts, damage, deaths, full_disk, traps
from service.studies.chaos.bench import Bench, in_turn
from service.studies.chaos.postgres import Server

Progress = Callable[[int], None]
Run = Callable[[Bench, int, Progress], Sequence[str]]
NUMBER = count(1)
BAD = ("NOT", "LATE", "LEFT", "OTHERWISE", "TAKEN FOR GOOD", "UNFORESEEN", "nothing was refused")
EVERYWHERE = ("sqlite", "postgresql")


@dataclass(frozen=True, slots=True)
class Fault:
    """What is done, on which databases; `versions`: whether none may be missing in the end."""

    name: str
    run: Run
    on: tuple[str, ...] = EVERYWHERE
    versions: bool = True


def _faults() -> Iterator[Fault]:
    for name, point in traps.WORKER.items():
        yield Fault(f"worker killed: {name}", in_turn(deaths.worker_dies(point)))
    for name, point in traps.API.items():
        yield Fault(f"API killed: {name}", in_turn(deaths.api_dies(point)))
    yield Fault("worker stopped beyond its lease, continued", deaths.stopped_beyond_lease)
    yield Fault("worker stopped in its commit, continued", deaths.stopped_in_commit)
    yield Fault("clock set while a worker computes", in_turn(cuts.clock_jumps))
    yield Fault("posts repeated and reordered", in_turn(damage.reordered))
    yield Fault("database locked by another process", cuts.locked, ("sqlite",))
    yield Fault("disk full", in_turn(cuts.disk_full), ("sqlite",))
    yield Fault("file may not grow", in_turn(cuts.file_too_large), ("sqlite",))
    for what in ("array", "description"):
        run = in_turn(damage.damaged(what))
        yield Fault(f"a byte of a stored {what} changed", run, versions=False)
    yield Fault("the newest version's row deleted", in_turn(damage.damaged("row")), versions=False)
    yield Fault("a byte of the log changed", in_turn(damage.damaged("entry")), versions=False)
    spoilt = in_turn(damage.damaged("rotor"))
    yield Fault("a byte of the rotor's row changed, or of a blade's", spoilt, versions=False)
    yield Fault("a byte of the model's artefact changed", in_turn(damage.artefact), ("sqlite",))


FAULTS: dict[str, Fault] = {fault.name: fault for fault in _faults()}
ON_SERVER: dict[str, Callable[[Server], str]] = {
    "connections ended by the database, under load": cuts.cut_off,
    "database server killed and restarted, under load": cuts.crash,
}
FULL_DISK = "disk of the database server full"
NAMES = (*FAULTS, *ON_SERVER, FULL_DISK)


@contextmanager
def database(kind: str, server: Server | None) -> Iterator[str]:
    """URL of an empty database."""
    if kind == "sqlite":
        with tempfile.TemporaryDirectory(prefix="bladetwin-fault-") as folder:
            yield f"sqlite:///{Path(folder) / 'fault.db'}"
        return
    assert server is not None
    name = f"fault_{os.getpid()}_{next(NUMBER)}"
    server.run(f"CREATE DATABASE {name}")
    yield server.url(name)
    server.run(f"DROP DATABASE {name} WITH (FORCE)")


def tried(fault: Fault, kind: str, url: str, trials: int, seed: int, progress: Progress) -> Json:
    """One row of the table."""
    bench, begun = Bench(url, seed), time.monotonic()
    try:
        outcomes = fault.run(bench, trials, progress)
        found = bench.check()
        faults = found.faults
        if not fault.versions:
            faults.pop("wrong_versions", None)
        return row(fault.name, kind, outcomes, faults, time.monotonic() - begun)
    except Exception as error:  # one fault that ends the study would hide all others
        return row(fault.name, kind, [_ended(error)], {}, time.monotonic() - begun)
    finally:
        bench.close()


def _ended(error: Exception) -> str:
    where = traceback.extract_tb(error.__traceback__)
    lines = ", ".join(f"{Path(one.filename).name}:{one.lineno}" for one in where[-6:])
    return f"NOT FINISHED: {error} ({lines})"


def tried_under_load(name: str, server: Server, url: str, trials: int, seed: int) -> Json:
    begun = time.monotonic()
    disturb = ON_SERVER[name]
    outcomes = cuts.under_load(url, trials, seed, lambda: disturb(server))
    return row(name, "postgresql", outcomes, {}, time.monotonic() - begun)


def tried_on_full_disk(trials: int, seed: int, progress: Progress) -> Json:
    """PostgreSQL on a disk of its own that fills up; it brings its own server."""
    begun = time.monotonic()
    try:
        outcomes, found = full_disk.run(trials, seed, progress)
        return row(FULL_DISK, "postgresql", outcomes, found.faults, time.monotonic() - begun)
    except Exception as error:
        return row(FULL_DISK, "postgresql", [_ended(error)], {}, time.monotonic() - begun)


def row(
    name: str, kind: str, outcomes: Sequence[str], faults: dict[str, list[str]], seconds: float
) -> Json:
    passed = not faults and not any(bad in one for one in outcomes for bad in BAD)
    return {
        "fault": name,
        "database": kind,
        "trials": len(outcomes),
        "outcomes": dict(Counter(outcomes).most_common()),
        "found_in_the_tables": {k: v[:5] for k, v in faults.items()},
        "seconds": round(seconds, 1),
        "passed": passed,
    }


def table(rows: Sequence[Json]) -> str:
    """The rows in markdown."""
    lines = ["| fault | database | trials | outcome | whole |", "|---|---|---|---|---|"]
    for one in rows:
        outcomes = "; ".join(f"{n} × {what}" for what, n in one["outcomes"].items())
        whole = "yes" if one["passed"] else "**no**"
        cells = (one["fault"], one["database"], str(one["trials"]), outcomes, whole)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"
