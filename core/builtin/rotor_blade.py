"""The built-in model ``rotor-blade``: how it is made, and the made one.

`build` makes a design of 66 training and 34 independent test points (two maximin Latin
hypercubes, `core.design`), runs the finite elements (`core.blade`) into an archive that resumes
where it was cut, trains the surrogate on the 66, measures it on the 34 and writes the artefact
with its manifest. `load` reads the artefact shipped in ``rotor_blade_model/``; it was made by

    bladetwin model build rotor-blade

Everything is a function of the seed and of the finite-element code: a second build gives the
same design and the same runs, on the same numerical libraries the same digest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import core.blade
from core.archive import Archive, Input, Mesh, Run
from core.archive.shared import SharedRuns
from core.blade import DORMANT, BladeRun, Campaign, build_mesh, run_campaign
from core.builtin import shipped
from core.builtin.paper_network import rotor_blade_network
from core.builtin.plans import NAME, SEED, STANDARD, WIDE, Plan, design
from core.errors import ModelError
from core.network import Network, Parameter
from core.prior import Prior
from core.surrogate import Surrogate, save, train
from core.surrogate import load as load_artefact
from core.surrogate.compact import compact
from core.surrogate.contest import contest
from core.surrogate.report import errors, polynomial_error

MODEL = Path(__file__).with_name("rotor_blade_model")
WIDE_MODEL = Path(__file__).with_name("rotor_blade_wide_model")
QUANTITIES = ("ceeq", "creep_damage", "mises", "displacement", "elongation")
Progress = Callable[[str, int, int, float], None]
Array = NDArray[np.float64]


def as_run(run: BladeRun) -> Run:
    """A finite-element run as the archive stores it."""
    return Run(run.inputs, {name: getattr(run, name) for name in QUANTITIES})


def open_archive(
    directory: str | Path, mesh: str = "default", seed: int = SEED, plan: Plan = STANDARD
) -> Archive:
    """The archive of the plan's runs in `directory`, new or begun."""
    blade = build_mesh(mesh)
    return Archive.create(
        directory,
        inputs=[Input(name, low, high) for name, (low, high) in plan.bounds.items()],
        time_h=plan.time_h,
        mesh=Mesh(mesh, blade.points, blade.cells, blade.parametric, blade.named),
        seed=seed,
        command=plan.command,
        code=blade_digest(),
    )


def simulate(
    archive: Archive,
    points: Array,
    *,
    mesh: str | None = None,
    workers: int = 2,
    dask: str | None = None,
    progress: Progress | None = None,
    plan: Plan = STANDARD,
) -> Campaign:
    """Run the points (n, d) that `archive` lacks; `mesh` may be finer than the archive's own.

    Any number of processes and machines may do so at the same time on one archive, each run is
    computed by one of them (`core.archive.shared`). Returns when all runs are there; raises
    ModelError where some failed, here or elsewhere.
    """
    own = archive.declaration.mesh
    names = [item.name for item in archive.declaration.inputs]
    inputs = [dict(zip(names, map(float, x), strict=True)) for x in points]
    shared = SharedRuns(archive, range(len(points)))
    with shared.claims.beating():
        campaign = run_campaign(
            inputs,
            lambda index, run: shared.add(index, as_run(run)),
            mesh=mesh or own,
            onto=own,
            done=frozenset(archive.done()),
            todo=shared,
            processes=workers,
            dask=dask,
            code=blade_digest,
            progress=progress and (lambda done, total, left: progress("runs", done, total, left)),
            bounds=plan.bounds,
            time_h=plan.time_h,
            tolerance=plan.tolerance,
        )
    failed = [(failure.index, failure.reason) for failure in campaign.failures]
    if failed := sorted([*failed, *shared.failures]):
        index, reason = failed[0]
        raise ModelError(
            f"{len(failed)} of {len(points)} runs failed; run {index} at {inputs[index]}: {reason}"
        )
    return campaign


def build(
    out_dir: str | Path,
    mesh: str = "default",
    seed: int = SEED,
    workers: int = 2,
    progress: Progress | None = None,
    *,
    dask: str | None = None,
    archive_dir: str | Path | None = None,
    training: int | None = None,
    test: int | None = None,
    commit: str | None = None,
    plan: Plan = STANDARD,
) -> Surrogate:
    """Make the model into `out_dir`; the runs go to `archive_dir` (default ``out_dir/archive``).

    A build that was cut goes on where it was, unless the finite elements have changed since; runs
    that other workers compute meanwhile (`simulate`) are waited for.
    `commit` is noted in the manifest beside the digest of the finite-element code. A model
    without test runs (`test` = 0) reports no errors.
    """
    training = plan.training if training is None else training
    test = plan.test if test is None else test
    points = design(seed, training, test or 2, plan)[: training + test]
    archive = open_archive(archive_dir or Path(out_dir) / "archive", mesh, seed, plan)
    simulate(archive, points, workers=workers, dask=dask, progress=progress, plan=plan)
    runs = range(training), range(training, training + test)
    return finish(archive, out_dir, *runs, commit, plan.name)


def finish(
    archive: Archive,
    out_dir: str | Path,
    training: Sequence[int],
    test: Sequence[int],
    commit: str | None = None,
    name: str = NAME,
) -> Surrogate:
    """Train on runs of an archive, measure on others, write the artefact."""
    declared = archive.declaration
    model = compact(train(archive, training, seed=declared.seed))
    manifest: dict[str, Any] = {
        **model.manifest,
        "name": name,
        "command": declared.command,
        "seed": declared.seed,
        "mesh": declared.mesh,
        "nodes": declared.nodes,
        "runs": {"training": len(training), "test": len(test)},
        "finite_elements": {"digest": declared.code, "commit": commit},
        "contest": contest(archive, training, seed=declared.seed),
        "errors": errors(model, archive, test) if test else None,
        "polynomials": polynomial_error(model, seed=declared.seed),
    }
    return save(replace(model, manifest=manifest), out_dir)


WHERE_AND_WHEN = ("campaign.py", "kept.py", "spread.py")


def blade_digest() -> str:
    """SHA-256 of the finite-element code's source files, by name.

    Without those that say where and when runs are computed: an archive that was begun goes on
    after they have changed.
    """
    total = sha256()
    for file in sorted(Path(core.blade.__file__).parent.glob("*.py")):
        if file.name in WHERE_AND_WHEN:
            continue
        total.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return total.hexdigest()


@cache
def load() -> Surrogate:
    """The shipped artefact, read once per process."""
    return load_artefact(MODEL, shipped.WHOLE[MODEL.name])


@cache
def load_wide() -> Surrogate:
    """The shipped artefact of the wide plan, read once per process."""
    return load_artefact(WIDE_MODEL, shipped.WHOLE[WIDE_MODEL.name])


def wide_network() -> Network:
    """The paper's network on the wide plan: the same priors, and the dormant inputs asleep."""
    network = rotor_blade_network()
    asleep = tuple(
        Parameter(name, "dormant", Prior("uniform", one.low, one.high), nominal=one.nominal)
        for name, one in DORMANT.items()
    )
    return replace(network, name=WIDE.name, parameters=(*network.parameters, *asleep))
