"""The commands `bladetwin study …`: long statistical checks with results that are kept.

A result is a JSON file with the seed, the command, the commit and every figure; those of a release
lie under ``tests/claims/results/``. The tests run a short version of each.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from service.progress import bar

app = typer.Typer(help="Statistical studies.", no_args_is_help=True)
TIMES_H = (8_000.0, 16_000.0, 24_000.0, 32_000.0)


def commit() -> str | None:
    """The checkout's commit, where there is one."""
    try:
        done = subprocess.run(
            ["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True, timeout=10
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


@app.command()
def coverage(
    rotors: Annotated[int, typer.Option(help="Simulated rotors; none is dropped.")] = 100,
    blades: Annotated[int, typer.Option(help="Blades of each rotor.")] = 20,
    seed: Annotated[int, typer.Option(help="Seed of the truths and the noise.")] = 7,
    out: Annotated[Path | None, typer.Option(help="JSON file of the result.")] = None,
) -> None:
    """How often intervals hold the truth, on rotors drawn from the priors."""
    from core.model import rotor_blade
    from core.validation.coverage import run

    model = rotor_blade()
    start = time.monotonic()
    with bar("simulated rotors", rotors) as step:
        study = run(
            model,
            rotors=rotors,
            blades=blades,
            times=TIMES_H,
            seed=seed,
            progress=lambda done, total: step(done),
        )
    names = {
        name: {
            "truths": len(values),
            "inside_68": round(study.share(name, 0.68), 4),
            "inside_95": round(study.share(name, 0.95), 4),
            "standard_error_68": round(study.spread(name, 0.68), 4),
            "standard_error_95": round(study.spread(name, 0.95), 4),
            "mean_pit": round(float(values.mean()), 4),
        }
        for name, values in study.pit.items()
    }
    result: dict[str, Any] = {
        "command": " ".join(["bladetwin", *sys.argv[1:]]),
        "commit": commit(),
        "model": model.digest,
        "seed": seed,
        "rotors": rotors,
        "blades": blades,
        "times_h": TIMES_H,
        "seconds": round(time.monotonic() - start, 1),
        "least_ess_ratio": round(float(study.ess_ratio.min()), 3),
        "coverage": names,
    }
    text = json.dumps(result, indent=1)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text + "\n")
    typer.echo(text)
