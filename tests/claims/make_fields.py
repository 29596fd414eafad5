"""Makes results/fields-wide/result.json: what the bands of whole fields by `rotor-blade-wide` hold.

    python -m tests.claims.make_fields [--blades 24] [--seed N] [--beside FOLDER] [--out FILE]

Finite elements of blades where they live: gas and creep from the priors, coatings over all that the
wide model's near runs cover, nothing that sleeps awake. At six hours all nodes of four fields are
compared with the wide surrogate by itself, and with another artefact of it where one is given. None
is dropped; a node that does not move at all is left out.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from core.blade import DORMANT, BladeRun, run_campaign
from core.builtin.paper_network import rotor_blade_network
from core.builtin.plans import WIDE
from core.builtin.rotor_blade import load_wide
from core.rng import stream
from core.surrogate import Surrogate, load
from service.studies.result import commit

FILE = Path(__file__).with_name("results") / "fields-wide" / "result.json"
HOURS = (1000.0, 5000.0, 10_000.0, 20_000.0, 30_000.0, 50_000.0)
FIELDS = ("ceeq", "creep_damage", "mises", "deformation")
COATING = "tbc_thickness"
BANDS = {"68": 1.0, "95": 1.959964}
Array = NDArray[np.float64]
Json = dict[str, Any]


def drawn(blades: int, seed: int) -> list[dict[str, float]]:
    """Inputs of so many blades."""
    rng, network = stream(seed, "fields-wide"), rotor_blade_network()
    assert WIDE.near is not None
    low, high = WIDE.near.bounds[COATING]
    found = []
    for _ in range(blades):
        own = {
            p.name: float(p.prior.quantile(rng.random(1))[0])
            for p in network.parameters
            if p.name in WIDE.bounds
        }
        found.append(own | {COATING: float(rng.uniform(low, high))})
    return found


def simulated(inputs: list[dict[str, float]]) -> list[BladeRun]:
    """Their finite elements at `HOURS`, in order."""
    runs: dict[int, BladeRun] = {}

    def keep(index: int, run: BladeRun) -> None:
        runs[index] = run
        print(f"{len(runs)} of {len(inputs)} blades", file=sys.stderr, flush=True)

    options = {"time_h": np.array([0.0, *HOURS]), "bounds": WIDE.bounds}
    campaign = run_campaign(inputs, keep, tolerance=WIDE.tolerance, processes=2, **options)
    if campaign.failures:
        raise SystemExit(f"{len(campaign.failures)} runs failed: {campaign.failures[0].reason}")
    return [runs[k] for k in range(len(inputs))]


def of_blade(run: BladeRun, name: str, mean: Array, sd: Array) -> Json:
    """Shares inside the bands, over all rows and hours of one blade, and relative errors."""
    true = getattr(run, name)[1:].astype(float)
    moved = sd > 0
    off = np.abs(true - mean)
    size = np.abs(true) if true.ndim == 2 else np.linalg.norm(true, axis=2, keepdims=True)
    relative = (off / np.maximum(size, 1e-300))[moved]
    told: Json = {band: float(np.mean((off <= k * sd)[moved])) for band, k in BANDS.items()}
    return told | {
        "off, median": float(np.median(relative)),
        "off, 95th percentile": float(np.quantile(relative, 0.95)),
    }


def compared(surrogate: Surrogate, inputs: list[dict[str, float]], runs: list[BladeRun]) -> Json:
    """By field: the mean over blades of what `of_blade` tells, the least, and all of them."""
    asleep = {name: one.nominal for name, one in DORMANT.items()}
    told: Json = {"digest": surrogate.digest}
    for name in FIELDS:
        blades = []
        for own, run in zip(inputs, runs, strict=True):
            x = np.array([[(asleep | own)[i.name] for i in surrogate.inputs]])
            mean, sd = surrogate.predict(x, name, list(HOURS))
            blades.append(of_blade(run, name, mean[0], sd[0]))
        every: Mapping[str, list[float]] = {k: [b[k] for b in blades] for k in blades[0]}
        told[name] = {k: float(np.mean(v)) for k, v in every.items()}
        told[name] |= {f"least, {band}": min(every[band]) for band in BANDS}
        told[name]["blades"] = blades
    return told


def main(
    blades: Annotated[int, typer.Option(help="Finite-element blades.")] = 24,
    seed: Annotated[int, typer.Option(help="Seed of their inputs.")] = 1,
    beside: Annotated[
        Path | None, typer.Option(help="Folder of another artefact of the wide model.")
    ] = None,
    out: Annotated[Path, typer.Option(help="File of the result.")] = FILE,
) -> None:
    """What the bands of fields hold."""
    made_by, inputs = commit(), drawn(blades, seed)
    runs = simulated(inputs)
    told: Json = {"commit": made_by, "seed": seed, "blades": blades, "hours": list(HOURS)}
    told["now"] = compared(load_wide(), inputs, runs)
    if beside is not None:
        told["beside"] = compared(load(beside), inputs, runs)
    told["inputs"] = inputs
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(told, indent=1) + "\n")
    for what in [key for key in ("now", "beside") if key in told]:
        for name in FIELDS:
            line = {k: round(v, 4) for k, v in told[what][name].items() if k != "blades"}
            print(what, name, line)


if __name__ == "__main__":
    typer.run(main)
