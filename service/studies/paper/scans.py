"""Blade 01's scans of the paper's example beside what a calibration foresees of them.

A scan is the blade's deformation in x, y, z at its nodes; at each outage, and held out at the last
hour of all. What is foreseen has the sd of the blade, and a reading's noise besides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.builtin.inspection_plan import HELD_OUT_H, OUTAGES_H, SCANNED, Plan
from core.curves import noise_of
from core.model import Model
from core.validation.paper import Stage, readings_of
from core.validation.paper_above import LEVELS
from core.validation.paper_scan import Scan
from service.fields import field_of

Array = NDArray[np.float64]
Json = dict[str, Any]
HALF = 1.959963984540054
HOURS = (*OUTAGES_H, HELD_OUT_H)


@dataclass(frozen=True)
class Missed:
    """A scan at an hour: mean and sd of the blade, noise, reading and truth, (n, 3) [mm]."""

    time_h: float
    used: bool
    mean: Array
    sd: Array
    noise: float
    reading: Array
    truth: Array


def missed(model: Model, stage: Stage, plan: Plan, scan: Scan, instant: int) -> Missed:
    """Blade 01's scan at an instant (3: the held-out one) and what is foreseen of it."""
    quantity, hour = LEVELS["scanned"], HOURS[instant]
    got = field_of(model, stage.scanned, quantity, hour, None, scan.nodes.tolist())
    w = stage.scanned.particles.w
    noise = float(np.sqrt(w @ noise_of(model, stage.scanned, quantity) ** 2))
    if instant < len(OUTAGES_H):
        (own,) = (
            r for r in readings_of(plan, [SCANNED])
            if r.quantity == quantity and r.campaign == f"outage-{instant + 1}"
        )  # fmt: skip
        reading = own.values
    else:
        reading = scan.held_out()
    truth = scan.deformation[instant]
    return Missed(hour, instant < stage.outages, got.mean, got.sd, noise, reading, truth)


def off(one: Missed) -> Json:
    """How far a scan is from what was foreseen, and how much of it the bounds hold."""
    miss = one.reading - one.mean
    total = np.hypot(one.sd, one.noise)
    return {
        "time_h": one.time_h,
        "used": one.used,
        "values": miss.size,
        "rmse_reading_mm": float(np.sqrt(np.mean(miss**2))),
        "rmse_truth_mm": float(np.sqrt(np.mean((one.truth - one.mean) ** 2))),
        "sd_blade_mm": float(np.sqrt(np.mean(one.sd**2))),
        "noise_mm": one.noise,
        "reading_inside_1sd": float(np.mean(np.abs(miss) <= total)),
        "reading_inside_95": float(np.mean(np.abs(miss) <= HALF * total)),
        "truth_inside_1sd": float(np.mean(np.abs(one.truth - one.mean) <= one.sd)),
        "truth_inside_95": float(np.mean(np.abs(one.truth - one.mean) <= HALF * one.sd)),
    }
