"""`bladetwin study contest`."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import typer

from service.progress import bar
from service.studies import app
from service.studies.chaos.commands import machine
from service.studies.result import commit, keep

DISTRIBUTIONS = ("scikit-learn", "numpy", "lightgbm", "xgboost-cpu", "xgboost", "catboost")


@app.command()
def contest(
    archive: Annotated[Path, typer.Option(help="Archive of runs; see `bladetwin model build`.")],
    training: Annotated[
        int, typer.Option(help="The first so many runs train, the others are independent.")
    ] = 66,
    only: Annotated[
        list[str] | None, typer.Option(help="A contestant, again for more; default: all seven.")
    ] = None,
    quick: Annotated[bool, typer.Option(help="Few folds, configurations and trees.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of folds, nodes and trees.")] = 7,
    work: Annotated[
        Path, typer.Option(help="Folder of the finished trials; a cut study goes on there.")
    ] = Path("bladetwin-data/studies"),
    out: Annotated[Path | None, typer.Option(help="Folder of result, table and plots.")] = None,
) -> None:
    """Seven regressors on the same features of the same runs, each tuned alike; all reported."""
    from core.archive import Archive
    from core.surrogate.contest import table
    from core.surrogate.contest.kept import keep as kept_runs
    from core.surrogate.contest.run import chosen, run, trials
    from core.surrogate.contest.trial import QUICK, Plan
    from service.studies.contest.tables import markdown

    begun, start, made_by, plan = machine(), time.monotonic(), commit(), QUICK if quick else Plan()
    contestants, missing = chosen(only or ())
    for name in missing:
        hint = "pip install 'bladetwin[contest]'"
        typer.echo(f"{name} is not installed and stays out: {hint}", err=True)
    opened = Archive.open(archive)
    runs = opened.done()
    with bar("runs read", len(runs)) as step:
        kept = kept_runs(opened, runs, nodes=plan.nodes, seed=seed, progress=step)
    with bar("trials", trials(len(contestants), plan.folds)) as step:
        found = run(
            kept,
            training,
            contestants,
            plan,
            seed=seed,
            clock=time.process_time,
            folder=work,
            progress=lambda done, total: step(done),
        )
    rows = table.rows(found)
    facts: dict[str, Any] = {
        "command": told_command(archive),
        "seed": seed,
        "machine": begun,
        "packages": versions(),
        "archive": {
            "made_by": opened.declaration.command,
            "mesh": opened.declaration.mesh,
            "nodes": opened.declaration.nodes,
            "finite_elements": opened.declaration.code,
            "training": training,
            "independent": len(runs) - training,
        },
        "plan": asdict(plan),
        "not_installed": missing,
        "rule": table.RULE,
        "best": table.best(rows),
        "features_hold": table.held(found),
        "rows": rows,
        "paper": table.PAPER,
        "seconds": round(time.monotonic() - start, 1),
    }
    keep(facts, made_by, out)
    text = markdown(facts)
    if out is not None:
        from service.studies.contest.plots import error_plot, tip_plot

        (out / "table.md").write_text(text, encoding="utf-8")
        tip_plot(found, rows, out / "tip.png")
        error_plot(rows, out / "errors.png")
    typer.echo(text)


def told_command(archive: Path) -> str:
    """The command line, the archive by its name alone: a result tells no paths.

    >>> import sys; sys.argv = ["bladetwin", "study", "contest", "--archive", "/a/b", "--out", "/c"]
    >>> told_command(Path("/a/b"))
    'bladetwin study contest --archive b'
    """
    return " ".join(["bladetwin", *without(sys.argv[1:], "--out", "--work", archive=archive.name)])


def without(words: Sequence[str], *folders: str, archive: str) -> list[str]:
    """The words less options that name folders, and the archive's folder by its name."""
    told, rest = [], iter(words)
    for word in rest:
        name, given, _ = word.partition("=")
        if name in (*folders, "--archive"):
            if not given:
                next(rest, None)
            told += ["--archive", archive] if name == "--archive" else []
        else:
            told.append(word)
    return told


def versions() -> dict[str, str]:
    """Of the libraries whose regressors can take part here."""
    found = {}
    for name in DISTRIBUTIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
