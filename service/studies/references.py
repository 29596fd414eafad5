"""`bladetwin study reference`."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from service.studies import app
from service.studies.result import commit, write

FOLDER = Path("tests/claims/results/reference")


@app.command()
def reference(
    rotors: Annotated[
        list[str] | None, typer.Argument(help="Rotors; by default what is stored.")
    ] = None,
    draws: Annotated[int, typer.Option(help="Draws of each chain.")] = 1500,
    chains: Annotated[int, typer.Option(help="Chains, side by side.")] = 32,
    accept: Annotated[float, typer.Option(help="Rate of acceptance of the chains.")] = 0.9,
    seed: Annotated[int, typer.Option(help="Seed of the chains.")] = 1,
    seeds: Annotated[int, typer.Option(help="Seeds of our own calibration.")] = 4,
    remake: Annotated[bool, typer.Option(help="Sample anew what is stored.")] = False,
    folder: Annotated[Path, typer.Option(help="Folder of the references.")] = FOLDER,
    out: Annotated[Path | None, typer.Option(help="Folder of the comparison.")] = None,
) -> None:
    """Reference posteriors by NUTS (extra `reference`), and ours against them."""
    # one thread, set before jax is loaded: processor seconds then mean something
    os.environ.setdefault(
        "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    )
    from core.validation.reference import make

    made_by = {"command": " ".join(["bladetwin", *sys.argv[1:]]), "commit": commit()}
    names = rotors or sorted(path.stem for path in folder.glob("*.json"))
    for name in names:
        if remake or not (folder / f"{name}.json").exists():
            made = make(name, seed=seed, draws=draws, chains=chains, accept=accept, made_by=made_by)
            made.save(folder)
    found = {name: compared(folder / f"{name}.json", range(seeds)) for name in names}
    write({"seeds": seeds, "rotors": found}, made_by["commit"], out)


def compared(file: Path, seeds: Sequence[int]) -> dict[str, Any]:
    """Our calibration of a stored rotor, once for each seed, against its reference."""
    from dataclasses import replace

    from core.calibration.online import update
    from core.validation.compare import Comparison, Moments
    from core.validation.reference import Stored

    kept = Stored.load(file)
    specs = [replace(kept.rotor, seed=seed) for seed in seeds]
    states = [update(kept.model, spec, kept.readings) for spec in specs]
    rows = [
        Comparison.of(Moments.of_state(kept.model, spec, state), kept.moments)
        for spec, state in zip(specs, states, strict=True)
    ]
    evidence = [s.meta["log_evidence"] - kept.head["log_evidence"]["value"] for s in states]
    return {
        "truth": kept.head["truth"],
        "blades": len(kept.moments.blades),
        "readings": len(kept.readings),
        "convergence": kept.head["convergence"],
        "ess": kept.head["ess"],
        "cpu_seconds": kept.head["nuts"]["cpu_seconds"],
        "ess_ratio": [s.meta["health"]["ess_ratio"] for s in states],
        "log_evidence": [round(v, 4) for v in evidence],
        "log_evidence_error": kept.head["log_evidence"]["error"],
        "first_seed": rows[0].table(),
        "worst": [
            {
                "mean": round(float(abs(row.mean).max()), 4),
                "ratio": [round(float(v), 4) for v in (row.ratio.min(), row.ratio.max())],
                "correlation": round(float(abs(row.correlation).max()), 4),
                "beyond": {what: len(cases) for what, cases in row.beyond().items()},
            }
            for row in rows
        ],
    }
