"""`bladetwin study effects` and `truths`: how often a diagnosis names rightly, wrongly, or not."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from service.progress import bar
from service.studies import app
from service.studies.result import commit, write

OUTCOMES = ("right", "one", "in the set", "silent", "wrong")
COLOURS = ("#1b7837", "#5aae61", "#a6dba0", "#bbbbbb", "#b2182b")
WORDS = {
    "right": "right",
    "one": "one of two",
    "in the set": "not separable, truth in the set",
    "silent": "no name given",
    "wrong": "wrong name",
}


@app.command()
def effects(
    clean: Annotated[int, typer.Option(help="Sets of each kind without an effect.")] = 40,
    planted: Annotated[int, typer.Option(help="Sets of each planted effect.")] = 16,
    plan: Annotated[
        str,
        typer.Option(help="rotor-20, or fleet-: 100, one-age, six-visits, scans, scans-2."),
    ] = "rotor-20",
    size: Annotated[
        float, typer.Option(help="Change at the last visit in noises, where the plan is scaled.")
    ] = 2.0,
    only: Annotated[
        list[str] | None,
        typer.Option(help='These conditions alone, or "pairs"; may be given again.'),
    ] = None,
    particles: Annotated[int, typer.Option(help="Particles per blade.")] = 1000,
    seed: Annotated[int, typer.Option(help="Seed of noise, labels and calibrations.")] = 7,
    processes: Annotated[int, typer.Option(help="Processes that share out the sets.")] = 1,
    work: Annotated[
        Path, typer.Option(help="Folder of the finished sets; a cut study goes on there.")
    ] = Path("bladetwin-data/studies"),
    out: Annotated[Path | None, typer.Option(help="Folder of the result and its plot.")] = None,
) -> None:
    """Verdicts on finite-element rotors with and without undeclared effects, all sets counted."""
    from core.validation import effects_study as study
    from core.validation.effect_gains import improvement
    from core.validation.effect_oracle import bounds
    from core.validation.effect_plans import plan as plan_of
    from core.validation.effect_sets import CLEAN, conditions, pairs

    start, made_by = time.monotonic(), commit()
    possible = conditions(plan_of(plan))
    two = pairs(plan_of(plan))
    chosen = [c for name in only or possible for c in (two if name == "pairs" else (name,))]
    sets = {c: clean if c in CLEAN else planted for c in chosen}
    with bar("sets", sum(sets.values())) as step:
        found = study.run(
            sets,
            seed=seed,
            particles=particles,
            plan=plan,
            size=size,
            processes=processes,
            folder=work,
            commit=made_by,
            progress=lambda done, total: step(done),
        )
    table = study.table(found)
    planted_ones = [c for c in sets if c not in (*CLEAN, *two)]
    with bar("bounds", len(planted_ones)) as step:
        best = bounds(plan_of(plan), planted_ones, seed, particles, size, step, processes)
    facts = {
        "model": study.model_digest(),
        "plan": plan,
        **({"size": size} if plan_of(plan).scaled else {}),
        "seed": seed,
        "particles": particles,
        "seconds": round(time.monotonic() - start, 1),
        "table": table,
        "marks": study.marks(table),
        "possible": best,
        "improvement": improvement(found),
        "sets": found,
    }
    write(facts, made_by, out)
    if out is not None:
        outcome_plot(table, out / "outcomes.png")


@app.command()
def truths(
    fleet: Annotated[bool, typer.Option("--fleet", help="Those of the plan fleet-100.")] = False,
    one_age: Annotated[
        bool, typer.Option("--one-age", help="Those of the plan fleet-one-age.")
    ] = False,
    six_visits: Annotated[
        bool, typer.Option("--six-visits", help="Those of the plan fleet-six-visits.")
    ] = False,
    scans: Annotated[bool, typer.Option("--scans", help="Those of the plan fleet-scans.")] = False,
    rotor: Annotated[
        str, typer.Option(help="With --scans: second, those of fleet-scans-2.")
    ] = "first",
    work: Annotated[Path, typer.Option(help="Folder of the runs; a cut campaign goes on.")] = Path(
        "bladetwin-data/truths"
    ),
    out: Annotated[Path, typer.Option(help="Folder of the file of truths.")] = Path(
        "bladetwin-data"
    ),
    processes: Annotated[int, typer.Option(help="Processes that compute runs.")] = 1,
) -> None:
    """Finite-element runs with effects of physics, the truths of `effects`; about half an hour."""
    from core.validation import effect_fleet, effect_scans, effect_truths

    out.mkdir(parents=True, exist_ok=True)
    todo: Mapping[str, object]
    make: Callable[..., Path]
    if scans:
        shipped, todo = effect_scans.shipped(rotor), effect_scans.runs(rotor)
        make = partial(effect_scans.make, rotor=rotor)
    elif fleet or one_age or six_visits:
        of = effect_fleet.ONE_AGE if one_age else effect_fleet.FIVE_AGES
        of = effect_fleet.SIX_VISITS if six_visits else of
        shipped, todo = of.shipped, effect_fleet.runs(of)
        make = partial(effect_fleet.make, of=of)
    else:
        shipped, todo, make = effect_truths.SHIPPED, effect_truths.runs(), effect_truths.make
    with bar("runs", len(todo)) as step:
        file = make(work, out / shipped.name, processes, lambda done, _: step(done))
    typer.echo(f"truths of {len(todo)} runs in {file}")


def outcome_plot(table: Mapping[str, Mapping[str, float]], file: Path) -> None:
    """Each condition's outcomes as one bar."""
    import matplotlib
    import numpy as np

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    names = list(table)
    figure, axes = plt.subplots(figsize=(8.5, 0.42 * len(names) + 1.7), layout="constrained")
    left, at = np.zeros(len(names)), np.arange(len(names))
    for what, colour in zip(OUTCOMES, COLOURS, strict=True):
        share = np.array([100.0 * table[n].get(what, 0.0) for n in names])
        if what == "one" and not share.any():
            continue
        axes.barh(at, share, left=left, color=colour, label=WORDS[what], height=0.72)
        left += share
    labels = [f"{n} ({table[n]['sets']:.0f} sets)" for n in names]
    axes.set_yticks(at, labels)
    axes.invert_yaxis()
    axes.set_xlim(0, 100)
    axes.set_xlabel("share of the sets [%]")
    figure.legend(loc="outside upper center", ncols=5, frameon=False, fontsize=9)
    figure.savefig(file, dpi=110)
    plt.close(figure)
