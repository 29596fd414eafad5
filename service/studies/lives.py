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

    from core.validation.sbc import PLACES

    figure, axes = plt.subplots(1, 1 + len(of), figsize=(13.0, 4.0), layout="constrained")
    left = axes[0]
    left.plot([0, 100], [0, 100], color="0.55", lw=1, ls=":")
    for who, colour, mark, label in (
        ("trend", TREND, "s", "trend through own readings"),
        ("twin", INK, "o", "bladetwin"),
    ):
        rows = result["reliability"][who]
        left.errorbar(
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
    left.set(
        xlabel=f"chance told to pass by {next_h:,.0f} h [%]",
        ylabel="share that passes by then [%], ± 2 standard errors",
        xlim=(-3, 103),
        ylim=(-8, 108),
        title="by the next outage",
    )
    left.legend(loc="upper left", fontsize=8, frameon=False)
    for axis, (name, own) in zip(axes[1:], of.items(), strict=True):
        one = own["pit"]
        axis.fill_between(PLACES, one.lower - PLACES, one.upper - PLACES, color=BAND, lw=0)
        axis.axhline(0, color="0.5", lw=0.8)
        lines = (("pit", INK, "-", "blades"), ("any", TREND, "-", "first of a rotor"))
        wrong = (("narrow", CONTROL, "--", "control: too sure"),)
        for key, colour, dashes, label in (*lines, *wrong):
            axis.plot(PLACES, own[key].share - PLACES, color=colour, ls=dashes, lw=1.5, label=label)
        axis.set(xlim=(0, 1), xlabel="chance z told by the hour at which it passes")
        axis.set_title(f"limit {name.replace(' x', ' ×')} what is expected then")
    axes[1].set_ylabel("F(z) − z; shaded: 95 % band of blades")
    axes[1].legend(loc="lower right", fontsize=8, frameon=False)
    figure.suptitle(title, fontsize=11)
    figure.savefig(file, dpi=120)
    plt.close(figure)
