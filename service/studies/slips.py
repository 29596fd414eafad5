"""`bladetwin study slips`: what one mistyped reading does to a rotor."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from service.progress import bar
from service.studies import app
from service.studies.result import commit, write

BOUNDED, UNBOUNDED = "#1f3b63", "#b35806"


@app.command()
def slips(
    cases: Annotated[int, typer.Option(min=1, help="Rotors with a slip, of each kind.")] = 24,
    only: Annotated[
        list[str] | None, typer.Option(help="These kinds alone; may be given again.")
    ] = None,
    plan: Annotated[
        str, typer.Option(help="rotor-20, or fleet-: 100, one-age, six-visits.")
    ] = "rotor-20",
    condition: Annotated[
        str, typer.Option(help="What the model lacks, as in study effects; each: all in turn.")
    ] = "clean",
    particles: Annotated[int, typer.Option(help="Particles per blade.")] = 1000,
    seed: Annotated[int, typer.Option(help="Seed of noise, labels and slips.")] = 7,
    processes: Annotated[int, typer.Option(help="Processes that share out the cases.")] = 1,
    work: Annotated[
        Path, typer.Option(help="Folder of the finished cases; a cut study goes on there.")
    ] = Path("bladetwin-data/studies"),
    out: Annotated[Path | None, typer.Option(help="Folder of the result and its plot.")] = None,
) -> None:
    """One reading of a finite-element rotor written down wrongly: who is carried away by it."""
    from core.validation import slips as study

    start, made_by = time.monotonic(), commit()
    kinds = dict.fromkeys(only or study.KINDS, cases)
    with bar("cases", sum(kinds.values())) as step:
        found = study.run(
            kinds,
            seed=seed,
            particles=particles,
            plan=plan,
            condition=condition,
            processes=processes,
            folder=work,
            commit=made_by,
            progress=lambda done, total: step(done),
        )
    facts: dict[str, Any] = {
        "plan": plan,
        "condition": condition,
        "seed": seed,
        "particles": particles,
        "seconds": round(time.monotonic() - start, 1),
        "table": study.table(found),
        "cases": found,
    }
    write(facts, made_by, out)
    if out is not None:
        slips_plot(found, plan, out / "slips.png")


def slips_plot(found: Sequence[Mapping[str, Any]], plan: str, file: Path) -> None:
    """By how much each slip moves the gas temperature, over its size."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7.5, 4.4), layout="constrained")
    for when, colour, mark, label in (
        ("unbounded", UNBOUNDED, "x", "every blade counts in full (control)"),
        ("moved", BOUNDED, "o", "what contradicts is bounded"),
    ):
        sizes = [r["off"] for r in found]
        shifts = [max(abs(r[when]), 1e-3) for r in found]
        axes.scatter(sizes, shifts, s=18, c=colour, marker=mark, alpha=0.75, label=label)
    axes.set(xscale="log", yscale="log", ylim=(7e-4, None))
    axes.axhline(1.0, color="0.55", lw=1, ls=":")
    axes.set_xlabel("size of the slip [noises of a reading]")
    axes.set_ylabel("shift of the gas temperature [posterior sds]\n(0.001 and less at the bottom)")
    axes.set_title(f"One wrong reading: {len(found)} finite-element rotors ({plan})")
    axes.legend(loc="upper left", fontsize=8)
    figure.savefig(file, dpi=130)
    plt.close(figure)
