"""Blade 01's deformation without noise, and at the held-out outage: finite elements, once.

The inspection plan ships its scans with noise and none at 32,000 h. This is the same run again
(mesh ``fine``, fields at the default mesh's nodes), kept at the scanned nodes. It is made by

    bladetwin study paper --truth core/validation/paper_scan.npz
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.blade import BOUNDS, BladeRun, run_campaign
from core.builtin.inspection_plan import (
    HELD_OUT_H,
    NOISE,
    OUTAGES_H,
    SCANNED,
    SEED,
    blades,
    scanned_nodes,
    times,
    truth_inputs,
)
from core.builtin.rotor_blade import blade_digest
from core.errors import ModelError
from core.rng import stream

Array = NDArray[np.float64]
SHIPPED = Path(__file__).with_name("paper_scan.npz")
HOURS = (*OUTAGES_H, HELD_OUT_H)


@dataclass(frozen=True)
class Scan:
    """Truth of blade 01's permanent deformation.

    time_h (4,) three outages and the held-out one; nodes (n,) of the default mesh; deformation
    (4, n, 3) [mm]; elongation (4,) [mm]; code: SHA-256 of the finite elements' sources
    """

    time_h: Array
    nodes: NDArray[np.int64]
    deformation: Array
    elongation: Array
    code: str

    def held_out(self) -> Array:
        """A scan at the held-out hour with the plan's noise, to 1e-4 mm, (n, 3) [mm]."""
        clean = self.deformation[-1]
        noise = stream(SEED, "paper", "held-out scan").standard_normal(clean.shape)
        return np.asarray(np.round(clean + NOISE["deformation"] * noise, 4))


def make(out: str | Path = SHIPPED) -> Scan:
    """Run the finite elements and write the file: one run on the fine mesh, minutes."""
    inputs = dict(zip(BOUNDS, map(float, truth_inputs()[blades().index(SCANNED)]), strict=True))
    at, nodes = np.searchsorted(times(), HOURS), scanned_nodes()

    def keep(index: int, run: BladeRun) -> None:
        shift = run.displacement[at][:, nodes] - run.displacement[0][nodes]
        np.savez_compressed(
            out,
            time_h=np.array(HOURS),
            nodes=nodes.astype(np.int32),
            deformation=shift.astype(np.float32),
            elongation=run.elongation[at],
            code=np.array(blade_digest()),
        )

    done = run_campaign([inputs], keep, mesh="fine", onto="default", processes=1, time_h=times())
    if done.failures:
        raise ModelError(f"truth run of {SCANNED}: {done.failures[0].reason}")
    return load(out)


def load(path: str | Path = SHIPPED) -> Scan:
    """The shipped truth."""
    with np.load(path, allow_pickle=False) as z:
        return Scan(
            z["time_h"],
            z["nodes"].astype(np.int64),
            z["deformation"].astype(float),
            z["elongation"],
            str(z["code"]),
        )
