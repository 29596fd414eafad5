"""The sampler's coordinates: whatever they are fitted to, their Jacobian is exact."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.state import RotorSpec
from core.model import rotor_blade
from core.observation import Inspection
from core.validation.joint import Target
from core.validation.tubes import Tubes

BLADES = ("B1", "B2")


@pytest.fixture(scope="module")
def tubes() -> Tubes:
    """Fitted to draws along a bent tube that ends at the box."""
    readings = [Inspection(b, b, "elongation", 8e3, np.array([0.2])) for b in BLADES]
    target = Target.of(rotor_blade(), RotorSpec("two", BLADES), readings)
    rng = np.random.default_rng(5)
    shared = rng.uniform(0.3, 0.7, (64, 2))
    local = rng.random((64, 100, 2, 3))
    local[..., 1] = 0.6 * local[..., 0] ** 2 + 0.05 * local[..., 1]
    local[..., 2] = np.clip(local[..., 0] + shared[:, :1, None] - 0.5, 0.001, 0.999)
    return Tubes.fitted(target, shared, np.full(64, 1 / 64), local)


def test_the_jacobian_is_that_of_the_map(tubes: Tubes) -> None:
    """Central differences at points inside and far outside what was fitted."""
    rng = np.random.default_rng(6)

    def flat(e: np.ndarray) -> np.ndarray:
        q_s, q_l, _ = tubes.straight(np, {"shared": e[:2], "local": e[2:].reshape(2, 3)})
        return np.concatenate([q_s, q_l.ravel()])

    for scale in (0.3, 1.0, 3.0):
        e = scale * rng.standard_normal(8)
        *_, each = tubes.straight(np, {"shared": e[:2], "local": e[2:].reshape(2, 3)})
        steps = 1e-5 * np.eye(8)
        slope = np.stack([(flat(e + h) - flat(e - h)) / 2e-5 for h in steps], axis=1)
        sign, found = np.linalg.slogdet(slope)
        assert sign == 1
        assert each.sum() + np.log(tubes.sd).sum() == pytest.approx(found, abs=1e-4)


def test_the_first_parameter_runs_through_the_whole_box(tubes: Tubes) -> None:
    """Far coordinates reach either end: nothing is out of a chain's reach."""
    for e, end in ((-40.0, 0.0), (40.0, 1.0)):
        _, q, _ = tubes.straight(np, {"shared": np.zeros(2), "local": np.full((2, 3), e)})
        assert np.allclose(1 / (1 + np.exp(-q[:, 0])), end, atol=1e-3)
