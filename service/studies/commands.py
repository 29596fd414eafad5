"""`bladetwin study coverage`, `seeds`, `rotors` and `schedule`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from service.progress import bar
from service.studies import app
from service.studies.result import commit, write

Out = Annotated[Path | None, typer.Option(help="Folder of the result and its plots.")]
Seed = Annotated[int, typer.Option(help="Seed of the truths and the noise.")]
Blades = Annotated[int | None, typer.Option(help="Blades of each rotor; default: the variant's.")]
VARIANT_HELP = (
    "rotor-100, rotor-20, first-outage, six-outages, mixed, thin-coating, coating-at-bounds, "
    "eight-shared, fe, fe-six-outages, fe-mixed, fe-nu, fe-nu-six-outages, fe-nu-mixed or "
    "six-locals."
)


@app.command()
def coverage(
    variant: Annotated[str, typer.Argument(help=VARIANT_HELP)] = "rotor-20",
    rotors: Annotated[int, typer.Option(help="Simulated rotors; none is dropped.")] = 200,
    blades: Blades = None,
    particles: Annotated[int, typer.Option(help="Particles per blade.")] = 4000,
    seed: Seed = 7,
    processes: Annotated[int, typer.Option(help="Processes that share out the rotors.")] = 1,
    work: Annotated[
        Path, typer.Option(help="Folder of the finished rotors; a cut study goes on there.")
    ] = Path("bladetwin-data/studies"),
    out: Out = None,
) -> None:
    """Simulation-based calibration: ranks and coverage of truths, with wrong samplers beside."""
    from core.validation.coverage import run
    from core.validation.variants import model_of, plan
    from core.validation.verdict import curves, summary
    from service.studies.plots import coverage_plot, rank_plot

    chosen = plan(variant, blades)
    start, made_by = time.monotonic(), commit()
    with bar(f"{chosen.name} rotors", rotors) as step:
        records = run(
            chosen,
            rotors=rotors,
            seed=seed,
            particles=particles,
            processes=processes,
            folder=work,
            commit=made_by,
            progress=lambda done, total: step(done),
        )
    found = curves(records)
    result = summary(records, found, parameters=chosen.truth != "bounds")
    facts = {
        "variant": chosen.name,
        "model": model_of(chosen).digest,
        "seed": seed,
        "blades": chosen.blades,
        "outages_h": chosen.outages_h,
        "held_out_h": chosen.held_out_h,
        "particles": particles,
        "seconds": round(time.monotonic() - start, 1),
    }
    write(facts | result, made_by, out)
    if out is not None:
        title = f"{chosen.name}: {rotors} rotors of {chosen.blades} blades"
        rank_plot(found, title, out / "ranks.png")
        coverage_plot(result["table"], title, out / "coverage.png")


@app.command()
def seeds(
    variant: Annotated[str, typer.Argument(help=VARIANT_HELP)] = "rotor-100",
    number: Annotated[int, typer.Option("--seeds", help="Seeds of the calibration.")] = 8,
    rotors: Annotated[int, typer.Option(help="Simulated rotors.")] = 3,
    blades: Blades = None,
    particles: Annotated[int, typer.Option(help="Particles per blade.")] = 10_000,
    seed: Seed = 7,
    out: Out = None,
) -> None:
    """Monte-Carlo error: the spread of every published mean between seeds, in posterior sd."""
    from core.validation.seeds import spread
    from core.validation.variants import model_of, plan

    chosen = plan(variant, blades)
    model = model_of(chosen)
    start, made_by = time.monotonic(), commit()
    with bar("calibrations", rotors * number) as step:
        result = spread(
            model,
            chosen,
            rotors=rotors,
            seed=seed,
            seeds=number,
            particles=particles,
            progress=lambda done, total: step(done),
        )
    facts = {
        "variant": chosen.name,
        "model": model.digest,
        "seed": seed,
        "rotors": rotors,
        "seeds": number,
        "blades": chosen.blades,
        "particles": particles,
        "seconds": round(time.monotonic() - start, 1),
    }
    write(facts | result, made_by, out)


@app.command()
def rotors(
    work: Annotated[Path, typer.Option(help="Folder of the runs; a cut campaign goes on.")] = Path(
        "bladetwin-data/rotors"
    ),
    processes: Annotated[int, typer.Option(help="Processes that compute runs.")] = 1,
    out: Annotated[Path, typer.Option(help="File of the rotors.")] = Path(
        "bladetwin-data/fe_rotors.npz"
    ),
    collect: Annotated[bool, typer.Option(help="Run nothing, keep the whole rotors.")] = False,
) -> None:
    """Finite-element runs of whole rotors, the truth of the variants fe …; about two hours."""
    from core.validation import fe_rotors

    if not collect:
        with bar("runs", fe_rotors.ROTORS * fe_rotors.BLADES) as step:
            fe_rotors.run(work, processes, lambda done, total: step(done))
    out.parent.mkdir(parents=True, exist_ok=True)
    made = fe_rotors.make(work, out)
    typer.echo(f"{len(made.inputs)} rotors of {fe_rotors.BLADES} blades in {out}")


@app.command()
def schedule(
    rotors: Annotated[int, typer.Option(help="Simulated rotors; none is dropped.")] = 20,
    disturbed: Annotated[
        int, typer.Option(help="Of these, how many with a discrepancy, and in turn, as well.")
    ] = 5,
    blades: Annotated[int, typer.Option(help="Blades of each rotor.")] = 10,
    particles: Annotated[int, typer.Option(help="Particles of each set.")] = 1000,
    shipped: Annotated[bool, typer.Option(help="The shipped inspection plan as well.")] = True,
    seed: Seed = 7,
    out: Out = None,
) -> None:
    """The paper's Algorithm 1, offline and online, against the joint posterior."""
    from core.model import rotor_blade
    from core.validation import schedule_rotors
    from core.validation import schedule_study as study
    from core.validation.schedule_tables import summary
    from core.validation.variants import plan

    start, made_by, model = time.monotonic(), commit(), rotor_blade()
    kind = plan("mixed", blades)
    with bar("simulated rotors", rotors) as step:
        records = study.run(
            kind, rotors=rotors, disturbed=disturbed, seed=seed, particles=particles, progress=step
        )
    same = [study.same_in_turn(model, kind, r, seed, particles) for r in range(disturbed)]
    result = {
        "model": model.digest,
        "seed": seed,
        "rotors": rotors,
        "disturbed": disturbed,
        "blades": blades,
        "particles": particles,
        "joint_online_is_offline": sum(same),
        **summary(records, (*study.PLAIN, *study.WITH_DISCREPANCY)),
    }
    if shipped:
        made = schedule_rotors.shipped(model)
        with bar("inspection plan", len(study.ON_PLAN)) as step:
            record = {}
            for done, case in enumerate(study.ON_PLAN, 1):
                record[case] = study.outcome(case, made, particles, seed)
                step(done)
        result["plan"] = summary([record], study.ON_PLAN)
    write(result | {"seconds": round(time.monotonic() - start, 1)}, made_by, out)
