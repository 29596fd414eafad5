"""`bladetwin study histories`: inputs that change in time, the rule against finite elements."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from service.progress import bar
from service.studies import app
from service.studies.result import commit, write

MARKS = {"drift": "o", "step up": "^", "step down": "v", "cycle": "s"}


@app.command()
def histories(
    count: Annotated[int, typer.Option("--histories", help="How many.", min=4)] = 64,
    mesh: Annotated[str, typer.Option(help="Mesh of the runs; the surrogate is of default.")] = (
        "default"
    ),
    seed: Annotated[int, typer.Option(help="Seed of the histories.")] = 7,
    processes: Annotated[int, typer.Option(help="Processes that compute runs.")] = 1,
    work: Annotated[
        Path, typer.Option(help="Folder of the runs; a cut study goes on there.")
    ] = Path("bladetwin-data/histories"),
    out: Annotated[Path | None, typer.Option(help="Folder of the result and its plot.")] = None,
) -> None:
    """Drifting, stepping and cycling inputs: the rule of creep's memory against finite elements."""
    from core.validation import histories as study

    begun, made_by = time.monotonic(), commit()
    with bar("runs", 2 * count) as step:
        found = study.run(
            count,
            seed=seed,
            folder=work,
            mesh=mesh,
            processes=processes,
            progress=lambda done, _: step(done),
        )
    facts = {
        "histories": count,
        "mesh": mesh,
        "seed": seed,
        "seconds": round(time.monotonic() - begun, 1),
        "time_h": study.TIMES_H.tolist(),
        "summary": study.summary(found),
        "records": found,
    }
    write(facts, made_by, out)
    if out is not None:
        errors_plot(study.TIMES_H.tolist(), found, out / "errors.png")


def errors_plot(hours: Sequence[float], records: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Errors over the hours, one line a history; elongation and mean CEEQ."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.lines import Line2D

    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.2), sharey=True, layout="constrained")
    colours = {False: "#1f3b63", True: "#c0392b"}
    for q, (own, name) in enumerate(zip(axes, ("elongation", "mean CEEQ"), strict=True)):
        for band, shade in ((1.0, 0.14), (2.0, 0.07)):
            own.axhspan(-band, band, color="#1b7837", alpha=shade, lw=0)
        for one in records:
            own.plot(
                [h / 1000 for h in hours],
                [100.0 * v for v in one["off"][q]],
                marker=MARKS[one["kind"]],
                color=colours[one["tertiary"]],
                lw=0.7,
                ms=3.5,
                alpha=0.75,
            )
        own.set_xlabel("operating hours [1000 h]")
        own.set_title(name, fontsize=11)
    axes[0].set_ylabel("surrogate and rule over finite elements − 1 [%]")
    shown = [
        *(Line2D([], [], marker=m, color="#555555", lw=0, label=k) for k, m in MARKS.items()),
        Line2D([], [], color=colours[False], label="as shipped"),
        Line2D([], [], color=colours[True], label="strong tertiary creep"),
    ]
    figure.legend(handles=shown, loc="outside lower center", ncols=6, frameon=False, fontsize=9)
    figure.savefig(file, dpi=110)
    plt.close(figure)
