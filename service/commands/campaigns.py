"""`bladetwin model runs`: the finite-element runs of a built-in model, by any number of workers."""

from __future__ import annotations

import resource
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from service.commands import Json, say
from service.progress import bar

Dask = Annotated[
    str | None,
    typer.Option(
        help="Compute on a Dask cluster (extra `dask`): tcp://host:port, or local:N processes."
    ),
]


class Part(StrEnum):
    """Which runs of a plan."""

    ALL = "all"
    TRAINING = "training"


def runs(
    name: Annotated[str, typer.Argument(help="rotor-blade or rotor-blade-wide.")] = "rotor-blade",
    archive: Annotated[
        Path, typer.Option(help="Folder of the runs; goes on where it was cut.")
    ] = Path("bladetwin-data/archive"),
    mesh: Annotated[str, typer.Option(help="Mesh: coarse, default, fine or paper.")] = "default",
    part: Annotated[Part, typer.Option(help="All runs, or those for training alone.")] = Part.ALL,
    seed: Annotated[int | None, typer.Option(help="Seed of the design.")] = None,
    workers: Annotated[int, typer.Option(help="Processes that compute runs.", min=1)] = 2,
    dask: Dask = None,
    as_json: Json = False,
) -> None:
    """Compute the finite-element runs of a built-in model, without training on them.

    The same command, given on several machines for one folder, shares the runs out: each run is
    computed once. One that is killed loses the runs in its hands, and the others take them over.
    """
    from core.builtin import plans, rotor_blade

    plan = plan_of(name)
    chosen = plans.SEED if seed is None else seed
    points = plans.design(chosen, plan=plan)[: plan.training if part == "training" else None]
    store = rotor_blade.open_archive(archive, mesh, chosen, plan)
    with bar("runs", len(points), quiet=as_json) as shown:
        done = rotor_blade.simulate(
            store,
            points,
            workers=workers,
            dask=dask,
            progress=lambda _name, finished, _total, _left: shown(finished),
            plan=plan,
        )
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    facts: dict[str, Any] = {"archive": str(archive), "runs": len(points)}
    facts |= {"computed": list(done.completed), "seconds": round(done.seconds, 1)}
    facts |= {"largest_process_mb": round(peak) if dask is None and done.completed else None}
    own = f"{len(done.completed)} of them computed here in {done.seconds:.0f} s"
    say(facts, [f"{archive}: {len(points)} runs, {own}"], as_json=as_json)


def plan_of(name: str) -> Any:
    """The plan of a built-in model."""
    from core.builtin import plans

    plan = plans.PLANS.get(name)
    if plan is None:
        known = " or ".join(plans.PLANS)
        raise typer.BadParameter(f"{name!r} is no built-in model; use {known}")
    return plan
