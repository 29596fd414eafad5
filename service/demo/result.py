"""What the twin says at the end, beside the truth that it never saw."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from core.builtin.inspection_plan import HELD_OUT_H, Plan, blades
from service.client import Client

LOCAL = ("tbc_thickness", "creep_transient", "creep_steady")
SHOWN = "B090"
Json = dict[str, Any]


@dataclass
class Result:
    """Posterior against truth.

    shared      name → (mean, sd, true value or None)
    local       blade → name → (mean, sd, truth)
    held_out    blade → (own hours, reading, mean, lower, upper, total sd)
    curve       prediction of the shown blade over its life
    loop        what the model was found to lack, where that was asked (`service.demo.loop`)
    """

    rotor: Json
    shared: dict[str, tuple[float, float, float | None]]
    local: dict[str, dict[str, tuple[float, float, float]]]
    held_out: dict[str, tuple[float, float, float, float, float, float]]
    curve: Json
    seconds: dict[str, float] = field(default_factory=dict)
    loop: Json | None = None

    @property
    def coverage(self) -> float:
        """Share of the held-out readings inside their 95 % bands."""
        inside = [low <= y <= high for _, y, _, low, high, _ in self.held_out.values()]
        return float(np.mean(inside))

    def local_coverage(self, name: str, widths: float = 1.96) -> float:
        """Share of the blades whose true value lies within `widths` sd of the mean."""
        return float(
            np.mean(
                [abs(t - m) <= widths * s for m, s, t in (b[name] for b in self.local.values())]
            )
        )

    @property
    def forecast_error(self) -> tuple[float, float]:
        """RMSE [mm] of the held-out forecasts, and their mean error."""
        miss = np.array([mean - y for _, y, mean, *_ in self.held_out.values()])
        return float(np.sqrt(np.mean(miss**2))), float(np.mean(miss))

    def to_json(self) -> Json:
        posterior = self.rotor["posterior"]
        return {
            "events": self.rotor["applied_seq"],
            "version": self.rotor["version"],
            "sealed": posterior["sealed"],
            "state_digest": posterior.get("state_digest"),
            "events_digest": posterior.get("events_digest"),
            "shared": self.shared,
            "held_out_coverage_95": self.coverage,
            "held_out_rmse_mm": self.forecast_error[0],
            "held_out_bias_mm": self.forecast_error[1],
            "local_coverage_95": {n: self.local_coverage(n) for n in LOCAL},
            "loop": self.loop,
            "seconds": {k: round(v, 2) for k, v in self.seconds.items()},
            "held_out": self.held_out,
        }


def collect(client: Client, plan: Plan, rotor: Json, name: str, quiet: bool = False) -> Result:
    """Read everything back over HTTP."""
    truth = dict(zip(blades(), plan.inputs, strict=True))
    noise = {"sigma_obs.elongation": 0.02, "sigma_obs.deformation": 0.03, "sigma_obs.ceeq": 2e-4}
    true_shared = {"t1t_rate": float(plan.inputs[0, 1]), **noise}
    shared: dict[str, tuple[float, float, float | None]] = {
        n: (p["mean"], p["sd"], true_shared.get(n))
        for n, p in client.posterior(name)["parameters"].items()
    }
    local, held = {}, {}
    for blade, (own, reading) in plan.held_out.items():
        parameters = client.posterior(name, blade)["parameters"]
        local[blade] = {
            n: (parameters[n]["mean"], parameters[n]["sd"], float(truth[blade][j]))
            for n, j in zip(LOCAL, (0, 2, 3), strict=True)
        }
        band = client.prediction(name, blade, "elongation", times=[own])
        held[blade] = (
            own, reading, band["mean"][0], band["lower"][0], band["upper"][0],
            band["sd"]["total"][0],
        )  # fmt: skip
    hours = np.linspace(500.0, 50_000.0, 100)
    curve = client.prediction(name, SHOWN, "elongation", times=hours.tolist())
    assert hours[-1] >= HELD_OUT_H
    return Result(rotor, shared, local, held, {**curve})
