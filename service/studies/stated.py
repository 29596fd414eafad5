"""`bladetwin study stated`: what is told of a noise that is stated too small."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from service.progress import bar
from service.studies import app
from service.studies.result import commit, write


@app.command()
def stated(
    rotors: Annotated[int, typer.Option(min=1, help="Rotors, each with every factor.")] = 12,
    times: Annotated[
        list[float] | None,
        typer.Option(help="Times too small that sigma is; may be given again."),
    ] = None,
    plan: Annotated[
        str, typer.Option(help="rotor-20, or fleet-: 100, one-age, six-visits.")
    ] = "rotor-20",
    particles: Annotated[int, typer.Option(help="Particles per blade.")] = 1000,
    seed: Annotated[int, typer.Option(help="Seed of noise and labels.")] = 7,
    processes: Annotated[int, typer.Option(help="Processes that share out the rotors.")] = 1,
    work: Annotated[
        Path, typer.Option(help="Folder of the finished cases; a cut study goes on there.")
    ] = Path("bladetwin-data/studies"),
    out: Annotated[Path | None, typer.Option(help="Folder of the result and its plot.")] = None,
) -> None:
    """Finite-element rotors whose readings state a noise that is too small, or is not."""
    from core.validation import stated as study

    start, made_by = time.monotonic(), commit()
    factors = tuple(times or study.TIMES)
    with bar("cases", rotors * len(factors)) as step:
        found = study.run(
            rotors,
            factors,
            seed=seed,
            particles=particles,
            plan=plan,
            processes=processes,
            folder=work,
            commit=made_by,
            progress=lambda done, total: step(done),
        )
    facts: dict[str, Any] = {
        "plan": plan,
        "seed": seed,
        "particles": particles,
        "seconds": round(time.monotonic() - start, 1),
        "table": study.table(found),
        "cases": found,
    }
    write(facts, made_by, out)
    if out is not None:
        stated_plot(facts, out / "stated.png")


def stated_plot(facts: dict[str, Any], file: Path) -> None:
    """What is told over what is true, and rotors in which blades look exchanged."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4.2), layout="constrained")
    table, cases = facts["table"], facts["cases"]
    true = [float(name) for name in table]
    left.plot(true, true, color="0.55", lw=1, ls=":", label="as it is")
    left.scatter(
        [one["times"] for one in cases],
        [one["told"] or 1.0 for one in cases],
        s=20,
        c=["#1f3b63" if one["told"] else "0.6" for one in cases],
        alpha=0.75,
        label="told (grey at 1: nothing is)",
    )
    left.set_xlabel("times that sigma is stated too small")
    left.set_ylabel("times that the state tells")
    left.legend(loc="upper left", fontsize=8)
    places = range(len(table))
    for name, colour, shift, label in (
        ("exchanges believed", "#b35806", -0.2, "the noise is believed (control)"),
        ("exchanges", "#1f3b63", 0.2, "held against the scatter"),
    ):
        heights = [row[name] for row in table.values()]
        right.bar([p + shift for p in places], heights, 0.38, color=colour, label=label)
    right.set_xticks(list(places), list(table))
    right.set_xlabel("times that sigma is stated too small")
    right.set_ylabel(f"rotors of {facts['cases'][-1]['number'] + 1} with blades called exchanged")
    right.set_ylim(0, facts["cases"][-1]["number"] + 1)
    right.legend(loc="upper left", fontsize=8)
    figure.suptitle(f"No blade is exchanged: finite-element rotors ({facts['plan']})", fontsize=11)
    figure.savefig(file, dpi=130)
    plt.close(figure)
