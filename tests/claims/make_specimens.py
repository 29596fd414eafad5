"""Calibrate four networks on the measured creep curves, whole and with specimens held out.

    python -m tests.claims.make_specimens [NETWORK … | whole | table]

writes tests/claims/results/specimens/<network>.json for norton, primary, tertiary and both: what
the network makes of all twelve specimens, of eleven (each left out once) and of nine (each stress
left out once); and table.md of those that are there, which `table` does alone. Two to ten minutes
of processor time per network.

`whole` writes whole.json, for norton and both: the fit where every reading is used in place of
every fifth, and how each curve goes on where only its first half is known beside the others.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import service.one_thread  # noqa: F401  before numpy, as every command does

# isort: split
import numpy as np

from core.builtin import creep_specimens as built
from core.calibration.online import RotorSpec, update
from core.calibration.state import RotorState, blade_posterior, shared_posterior
from core.model import Model
from core.network import Level
from core.observation import Inspection
from core.prediction import predict
from tests.claims.specimen_data import EVERY, LARGEST, Specimen, specimens

OUT = Path(__file__).with_name("results") / "specimens"
WHOLE = OUT / "whole.json"
PRIMARY: dict[str, Level] = {"primary": "shared", "primary_strain": "shared"}
FREED: dict[str, dict[str, Level]] = {
    "norton": {},
    "primary": PRIMARY,
    "tertiary": {"tertiary": "shared"},
    "both": {**PRIMARY, "tertiary": "shared"},
}
PARTICLES, SEED = 4096, 1


def model(network: str) -> Model:
    return Model(built.freed(built.network(), FREED[network]), built.formula())


def calibrated(
    of: Model, every: Sequence[Specimen], left_out: Collection[str] = (), particles: int = PARTICLES
) -> RotorState:
    """The state of all these specimens, of which those left out have no reading."""
    readings = [r for one in every if one.name not in left_out for r in one.readings]
    return calibrated_from(of, every, readings, particles)


def calibrated_from(
    of: Model, every: Sequence[Specimen], readings: Sequence[Inspection], particles: int = PARTICLES
) -> RotorState:
    """The state of all these specimens after some readings of theirs."""
    known = {one.name: {"stress": one.stress} for one in every}
    return update(of, RotorSpec("set", tuple(known), particles, SEED, known), readings)


def errors(of: Model, state: RotorState, one: Specimen) -> dict[str, Any]:
    """The band at all of a specimen's readings up to `LARGEST` against them [%]."""
    posterior = blade_posterior(state.meta, state.arrays.__getitem__, one.name)
    band = predict(of, posterior, built.QUANTITY, one.time_h, known={"stress": one.stress})
    off, middle = band.mean - one.strain, band.quantiles[0.5] - one.strain
    inside = (band.lower <= one.strain) & (one.strain <= band.upper)
    return {
        "specimen": one.name,
        "stress_MPa": one.stress,
        "readings": len(one.strain),
        "mean_square": float(np.mean(off**2)),
        "median_square": float(np.mean(middle**2)),
        "inside_95": float(np.mean(inside)),
        "used_square": float(np.mean(off[::EVERY] ** 2)),
    }


def summary(of: Model, state: RotorState) -> dict[str, Any]:
    """Evidence, shared parameters and health of a state."""
    shared = shared_posterior(state.meta, state.arrays.__getitem__)
    sd = np.sqrt(np.diag(shared.particles.covariance))
    pairs = zip(shared.names, shared.particles.mean, sd, strict=True)
    health = state.meta["health"]
    return {
        "log_evidence": round(state.meta["log_evidence"], 3),
        "shared": {name: [float(f"{m:.5g}"), float(f"{s:.3g}")] for name, m, s in pairs},
        "health": {k: health[k] for k in ("status", "ess_ratio", "message_error_nat")},
    }


def held_out(of: Model, every: Sequence[Specimen], groups: Sequence[Collection[str]]) -> list[Any]:
    """Errors on each specimen of each group, by a state that has not seen the group."""
    out = []
    for group in groups:
        state = calibrated(of, every, group)
        health = state.meta["health"]["status"]
        out += [errors(of, state, one) | {"health": health} for one in every if one.name in group]
    return out


def made(network: str) -> dict[str, Any]:
    """Everything about one network."""
    of, every, began = model(network), specimens(), time.process_time()
    state = calibrated(of, every)
    stresses = sorted({one.stress for one in every})
    return {
        "network": network,
        "command": f"python -m tests.claims.make_specimens {network}",
        "freed": FREED[network],
        "model": of.digest,
        "largest_pct": LARGEST,
        "every": EVERY,
        "delivered": sum(one.delivered for one in every),
        "up_to_largest": sum(len(one.strain) for one in every),
        "used": sum(len(one.readings) for one in every),
        **summary(of, state),
        "fit": [errors(of, state, one) for one in every],
        "new_specimen": held_out(of, every, [{one.name} for one in every]),
        "new_stress": held_out(
            of, every, [{one.name for one in every if one.stress == s} for s in stresses]
        ),
        "processor_s": round(time.process_time() - began),
    }


def halved(one: Specimen) -> tuple[Specimen, Specimen]:
    """The readings of the first half of a curve's hours, and those of the second."""
    early = one.time_h <= 0.5 * one.time_h[-1]
    first, second = (
        replace(one, time_h=one.time_h[part], strain=one.strain[part]) for part in (early, ~early)
    )
    return first, second


