"""`bladetwin study lives`: whether blades pass a limit when they are told to."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from service.progress import bar
from service.studies import app
from service.studies.result import commit, write

INK, TREND, CONTROL, BAND = "#1f3b63", "#b35806", "#c0392b", "#c9d6e8"
ROWS = (
    ("pit", "narrow", "each blade, when it passes"),
    ("any", "worst", "the rotor, when its first does"),
)
HELP = "rotor-20, rotor-100, first-outage, six-outages, fe, fe-nu or their like."


@app.command()
def lives(
    variant: Annotated[str, typer.Argument(help=HELP)] = "rotor-20",
    rotors: Annotated[int, typer.Option(help="Simulated rotors; none is dropped.")] = 200,
    blades: Annotated[int | None, typer.Option(help="Blades of each rotor.")] = None,
    particles: Annotated[int, typer.Option(help="Particles per blade.")] = 4000,
    seed: Annotated[int, typer.Option(help="Seed of the truths and the noise.")] = 7,
    processes: Annotated[int, typer.Option(help="Processes that share out the rotors.")] = 1,
    work: Annotated[
        Path, typer.Option(help="Folder of the finished rotors; a cut study goes on there.")
    ] = Path("bladetwin-data/studies"),
    out: Annotated[Path | None, typer.Option(help="Folder of the result and its plot.")] = None,
) -> None:
    """Chances to pass a limit, of blades and of the rotor, against when they truly pass it."""
    from core.validation import lives as study
    from core.validation.lives_table import curves, summary
    from core.validation.variants import model_of, plan

    chosen = plan(variant, blades)
    start, made_by = time.monotonic(), commit()
    with bar(f"{chosen.name} rotors", rotors) as step:
        found = study.run(
            chosen,
            rotors=rotors,
            seed=seed,
            particles=particles,
            processes=processes,
            folder=work,
            commit=made_by,
            progress=lambda done, total: step(done),
        )
    of = curves(found)
    result = summary(found, of)
    facts: dict[str, Any] = {
        "variant": chosen.name,
        "model": model_of(chosen).digest,
        "seed": seed,
        "blades": chosen.blades,
        "outages_h": chosen.outages_h,
        "next_outage_h": chosen.held_out_h,
        "particles": particles,
        "seconds": round(time.monotonic() - start, 1),
    }
    write(facts | result, made_by, out)
    if out is not None:
        title = f"{chosen.name}: {rotors} rotors of {chosen.blades} blades"
        lives_plot(of, result, chosen.held_out_h, title, out / "lives.png")


def lives_plot(
    of: Mapping[str, Mapping[str, Any]],
    result: Mapping[str, Any],
    next_h: float,
    title: str,
    file: Path,
) -> None:
    """Chances against shares that pass, and how the chances at the truths are spread."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from core.validation.sbc import PLACES

    figure = plt.figure(figsize=(13.5, 6.6), layout="constrained")
    grid = figure.add_gridspec(2, 1 + len(of), width_ratios=[1.35, *(1.0 for _ in of)])
    _by_next(figure.add_subplot(grid[:, 0]), result["reliability"], next_h)
    for row, (key, wrong, label) in enumerate(ROWS):
        for column, (name, own) in enumerate(of.items()):
            axis, one = figure.add_subplot(grid[row, 1 + column]), own[key]
            axis.fill_between(PLACES, one.lower - PLACES, one.upper - PLACES, color=BAND, lw=0)
            axis.axhline(0, color="0.5", lw=0.8)
            for found, colour, dashes in ((own[wrong], CONTROL, "--"), (one, INK, "-")):
                axis.plot(PLACES, found.share - PLACES, color=colour, ls=dashes, lw=1.5)
            axis.set(xlim=(0, 1))
            axis.tick_params(labelsize=8)
            if row == 0:
                axis.set_title(f"limit {name.replace(' x', ' ×')} the mean", fontsize=10)
            else:
                axis.set_xlabel("chance z told of that hour", fontsize=9)
            if column == 0:
                axis.set_ylabel(f"{label}\nF(z) − z", fontsize=9)
    handles = [
        Patch(color=BAND),
        Line2D([], [], color=INK, lw=1.5),
        Line2D([], [], color=CONTROL, lw=1.5, ls="--"),
    ]
    words = ["95 % simultaneous band", "bladetwin", "controls: too sure; the worst blade alone"]
    figure.legend(handles, words, loc="outside lower right", ncols=3, fontsize=9, frameon=False)
    figure.suptitle(title, fontsize=11)
    figure.savefig(file, dpi=120)
    plt.close(figure)


def _by_next(axis: Any, told: Mapping[str, Any], next_h: float) -> None:
    """Shares that pass by the next outage over the chances that were told."""
    axis.plot([0, 100], [0, 100], color="0.55", lw=1, ls=":")
    for who, colour, mark, label in (
        ("trend", TREND, "s", "trend through own readings"),
        ("twin", INK, "o", "bladetwin"),
    ):
        rows = told[who]
        axis.errorbar(
            [100 * r["told"] for r in rows],
            [100 * r["passed"] for r in rows],
            yerr=[200 * r["error"] for r in rows],
            color=colour,
            marker=mark,
            ms=5,
            lw=1.2,
            capsize=2,
            label=label,
        )
    axis.set(
        xlabel=f"chance told to pass by {next_h:,.0f} h [%]",
        ylabel="share that passes by then [%], ± 2 standard errors",
        xlim=(-3, 103),
        ylim=(-8, 108),
        title="by the next outage",
    )
    axis.legend(loc="upper left", fontsize=9, frameon=False)
