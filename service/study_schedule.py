"""The command `bladetwin study schedule`: the paper's Algorithm 1 against the joint posterior."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from service.progress import bar

TIMES_H = (8_000.0, 16_000.0, 24_000.0, 32_000.0)
PSI = "t1t_rate"


def schedule(
    rotors: Annotated[int, typer.Option(help="Simulated rotors; none is dropped.")] = 20,
    blades: Annotated[int, typer.Option(help="Blades of each rotor.")] = 10,
    particles: Annotated[int, typer.Option(help="Particles of each set, simulated rotors.")] = 1000,
    plan_particles: Annotated[int, typer.Option(help="Particles of each set, plan.")] = 2000,
    seed: Annotated[int, typer.Option(help="Seed of the truths, the noise and the filters.")] = 7,
    out: Annotated[Path | None, typer.Option(help="JSON file of the result.")] = None,
) -> None:
    """The paper's schedule, offline and online: coverage and sharpness against the joint result."""
    from core.builtin import inspection_plan
    from core.calibration.schedule import Schedule
    from core.model import rotor_blade
    from core.validation.schedule_study import ARMS, JOINT, Arm, on_plan, run
    from service.studies import commit

    def told(arm: Arm) -> dict[str, Any]:
        names = {
            name: {
                "truths": len(u),
                "inside_68": round(arm.share(name, 0.68), 4),
                "inside_95": round(arm.share(name, 0.95), 4),
            }
            | (
                {
                    "sd_ratio": round(arm.sd_ratio(name), 4),
                    "off_by_sd": round(float(np.median(arm.off[name])), 3),
                }
                if name in arm.sd
                else {}
            )
            for name, u in arm.pit.items()
        }
        if not arm.sweeps:
            return {"parameters": names}
        converged = round(float(np.mean(arm.converged)), 4)
        return {"parameters": names, "most_sweeps": max(arm.sweeps), "converged": converged}

    model = rotor_blade()
    start = time.monotonic()
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
        "simulated": {name: told(arm) for name, arm in study.items()},
        "plan": {"particles": plan_particles, "t1t_rate": inspection_plan.T1T_RATE},
    }

    def kept() -> str:
        result["seconds"] = round(time.monotonic() - start, 1)
        text = json.dumps(result, indent=1)
        if out is not None:  # after every part: a study that is cut leaves what it found
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(text + "\n")
        return text

    kept()
    plan, names = inspection_plan.load(), inspection_plan.blades()
    offline, online = ARMS["offline"], ARMS["online"]
    runs: dict[str, Schedule | None] = {
        JOINT: None,
        "offline": offline,
        "offline, discrepancy": replace(offline, discrepancy=PSI),
        "online": online,
        "online, discrepancy": replace(online, discrepancy=PSI),
    }
    with bar("inspection plan", len(runs)) as step:
        for done, (name, how) in enumerate(runs.items(), 1):
            begin = time.monotonic()
            found, _ = on_plan(model, plan, names, how, particles=plan_particles, seed=seed)
            result["plan"][name] = {**found, "seconds": round(time.monotonic() - begin, 1)}
            kept()
            step(done)
    typer.echo(kept())
