"""The command `bladetwin study six-locals`: coverage of a network with six local parameters."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from service.progress import bar
from service.studies import commit


def six_locals(
    rotors: Annotated[int, typer.Option(help="Simulated rotors; none is dropped.")] = 40,
    blades: Annotated[int, typer.Option(help="Blades of each rotor.")] = 10,
    seed: Annotated[int, typer.Option(help="Seed of the truths and the noise.")] = 7,
    particles: Annotated[int, typer.Option(help="Draws of each blade.")] = 2000,
    out: Annotated[Path | None, typer.Option(help="JSON file of the result.")] = None,
) -> None:
    """How often intervals hold the truth where a blade has six local parameters."""
    from core.validation.coverage import run
    from core.validation.six_locals import TIMES_H
    from core.validation.six_locals import six_locals as network

    model = network()
    start, used = time.monotonic(), time.process_time()
    with bar("simulated rotors", rotors) as step:
        study = run(
            model,
            rotors=rotors,
            blades=blades,
            times=TIMES_H,
            seed=seed,
            particles=particles,
            progress=lambda done, total: step(done),
        )
    result: dict[str, Any] = {
        "command": " ".join(["bladetwin", *sys.argv[1:]]),
        "commit": commit(),
        "model": model.digest,
        "seed": seed,
        "rotors": rotors,
        "blades": blades,
        "particles": particles,
        "times_h": TIMES_H,
        "seconds": round(time.monotonic() - start, 1),
        "cpu_seconds": round(time.process_time() - used, 1),
        "least_ess_ratio": round(float(study.ess_ratio.min()), 3),
        "coverage": {
            name: {
                "truths": len(values),
                "inside_68": round(study.share(name, 0.68), 4),
                "inside_95": round(study.share(name, 0.95), 4),
                "standard_error_68": round(study.spread(name, 0.68), 4),
                "standard_error_95": round(study.spread(name, 0.95), 4),
                "mean_pit": round(float(values.mean()), 4),
            }
            for name, values in study.pit.items()
        },
    }
    text = json.dumps(result, indent=1)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text + "\n")
    typer.echo(text)
