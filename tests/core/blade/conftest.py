"""Bars and boxes with known answers, and one coarse run, shared by the blade's tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from core.blade import BladeRun, Properties, simulate
from core.blade.creep import STATE, coefficients
from core.blade.geometry import BladeMesh
from core.blade.integrate import Tolerance, advance
from core.blade.mechanics import Structure

HOT = 1143.15  # K, 870 °C


@pytest.fixture(scope="session")
def base() -> dict[str, float]:
    return {
        "tbc_thickness": 1.0,
        "t1t_rate": 0.9,
        "creep_transient": 0.0,
        "creep_steady": 0.0,
    }


@pytest.fixture(scope="session")
def coarse_run(base: dict[str, float]) -> BladeRun:
    return simulate(base, "coarse", dtype=np.float64)


@pytest.fixture(scope="session")
def plain() -> Properties:
    """At 1143.15 K without thermal strain, at rest, on a root that slides freely."""
    p = Properties()
    return replace(
        p,
        material=replace(p.material, reference_k=HOT),
        geometry=replace(p.geometry, foundation=1e-3),
        service=replace(p.service, speed_rpm=0.0),
    )


@pytest.fixture(scope="session")
def uniform() -> Callable[[BladeMesh], np.ndarray]:
    return lambda mesh: np.full(len(mesh.points), HOT)


@pytest.fixture(scope="session")
def creep_history() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """States (T, G, 9) and displacements (T, N, 3) of a structure that creeps."""

    def run(
        structure: Structure, properties: Properties, time_h: np.ndarray, alpha: float, gamma: float
    ) -> tuple[np.ndarray, np.ndarray]:
        law = coefficients(properties.creep, alpha, gamma)
        states = advance(
            lambda y: structure.rates(structure.displacement(y), y, law),
            np.zeros((structure.points, STATE)),
            time_h,
            Tolerance(),
        )
        history = np.array([state.copy() for state in states])
        return history, np.array([structure.displacement(y).reshape(-1, 3) for y in history])

    return run
