"""The paper's inspection plan, with readings from finite elements that no surrogate ever saw.

Table 1 of the paper: elongation of 100 blades at three outages, 3-D deformation of blade 01 at the
same outages, CEEQ of blades 28, 82 and 99, one at each outage; a blade whose CEEQ was measured is
destroyed and replaced by a new one, which starts at zero hours. A fourth outage is held out: its
readings are never posted and measure the predictions.

The truth is not the model: each blade is a finite-element run on the mesh ``fine`` (other nodes,
another number of elements through the wall than the runs that trained the surrogate), at inputs
drawn from the priors, with its fields interpolated to the default mesh's nodes by element shape
functions. Noise is added from a seeded stream. `make` writes the small file that ships:

    bladetwin model readings rotor-blade
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive, Input, Mesh
from core.blade import BOUNDS, build_mesh, output_times, run_campaign
from core.builtin.rotor_blade import as_run
from core.errors import ModelError
from core.rng import stream

Array = NDArray[np.float64]
SHIPPED = Path(__file__).with_name("inspection_plan.npz")
COMMAND = "bladetwin model readings rotor-blade"
SEED = 1001
OUTAGES_H = (8_000.0, 16_000.0, 24_000.0)
HELD_OUT_H = 32_000.0
T1T_RATE = 0.92  # of the true rotor: warm, so that the readings stand above the noise
SCANNED = "B001"
DESTROYED = {"B028": 0, "B082": 1, "B099": 2}  # blade → outage of its destructive test
NOISE = {"elongation": 0.02, "deformation": 0.03, "ceeq": 2e-4}  # standard deviations [mm, mm, 1]
Progress = Callable[[str, int, int, float], None]


def blades() -> tuple[str, ...]:
    """100 blades and the three that replace the destroyed ones.

    >>> blades()[0], blades()[-1], len(blades())
    ('B001', 'B099-2', 103)
    """
    return (*(f"B{i:03d}" for i in range(1, 101)), *(f"{b}-2" for b in DESTROYED))


def hours(blade: str, rotor_h: float) -> float | None:
    """Operating hours of a blade at a rotor's hour; None before it came or after it went.

    >>> hours("B028", 16_000.0), hours("B028-2", 16_000.0)
    (None, 8000.0)
    """
    if blade.endswith("-2"):
        own = rotor_h - OUTAGES_H[DESTROYED[blade.removesuffix("-2")]]
        return own if own > 0 else None
    if blade in DESTROYED and rotor_h > OUTAGES_H[DESTROYED[blade]]:
        return None
    return rotor_h


def times() -> Array:
    """Instants of the truth runs [h]: the model's 54 and the outages."""
    return np.union1d(output_times(), [*OUTAGES_H, HELD_OUT_H])


def truth_inputs(seed: int = SEED) -> Array:
    """Inputs of every blade, (103, 4): local ones drawn from their priors, one t1t_rate."""
    low, high = np.array(list(BOUNDS.values())).T
    x = low + stream(seed, "truth").random((len(blades()), 4)) * (high - low)
    x[:, list(BOUNDS).index("t1t_rate")] = T1T_RATE
    return np.asarray(x)


def simulate(directory: str | Path, workers: int = 2, progress: Progress | None = None) -> Archive:
    """The truth runs in an archive; a cut campaign goes on where it was."""
    mesh = build_mesh("default")
    archive = Archive.create(
        directory,
        inputs=[Input(name, low, high) for name, (low, high) in BOUNDS.items()],
        time_h=times(),
        mesh=Mesh("default", mesh.points, mesh.cells, mesh.parametric, mesh.named),
        seed=SEED,
        command=COMMAND,
    )
    points = [dict(zip(BOUNDS, map(float, x), strict=True)) for x in truth_inputs()]
    campaign = run_campaign(
        points,
        lambda index, run: archive.write(index, as_run(run)),
        mesh="fine",
        onto="default",
        done=frozenset(archive.done()),
        processes=workers,
        progress=progress and (lambda done, total, left: progress("truth runs", done, total, left)),
        time_h=times(),
    )
    if campaign.failures:
        raise ModelError(f"truth run {campaign.failures[0].index}: {campaign.failures[0].reason}")
    return archive