def continued(of: Model, every: Sequence[Specimen]) -> list[dict[str, Any]]:
    """Errors on the second half of each curve, whose first half is known, and all other curves."""
    out = []
    for one in every:
        first, second = halved(one)
        readings = [r for other in every if other is not one for r in other.readings]
        state = calibrated_from(of, every, [*readings, *first.readings])
        out.append(errors(of, state, second) | {"health": state.meta["health"]["status"]})
    return out


def whole() -> dict[str, Any]:
    """The fit by every reading, and how curves go on, of Norton's law alone and with both."""
    every, out = specimens(), dict[str, Any]()
    for network in ("norton", "both"):
        of, began = model(network), time.process_time()
        state = calibrated_from(of, every, [r for one in every for r in one.every(1)])
        out[network] = {
            "model": of.digest,
            "used": sum(len(one.every(1)) for one in every),
            **summary(of, state),
            "fit": [errors(of, state, one) for one in every],
            "continued": continued(of, every),
            "processor_s": round(time.process_time() - began),
        }
    return {"command": "python -m tests.claims.make_specimens whole", **out}


def kept(network: str) -> dict[str, Any]:
    """What is kept of a network."""
    found: dict[str, Any] = json.loads((OUT / f"{network}.json").read_text())
    return found


def rmse(found: Mapping[str, Any], which: str, *stresses: float, of: str = "mean_square") -> float:
    """Of the band's mean, over all readings up to `LARGEST` of specimens at these stresses [%]."""
    own = [one for one in found[which] if not stresses or one["stress_MPa"] in stresses]
    weights = np.array([one["readings"] for one in own])
    return float(np.sqrt(weights @ [one[of] for one in own] / weights.sum()))


STRESSES = (140.0, 170.0, 200.0, 230.0)
COLUMNS = ("network", "log evidence", "noise", "fit", "new specimen", "new stress", "inside 95 %")


def row(network: str) -> list[str]:
    found = kept(network)
    noise, sd = found["shared"][f"sigma_obs.{built.QUANTITY}"]
    new = ("new_specimen", "new_stress")
    inside = [float(np.mean([one["inside_95"] for one in found[which]])) for which in new]
    return [
        network,
        f"{found['log_evidence']:.1f}",
        f"{noise:.3f} ± {sd:.3f}",
        f"{rmse(found, 'fit'):.3f}",
        *(" / ".join(f"{rmse(found, which, s):.2f}" for s in STRESSES) for which in new),
        ", ".join(f"{share:.2f}" for share in inside),
    ]


def table() -> str:
    """All networks that are kept; errors are root mean squares in % strain."""
    rows = [row(name) for name in FREED if (OUT / f"{name}.json").exists()]
    lines = [COLUMNS, ["---"] * len(COLUMNS), *rows]
    first = kept("norton")
    return (
        f"`python -m tests.claims.make_specimens`: {first['delivered']} readings delivered, "
        f"{first['up_to_largest']} up to {first['largest_pct']:g} %, every {first['every']}th of "
        f"them used, {first['used']}. Errors: root mean squares [% strain] over all "
        f"{first['up_to_largest']}; of what was held out at 140 / 170 / 200 / 230 MPa. Inside: "
        "readings of a new specimen, of a new stress. Data: see specimen_data.py.\n\n"
        + "".join(f"| {' | '.join(line)} |\n" for line in lines)
        + (whole_table(json.loads(WHOLE.read_text())) if WHOLE.exists() else "")
    )


def whole_table(found: Mapping[str, Any]) -> str:
    """What is kept of `whole`."""
    lines = []
    for name in ("norton", "both"):
        own = found[name]
        noise, sd = own["shared"][f"sigma_obs.{built.QUANTITY}"]
        by_stress = (f"{rmse(own, 'continued', s):.2f}" for s in STRESSES)
        inside = float(np.mean([one["inside_95"] for one in own["continued"]]))
        cells = [
            name,
            f"{noise:.3f} ± {sd:.3f}",
            f"{rmse(own, 'fit'):.3f}",
            " / ".join(by_stress),
            f"{rmse(own, 'continued'):.2f}",
            f"{rmse(own, 'continued', of='median_square'):.2f}",
            f"{inside:.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |\n")
    return (
        f"\n`{found['command']}`: every one of the {found['both']['used']} readings used, and how "
        "each curve goes on after the first half of its hours, where that half is known and every "
        "fifth reading of the other eleven curves. Errors as above; the last three: over all "
        "stresses, of the bands' medians in place of their means, readings inside 95 %.\n\n"
        "| network | noise | fit | goes on | all | by medians | inside 95 % |\n"
        "| --- | --- | --- | --- | --- | --- | --- |\n" + "".join(lines)
    )


def main(networks: Sequence[str]) -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    if networks == ["whole"]:
        WHOLE.write_text(json.dumps(whole(), indent=1) + "\n")
        networks = ["table"]
    for network in [] if networks == ["table"] else networks or [*FREED]:
        (OUT / f"{network}.json").write_text(json.dumps(made(network), indent=1) + "\n")
    (OUT / "table.md").write_text(table())


if __name__ == "__main__":
    main(sys.argv[1:])
