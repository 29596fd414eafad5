"""A heat exchanger that fouls, by formula: no blade, no creep, other words and units.

A layer grows in the tubes with the rate b of the plant's water, shared by all exchangers of the
station, and narrows them; each exchanger's tubes have a roughness r of their own::

    s(t) = 1 − exp(−b t)
    drop(t)     = 20 (1 + 0.05 r) ((1 − 0.35 s)⁻⁵ − 1)                    [kPa], since clean
    transfer(t) = 1500 / (1 + 3 s (1 + 0.1 r))                            [W/(m2 K)]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from core.design import maximin_lhs
from core.network import Network
from service.declared import read_network

Array = NDArray[np.float64]
TIME_H = np.array([0, 250, 500, 1000, 2000, 4000, 8000, 12_000, 16_000.0])
NETWORK = """
name: heat-exchanger
parameters:
  - {name: roughness, level: local, unit: um, prior: {kind: uniform, low: 1, high: 9}}
  - {name: fouling_rate, level: shared, unit: 1/h, prior: {kind: uniform, low: 2e-5, high: 2e-4}}
quantities:
  - {name: drop, unit: kPa, kind: scalar, low: -5, high: 250,
     sigma_obs: {kind: log_uniform, low: 0.05, high: 2}}
"""
BOTH = (
    NETWORK
    + """
  - {name: transfer, unit: W/(m2 K), kind: scalar, low: 0, high: 5000,
     sigma_obs: {kind: log_uniform, low: 1, high: 50}}
"""
)
LOW, HIGH = (1.0, 2e-5), (9.0, 2e-4)


def network(text: str = NETWORK) -> Network:
    return read_network(text)


def drop(x: Array, time_h: Array) -> Array:
    """kPa at inputs x (2,): roughness [um], rate [1/h]."""
    layer = -np.expm1(-x[1] * np.asarray(time_h, float))
    return np.asarray(20 * (1 + 0.05 * x[0]) * ((1 - 0.35 * layer) ** -5 - 1))


def transfer(x: Array, time_h: Array) -> Array:
    """W/(m2 K)."""
    layer = -np.expm1(-x[1] * np.asarray(time_h, float))
    return np.asarray(1500 / (1 + 3 * layer * (1 + 0.1 * x[0])))


@cache
def _points(count: int) -> Array:
    return maximin_lhs(count, LOW, HIGH, 3)


def points(count: int = 24) -> Array:
    """A design of one's own: some tests write into it."""
    return _points(count).copy()


def dataset(count: int = 24, x: Array | None = None, time_h: Array = TIME_H) -> xr.Dataset:
    """Runs as a user writes them with xarray."""
    x = points(count) if x is None else x
    return xr.Dataset(
        {
            "roughness": ("run", x[:, 0], {"units": "um"}),
            "fouling_rate": ("run", x[:, 1], {"units": "1/h"}),
            "drop": (("run", "time"), np.array([drop(a, time_h) for a in x]), {"units": "kPa"}),
            "transfer": (
                ("run", "time"),
                np.array([transfer(a, time_h) for a in x]),
                {"units": "W/(m2 K)"},
            ),
        },
        coords={"time": ("time", time_h, {"units": "h"}), "run": np.arange(len(x))},
    )


def stored(data: xr.Dataset, path: Path) -> Path:
    data.to_netcdf(path, engine="h5netcdf")
    return path


def write_table(path: Path, x: Array, cells: Mapping[tuple[int, int], str] | None = None) -> Path:
    """One line for each run and instant; `cells`: (run, instant) → what stands in place of drop."""
    lines = ["run,time [h],roughness [um],fouling_rate [1/h],drop [kPa]"]
    for k, one in enumerate(x):
        for i, (t, y) in enumerate(zip(TIME_H, drop(one, TIME_H), strict=True)):
            shown = (cells or {}).get((k, i), repr(float(y)))
            lines.append(f"{k},{t},{float(one[0])!r},{float(one[1])!r},{shown}")
    path.write_text("\n".join(lines) + "\n")
    return path


def readings(
    truth: Mapping[str, Array], hours: Sequence[float], sigma: float, seed: int
) -> list[dict[str, Any]]:
    """Noisy readings of drop of each exchanger."""
    rng, found = np.random.default_rng(seed), []
    for name, x in truth.items():
        for i, t in enumerate(hours):
            value = float(drop(x, np.array(t)) + sigma * rng.normal())
            reading = {"id": f"{name}-{i}", "blade": name, "quantity": "drop", "time_h": float(t)}
            found.append(reading | {"value": value, "unit": "kPa"})
    return found
