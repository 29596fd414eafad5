"""An analytic blade: the shape of a creeping rotor blade without finite elements.

300 nodes (5 x 3 x 20) and 54 instants. Stress from the pull above a section, temperature from a
coating resistance, Larson-Miller rupture life, primary and secondary creep, and displacements
by integrating the strain along the span. The constants are those of no real blade.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from core.archive import Archive, Input, Mesh, Run
from core.design import maximin_lhs
from core.surrogate import Surrogate, train
from tests.once import once

Array = NDArray[np.float64]
INPUTS = (
    Input("tbc_thickness", 2 / 3, 4 / 3),
    Input("t1t_rate", 0.8, 1.0),
    Input("creep_transient", -3.0, 3.0),
    Input("creep_steady", -3.0, 3.0),
)
NAMES = tuple(item.name for item in INPUTS)
LOW = np.array([item.low for item in INPUTS])
HIGH = np.array([item.high for item in INPUTS])
TIME_H = np.concatenate([[0.0], np.geomspace(1, 1000, 15), np.linspace(1000, 50_000, 39)[1:]])
TRAIN, TEST = 66, 34


def mesh() -> Mesh:
    """A bar of 5 x 3 x 20 nodes, 40 x 12 x 180 mm; cells only carry their first eight nodes."""
    around, wall, span = np.meshgrid(
        np.linspace(0, 1, 5), np.linspace(0, 1, 3), np.linspace(0, 1, 20), indexing="ij"
    )
    parametric = np.column_stack([around.ravel(), wall.ravel(), span.ravel()])
    cells = np.arange(8)[None]
    named = {"tip": 4 * 60 + 59, "critical": 2 * 60 + 20 + 9}
    return Mesh("stand-in", parametric * [40.0, 12.0, 180.0], cells, parametric, named)


def simulate(x: Array, time_h: Array = TIME_H) -> Run:
    """One run of the stand-in at inputs x (4,)."""
    tbc, rate, alpha, gamma = x
    around, wall, span = mesh().parametric.T
    gas = 1185 - 600 * (1 - rate)
    kelvin = 273 + 500 + (gas - 500) * 0.47 / (1 + 0.22 * tbc) * (1 - 0.25 * (span - 0.6) ** 2)
    kelvin = kelvin + 12 * (wall - 0.5) + 8 * np.cos(2 * np.pi * around)
    q = 205 * (1 - 0.8 * span**2) + 10 * (wall - 0.5)
    life = 10 ** ((41566.8 - 6536.04 * np.log10(q)) / kelvin - 20)
    secondary = 0.02 / life * np.exp(0.35 * gamma)
    tau = 2e-4 / (0.02 / life)
    t = time_h[:, None]
    primary = 1e-3 * (q / 100) ** 2 * np.exp(0.35 * alpha) * -np.expm1(-t / tau)
    ceeq = primary + secondary * t / (1 + 0.1 * secondary * t)
    relaxed = q * (1 - 0.15 * ceeq / (ceeq + 5e-3))
    bent = (wall - 0.5) * 4 * ceeq
    strain = (ceeq + bent).reshape(-1, 5, 3, 20)
    along = np.cumsum(strain, axis=3) * 180 / 20
    along -= along[..., :1]
    sway = np.cumsum(np.cumsum(np.diff(strain, axis=2).mean(axis=2), axis=2), axis=2) * 0.1
    creep = np.zeros((len(time_h), 300, 3))
    creep[:, :, 2] = along.reshape(len(time_h), 300)
    creep[:, :, 0] = np.repeat(sway[:, :, None], 3, axis=2).reshape(len(time_h), 300)
    creep[:, :, 1] = -0.3 * creep[:, :, 0] * (1 + 0.1 * rate * around)
    elastic = np.column_stack([0.1 * span * around, 0.05 * wall, span * (kelvin - 300) * 2.7e-3])
    values = {
        "ceeq": ceeq,
        "creep_damage": t / life,
        "mises": relaxed,
        "displacement": elastic + creep,
        "elongation": creep[:, mesh().named["tip"], 2],
    }
    return Run(dict(zip(NAMES, map(float, x), strict=True)), values)


@pytest.fixture(scope="session")
def stand_in() -> Callable[..., Run]:
    """simulate(x, time_h): the truth."""
    return simulate


def runs(folder: Path) -> Archive:
    """66 training and 34 test runs of the stand-in."""
    made = Archive.create(
        folder / "archive",
        inputs=INPUTS,
        time_h=TIME_H,
        mesh=mesh(),
        seed=11,
        command="stand-in",
    )
    points = np.vstack([maximin_lhs(TRAIN, LOW, HIGH, 11), maximin_lhs(TEST, LOW, HIGH, 12)])
    for index, x in enumerate(points):
        made.write(index, simulate(x))
    return made


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    """66 training and 34 test runs of the stand-in."""
    return once(tmp_path_factory, "stand-in", runs)


@pytest.fixture(scope="session")
def model(archive: Archive, tmp_path_factory: pytest.TempPathFactory) -> Surrogate:
    """The surrogate of the 66 training runs."""
    return once(tmp_path_factory, "stand-in-model", lambda _: train(archive, range(TRAIN), seed=1))
