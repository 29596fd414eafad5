"""`bladetwin study power`: how large an effect has to be until it is noticed."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from service.progress import bar
from service.studies import app
from service.studies.result import commit, write

INK, ORACLE, SEARCH, CHANCE = "#1f3b63", "#b35806", "#2d7f5e", "0.55"
BESIDE = (
    ("alarm", ORACLE, "--", "an oracle that knows what to look for"),
    ("searched", SEARCH, "-.", "an oracle that searches the whole grammar"),
)
COLUMNS = 4
Curves = Mapping[str, Sequence[Mapping[str, float]]]


@app.command()
def power(
    sets: Annotated[int, typer.Option(min=1, help="Sets of each effect at each size.")] = 20,
    sizes: Annotated[
        list[float] | None, typer.Option("--size", help="In noises; may be given again.")
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="These conditions alone; may be given again.")
    ] = None,
    plan: Annotated[str, typer.Option(help="A plan whose effects are scaled.")] = "fleet-100",
    by: Annotated[
        str, typer.Option(help="Who is to notice: diagnosis, or the rotor's residuals.")
    ] = "diagnosis",
    particles: Annotated[int, typer.Option(help="Particles per blade.")] = 1000,
    seed: Annotated[int, typer.Option(help="Seed of noise, labels and calibrations.")] = 7,
    processes: Annotated[int, typer.Option(help="Processes that share out the sets.")] = 1,
    work: Annotated[
        Path, typer.Option(help="Folder of the finished sets; a cut study goes on there.")
    ] = Path("bladetwin-data/studies"),
    out: Annotated[Path | None, typer.Option(help="Folder of the result and its plot.")] = None,
) -> None:
    """Alarms over the size of an undeclared effect, beside what an oracle would notice."""
    from core.validation import effect_power as study

    start, made_by = time.monotonic(), commit()
    asked = tuple(sizes or study.SIZES)
    who = study.who(by)
    keys = study.planned(only, asked, sets, plan)
    with bar("sets", len(keys)) as step:
        found = study.run(
            keys,
            seed=seed,
            particles=particles,
            plan=plan,
            by=who,
            processes=processes,
            folder=work,
            commit=made_by,
            progress=lambda done, total: step(done),
        )
    curves = study.curves(found)
    asked_of = study.points(curves)
    with bar("what is possible", len(asked_of)) as step:
        best = study.bounds(asked_of, seed, particles, plan, step)
    facts: dict[str, Any] = {
        "plan": plan,
        "by": by,
        "seed": seed,
        "particles": particles,
        "sizes": list(asked),
        "seconds": round(time.monotonic() - start, 1),
        "errors": sum("error" in one for one in found),
        "curves": curves,
        "possible": best,
        "sets": found,
    }
    write(facts, made_by, out)
    if out is not None:
        power_plot(curves, best, out / "power.png", by)


def power_plot(curves: Curves, best: Curves, file: Path, by: str = "diagnosis") -> None:
    """One small picture for each effect: alarms with their errors, the oracles', false alarms."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    sound = [row for rows in curves.values() for row in rows if row["size"] == 0]
    names = [name for name, rows in curves.items() if any(row["size"] > 0 for row in rows)]
    columns = min(COLUMNS, len(names))
    rows = -(-len(names) // columns)
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(max(2.7 * columns + 0.6, 4.0), 2.3 * rows + 1.2),
        squeeze=False,
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    for axis in axes.ravel()[len(names) :]:
        axis.set_visible(False)
    for axis, name in zip(axes.ravel(), names, strict=False):
        own = [*sound, *(row for row in curves[name] if row["size"] > 0)]
        axis.axhline(5, color=CHANCE, lw=1, ls=":", label="nominal false alarms, 5 %")
        for what, colour, dashes, label in BESIDE if name in best else ():
            axis.plot(
                [row["size"] for row in best[name]],
                [100 * row[what] for row in best[name]],
                color=colour,
                lw=1.4,
                ls=dashes,
                marker=".",
                label=label,
            )
        axis.errorbar(
            [row["size"] for row in own],
            [100 * row["alarms"] for row in own],
            yerr=[100 * row["error"] for row in own],
            color=INK,
            marker="o",
            ms=4,
            lw=1.6,
            capsize=2,
            label=f"{by}, ± standard error",
        )
        axis.set_title(name, fontsize=10)
        axis.set_ylim(-3, 105)
        axis.tick_params(labelsize=8, labelbottom=True)
    for axis in axes[:, 0]:
        axis.set_ylabel("alarms [%]", fontsize=9)
    for axis in axes.ravel()[max(len(names) - columns, 0) : len(names)]:
        axis.set_xlabel("size of the effect [noises]", fontsize=9)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    across = 2 if columns == COLUMNS else 1  # two words beside one another want the whole width
    figure.legend(
        handles, labels, loc="outside upper center", ncols=across, frameon=False, fontsize=9
    )
    figure.savefig(file, dpi=110)
    plt.close(figure)
