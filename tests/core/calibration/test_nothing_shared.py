"""A network without shared parameters, read with noise that is known: blades tell one another
nothing, and the rotor's evidence is the product of theirs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp

from core.calibration.online import RotorSpec, RotorState, update
from core.calibration.state import blade_posterior
from core.model import Model
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel
from tests.core.calibration.bar import LOCAL, creep

RATE, SIGMA, TIMES, BLADES = 0.92, 0.02, (4e3, 8e3), ("b0", "b1", "b2", "b3", "b4")


def at_known_rate(x: np.ndarray, t: float) -> np.ndarray:
    return creep(np.column_stack([x[:, 0], np.full(len(x), RATE), x[:, 1:]]), t)


@pytest.fixture(scope="module")
def model() -> Model:
    local = tuple(Parameter(n, "local", Prior("uniform", a, b)) for n, a, b in LOCAL)
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in local)
    quantity = Quantity("y", "mm", "scalar", Prior("log_uniform", 1e-3, 0.2), -5.0, 50.0)
    formula = FormulaModel(inputs, {"y": at_known_rate}, "bar", positive=("y",))
    return Model(Network("bar", local, (quantity,)), formula)


def read(blade: str) -> list[Inspection]:
    x = np.array([[1.1, 0.5, 0.2 * BLADES.index(blade)]])
    return [
        Inspection(f"{blade}t{t:g}", blade, "y", t, at_known_rate(x, t), sigma=SIGMA) for t in TIMES
    ]


def state(model: Model, *blades: str) -> RotorState:
    readings = [one for blade in blades for one in read(blade)]
    return update(model, RotorSpec("r", BLADES, 300, 3), readings)


def on_a_grid(blade: str, cells: int = 60) -> float:
    """Log evidence of a blade's readings by the midpoint rule."""
    middle = (np.arange(cells) + 0.5) / cells
    axes = [low + (high - low) * middle for _, low, high in LOCAL]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    off = np.stack([(at_known_rate(x, r.time_h) - r.values) / SIGMA for r in read(blade)])
    log_p = -0.5 * (off**2).sum(axis=0) - len(off) * np.log(SIGMA * np.sqrt(2 * np.pi))
    return float(logsumexp(log_p) - np.log(len(x)))


def test_the_evidence_of_a_rotor_is_that_of_its_blades(model: Model) -> None:
    found = state(model, *BLADES)
    assert found.meta["health"]["status"] == "ok"
    exact = sum(on_a_grid(blade) for blade in BLADES)
    assert found.meta["log_evidence"] == pytest.approx(exact, abs=0.03)
    assert abs(found.meta["log_evidence"] - exact - np.log(2)) > 0.5, "a factor would be seen"


def test_a_blade_learns_nothing_from_the_others(model: Model) -> None:
    alone, among = (
        blade_posterior(found.meta, found.arrays.__getitem__, "b2").particles
        for found in (state(model, "b2"), state(model, *BLADES))
    )
    sd = np.sqrt(np.diag(alone.covariance))
    own = slice(0, len(LOCAL))
    assert np.all(np.abs(alone.mean - among.mean)[own] < 0.1 * sd[own])
    ratio = np.sqrt(np.diag(among.covariance)) / sd
    assert np.all(np.abs(ratio[own] - 1.0) < 0.1)
