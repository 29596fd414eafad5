"""The command that makes the reference posteriors and the table against ours anew.

Each rotor's readings are fixed by a seed (or are the shipped inspection plan's), chosen by the
truth alone: cold to hot, small to large noise. The files lie under
``tests/claims/results/reference/``, so that a test needs no numpyro.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from core.model import Model
    from core.observation import Inspection

FOLDER = Path("tests/claims/results/reference")
SEED = 41
THREE_H, SIX_H = (8e3, 16e3, 24e3), (4e3, 8e3, 12e3, 16e3, 20e3, 24e3)
PARTICLES = 10_000
# name: (number of the simulated rotor, blades, outages [h]); chosen by its truth alone
ROTORS: dict[str, tuple[int, int, tuple[float, ...]]] = {
    "small": (5, 2, (16e3,)),  # T1T 0.935, sigma 0.026 mm
    "warm": (13, 20, THREE_H),  # 0.910, 0.028
    "cold": (10, 20, THREE_H),  # 0.823, 0.014
    "hot": (14, 20, THREE_H),  # 0.983, 0.0071
    "six-outages": (7, 20, SIX_H),  # 0.866, 0.029
    "quiet": (9, 20, THREE_H),  # 0.844, 0.0031
}
MIXED = "table-1"  # the shipped plan: finite elements on another mesh; one scan, three CEEQ
MIXED_BLADES = tuple(f"B{i:03d}" for i in (*range(1, 10), 28, 82, 99))


def readings_of(
    model: Model, name: str
) -> tuple[tuple[str, ...], list[Inspection], dict[str, float]]:
    """Blades, readings and truth of one of the rotors."""
    from core.builtin import inspection_plan
    from core.validation.compare import of_plan
    from core.validation.coverage import simulate

    if name == MIXED:
        found = [i for i in of_plan() if i.blade in MIXED_BLADES]
        found = [i for i in found if i.quantity != "deformation" or i.campaign == "outage-2"]
        return MIXED_BLADES, found, {"t1t_rate": inspection_plan.T1T_RATE}
    number, blades, times = ROTORS[name]
    shared, local, readings, _ = simulate(model, number, blades, (*times, 32e3), SEED, "elongation")
    return tuple(local), readings, shared


def make(name: str, draws: int, chains: int, seed: int) -> None:
    """Sample one rotor and store it."""
    from core.calibration.state import RotorSpec
    from core.model import rotor_blade
    from core.rng import stream
    from core.validation.compare import ours, stored
    from core.validation.nuts import Target, Tubes, joint_draws, sample

    model = rotor_blade()
    blades, readings, truth = readings_of(model, name)
    rotor = RotorSpec(name, blades, PARTICLES)
    target = Target.of(model, rotor, readings)
    _, states = ours(model, rotor, readings)
    tubes = Tubes.fitted(target, *joint_draws(target, states[0], stream(seed, "tubes", name)))
    reference = sample(target, seed=seed, tubes=tubes, draws=draws, chains=chains)
    stored(model, rotor, readings, reference, truth).save(FOLDER)


def compared(name: str, seeds: Sequence[int]) -> dict[str, Any]:
    """Our calibration of a stored rotor, once for each seed, against its reference."""
    import numpy as np

    from core.model import rotor_blade
    from core.validation.compare import Comparison, Stored, ours

    kept, model = Stored.load(FOLDER / f"{name}.json"), rotor_blade()
    found, states = ours(model, kept.rotor, kept.readings, seeds)
    rows = [Comparison.of(m, kept.moments) for m in found]
    return {
        "rotor": name,
        "truth": kept.head["truth"],
        "nuts": {
            **{k: kept.head["nuts"][k] for k in ("divergences", "seconds", "cpu_seconds")},
            **{k: kept.head[k] for k in ("worst_r_hat", "least_ess_of_blades", "shared")},
        },
        "ess_ratio": [s.meta["health"]["ess_ratio"] for s in states],
        "log_evidence": [round(s.meta["log_evidence"], 4) for s in states],
        "first_seed": rows[0].table(),
        "worst_mean_of_seeds": round(max(float(np.abs(r.mean).max()) for r in rows), 4),
        "beyond": rows[0].beyond(),
        "beyond_by_three_errors": rows[0].beyond(3.0),
        "compared": {
            "means": rows[0].mean.size,
            "correlations": len(rows[0].blades)
            * rows[0].mean.shape[1]
            * (rows[0].mean.shape[1] - 1)
            // 2,
        },
    }


def reference(
    rotors: Annotated[list[str] | None, typer.Argument(help="Rotors; all by default.")] = None,
    draws: Annotated[int, typer.Option(help="Draws of each chain.")] = 600,
    chains: Annotated[int, typer.Option(help="Chains, side by side.")] = 8,
    seed: Annotated[int, typer.Option(help="Seed of the chains.")] = 1,
    seeds: Annotated[int, typer.Option(help="Seeds of our own calibration.")] = 4,
    remake: Annotated[bool, typer.Option(help="Sample anew what is stored.")] = False,
    out: Annotated[Path | None, typer.Option(help="JSON file of the table.")] = None,
) -> None:
    """Reference posteriors by NUTS (extra `reference`), and ours against them."""
    # one thread, before jax is loaded: processor seconds then mean something
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
    found = []
    for name in rotors or [*ROTORS, MIXED]:
        if remake or not (FOLDER / f"{name}.json").exists():
            make(name, draws, chains, seed)
        found.append(compared(name, range(seeds)))
    text = json.dumps(
        {"command": " ".join(["bladetwin", *sys.argv[1:]]), "rotors": found}, indent=1
    )
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text + "\n")
    typer.echo(text)
