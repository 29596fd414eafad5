"""`bladetwin model build` and `model readings`: what comes with a release, computed again.

`build` makes a built-in model from its finite-element runs (`model runs` computes these alone, by
any number of workers: `service.commands.campaigns`), `readings` the truth runs of the main job,
with noise. Both go on where they stopped.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from service.commands import Json, say
from service.commands.campaigns import Dask, plan_of
from service.progress import bar
from service.studies.result import commit


def build(
    name: Annotated[str, typer.Argument(help="rotor-blade or rotor-blade-wide.")],
    out: Annotated[Path, typer.Option(help="Folder of the model.")] = Path("bladetwin-data"),
    mesh: Annotated[str, typer.Option(help="Mesh: coarse, default, fine or paper.")] = "default",
    seed: Annotated[int | None, typer.Option(help="Seed of the design.")] = None,
    workers: Annotated[int, typer.Option(help="Processes that compute runs.")] = 2,
    dask: Dask = None,
    archive: Annotated[
        Path | None,
        typer.Option(help="Folder of the runs; default: archive, in that of the model."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compute the finite-element runs and train the model again; resumes where it stopped.

    Runs that others compute into the same folder (`model runs`) are waited for.
    """
    from core.builtin import plans, rotor_blade

    plan = plan_of(name)
    chosen = plans.SEED if seed is None else seed
    shown: dict[str, Any] = {}
    with ExitStack() as bars:

        def progress(name: str, done: int, total: int, left: float) -> None:
            if name not in shown:
                shown[name] = bars.enter_context(bar(name, total, quiet=as_json))
            shown[name](done)

        surrogate = rotor_blade.build(
            out,
            mesh=mesh,
            seed=chosen,
            workers=workers,
            dask=dask,
            archive_dir=archive,
            progress=progress,
            commit=commit(),
            plan=plan,
        )
    facts = {"model": name, "digest": surrogate.digest, "folder": str(out)}
    say(facts, [f"{name}: digest {surrogate.digest[:12]}… in {out}"], as_json=as_json)


def readings(
    name: Annotated[str, typer.Argument(help="rotor-blade, or rotor-blade-worn.")],
    out: Annotated[Path, typer.Option(help="Folder of the truth runs.")] = Path("bladetwin-data"),
    workers: Annotated[int, typer.Option(help="Processes that compute runs.")] = 2,
    as_json: Json = False,
) -> None:
    """Compute the truth runs of the main job again, with noise; resumes where it stopped."""
    if name == "rotor-blade-worn":
        from core.builtin import worn_plan

        with bar("worn blades", len(worn_plan.WORN), quiet=as_json) as shown:
            runs = worn_plan.simulate_all(out / "worn", workers, lambda done, _: shown(done))
        file = out / "worn_plan.npz"
        plan = worn_plan.make(runs, file)
    elif name == "rotor-blade":
        from core.builtin import inspection_plan

        with bar("truth runs", len(inspection_plan.blades()), quiet=as_json) as shown:
            archive = inspection_plan.simulate(
                out / "truth", workers, lambda _name, done, _total, _left: shown(done)
            )
        file = out / "inspection_plan.npz"
        plan = inspection_plan.make(archive, file)
    else:
        raise typer.BadParameter(f"{name!r} is none; use rotor-blade or rotor-blade-worn")
    facts = {"file": str(file), "inspections": len(plan.inspections)}
    say(facts, [f"{facts['inspections']} inspections in {file}"], as_json=as_json)