def scanned_nodes() -> NDArray[np.int64]:
    """Nodes a laser scanner reaches: the outer skin above the root."""
    mesh = build_mesh("default")
    wall, span = mesh.parametric[:, 1], mesh.parametric[:, 2]
    return np.flatnonzero((wall < 1e-9) & (span > 0.05))


def make(archive: Archive, out: str | Path = SHIPPED) -> Plan:
    """Readings with noise, and the truth beside them, as one npz."""
    t = times()
    at = np.searchsorted(t, [*OUTAGES_H, HELD_OUT_H])
    runs = [archive.read(i).values for i in range(len(blades()))]
    nodes = scanned_nodes()
    critical = archive.declaration.named["critical"]
    rng = stream(SEED, "noise")
    shift = runs[0]["displacement"][at[:3]] - runs[0]["displacement"][0]
    arrays: dict[str, Any] = {
        "seed": SEED,
        "time_h": t,
        "inputs": truth_inputs(),
        "elongation": np.stack([r["elongation"] for r in runs]),
        "ceeq": np.stack([r["ceeq"][:, critical] for r in runs]).astype(np.float32),
        "scan_nodes": nodes.astype(np.int32),
    }
    shape = arrays["elongation"].shape
    arrays["elongation_noise"] = NOISE["elongation"] * rng.standard_normal((shape[0], 4))
    arrays["ceeq_noise"] = NOISE["ceeq"] * rng.standard_normal(3)
    scan = shift[:, nodes] + NOISE["deformation"] * rng.standard_normal((3, len(nodes), 3))
    arrays["scan"] = np.round(scan, 4).astype(np.float32)
    np.savez_compressed(out, **arrays)
    return load(out)


@dataclass(frozen=True)
class Plan:
    """Truth and readings.

    time_h (T,), inputs (103, 4), elongation (103, T) [mm] and ceeq (103, T) without noise;
    inspections: JSON bodies in outage order; held_out: {blade: (own hours, reading [mm])}
    """

    time_h: Array
    inputs: Array
    elongation: Array
    ceeq: Array
    inspections: tuple[dict[str, Any], ...]
    held_out: dict[str, tuple[float, float]]


def load(path: str | Path = SHIPPED) -> Plan:
    """The shipped plan."""
    with np.load(path, allow_pickle=False) as data:
        z = {name: data[name] for name in data.files}
    names = blades()

    def elongation(blade: str, own: float, outage: int) -> float:
        i = names.index(blade)
        clean = np.interp(own, z["time_h"], z["elongation"][i])
        return round(float(clean + z["elongation_noise"][i, outage]), 4)

    found: list[dict[str, Any]] = []
    held: dict[str, tuple[float, float]] = {}
    for outage, rotor_h in enumerate((*OUTAGES_H, HELD_OUT_H)):
        for blade in names:
            own = hours(blade, rotor_h)
            if own is None:
                continue
            value = elongation(blade, own, outage)
            if rotor_h == HELD_OUT_H:
                held[blade] = (own, value)
                continue
            campaign = f"outage-{outage + 1}"
            common = {"blade": blade, "time_h": own, "campaign": campaign}
            found.append(
                {
                    "id": f"{blade}-e{outage + 1}",
                    "quantity": "elongation",
                    "value": value,
                    "unit": "mm",
                    **common,
                }
            )
            if blade == SCANNED:
                found.append(
                    {
                        "id": f"{blade}-d{outage + 1}",
                        "quantity": "deformation",
                        "unit": "mm",
                        "nodes": z["scan_nodes"].tolist(),
                        "values": z["scan"][outage].astype(float).round(4).tolist(),
                        **common,
                    }
                )
            if DESTROYED.get(blade) == outage:
                i = names.index(blade)
                clean = np.interp(own, z["time_h"], z["ceeq"][i].astype(float))
                reading = round(float(clean + z["ceeq_noise"][outage]), 6)
                found.append(
                    {
                        "id": f"{blade}-c{outage + 1}",
                        "quantity": "ceeq",
                        "value": reading,
                        "unit": "1",
                        **common,
                    }
                )
    return Plan(
        z["time_h"], z["inputs"], z["elongation"], z["ceeq"].astype(float), tuple(found), held
    )
