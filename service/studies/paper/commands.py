"""`bladetwin study paper`."""

from __future__ import annotations

import json
import resource
import time
from pathlib import Path
from typing import Annotated

import typer

from service.progress import bar
from service.studies import app
from service.studies.chaos.commands import machine
from service.studies.result import commit, keep


@app.command()
def paper(
    blades: Annotated[int, typer.Option(help="Blades, those that the paper names always.")] = 100,
    particles: Annotated[int, typer.Option(help="Particles per blade.")] = 4000,
    seed: Annotated[int, typer.Option(help="Seed of the calibrations.")] = 7,
    processes: Annotated[int, typer.Option(help="Processes: without delta, and with it.")] = 2,
    schedule: Annotated[
        int, typer.Option(help="Particles of the paper's Algorithm 1 beside; 0: not run.")
    ] = 0,
    out: Annotated[Path, typer.Option(help="Folder of page, figures and numbers.")] = Path(
        "bladetwin-data/paper"
    ),
    truth: Annotated[
        Path | None,
        typer.Option(help="Only run the finite elements of the held-out scan, into this file."),
    ] = None,
) -> None:
    """The paper's Sec. 4 remade: four calibrations, its figures, its statements beside ours."""
    if truth is not None:
        from core.validation import paper_scan

        made = paper_scan.make(truth)
        typer.echo(f"{made.deformation.shape[1]} nodes at {len(made.time_h)} instants in {truth}")
        return
    from core.builtin import inspection_plan
    from core.validation.paper import CASES, model_with
    from service.studies.paper.page import page
    from service.studies.paper.plots import draw_all
    from service.studies.paper.run import run
    from service.studies.paper.statements import judged

    start, made_by, began_on = time.monotonic(), commit(), machine()
    jobs = 2 + (len(CASES) if schedule else 0)
    with bar("calibrations", jobs) as step:
        study = run(
            blades=blades,
            particles=particles,
            seed=seed,
            processes=processes,
            schedule=schedule,
            progress=step,
        )
    pictures = draw_all(study, inspection_plan.load(), out)
    spent = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    numbers = {
        "model": model_with(False).digest,
        "machine": began_on,
        "seconds": round(time.monotonic() - start, 1),
        "cpu_s": round(sum(one.ru_utime + one.ru_stime for one in spent), 1),
        **study.numbers,
    }
    told = json.loads(keep(numbers, made_by, out))
    (out / "paper.html").write_text(page(told, judged(told), pictures), encoding="utf-8")
    for one in told["statements"]:
        typer.echo(f"{one['verdict']:<10} {one['quote']}")
    typer.echo(f"{out / 'paper.html'}: {told['seconds']} s, processor {told['cpu_s']} s")
