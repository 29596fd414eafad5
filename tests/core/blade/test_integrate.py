from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from core.blade.creep import STATE
from core.blade.integrate import (
    MAX_STAGES,
    Tolerance,
    Work,
    _chebyshev,
    advance,
    limit,
    stages_for,
)
from core.errors import ModelError


def decay(speed: float) -> Callable[[np.ndarray], tuple[np.ndarray, float]]:
    """y' = -speed (y - 2e-3)."""
    return lambda y: (-speed * (y - 2e-3), speed)


@pytest.mark.parametrize("stages", [2, 3, 7])
def test_error_of_a_step_falls_with_the_third_power_of_its_length(stages: int) -> None:
    start, errors = np.full((1, STATE), 5e-3), []
    for h in (0.2, 0.1, 0.05):
        rates = decay(1.0)
        new = _chebyshev(rates, start, rates(start)[0], h, stages)
        errors.append(abs(new[0, 0] - (2e-3 + 3e-3 * np.exp(-h))))
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([3.0, 3.0], abs=0.15)


@pytest.mark.parametrize("stages", [2, 5, 20, MAX_STAGES])
def test_a_step_is_stable_up_to_its_limit_and_grows_beyond_it(stages: int) -> None:
    growth = []
    for share in (0.99, 1.15):
        rates = decay(1.0)
        start = np.full((1, STATE), 5e-3)
        new = _chebyshev(rates, start, rates(start)[0], share * limit(stages), stages)
        growth.append(abs(new[0, 0] - 2e-3) / 3e-3)
    assert growth[0] < 1.0
    assert growth[1] > 1.0


def test_the_fewest_stages_that_reach_are_taken() -> None:
    for demand in (0.1, 2.0, 2.1, 15.0, 64.0, 900.0):
        stages = stages_for(demand)
        assert limit(stages) >= demand
        assert stages == 2 or limit(stages - 1) < demand


def test_a_stiff_decay_costs_the_square_root_of_what_heun_needs() -> None:
    work, speed, until = Work(), 50.0, 100.0
    instants = np.array([0.0, until / 2, until])
    end = list(advance(decay(speed), np.zeros((1, STATE)), instants, Tolerance(), work))[-1]
    assert end[0, 0] == pytest.approx(2e-3, abs=1e-6)
    assert work.evaluations < speed * until / 10  # Heun: at least speed · until


def test_each_instant_is_met_exactly() -> None:
    instants = np.array([0.0, 0.7, 0.71, 13.0, 400.0])

    def clock(y: np.ndarray) -> tuple[np.ndarray, float]:
        return np.full_like(y, 1e-5), 0.0

    states = list(advance(clock, np.zeros((2, STATE)), instants, Tolerance()))
    assert np.array([s[1, 4] for s in states]) == pytest.approx(1e-5 * instants, rel=1e-12)


def test_error_per_step_is_kept_and_a_looser_tolerance_errs_more() -> None:
    """y' = cos: nothing to stabilise, the error control alone chooses the steps."""
    errors = []
    for tolerance in (Tolerance(), Tolerance(relative=0.1, absolute=2e-5)):

        def swing(y: np.ndarray) -> tuple[np.ndarray, float]:
            # state 0 is a clock in units of 1e-3, state 1 is 1e-3 sin(t)
            out = np.zeros_like(y)
            out[:, 0], out[:, 1] = 1e-3, 1e-3 * np.cos(1e3 * y[:, 0])
            return out, 0.0

        states = advance(swing, np.zeros((1, STATE)), np.array([0.0, 1.0, 9.0]), tolerance)
        errors.append(abs(list(states)[-1][0, 1] - 1e-3 * np.sin(9.0)))
    assert errors[0] < 2e-5
    assert errors[1] > 3 * errors[0]


def test_a_rate_that_explodes_is_reported_with_its_time_and_step() -> None:
    def explode(y: np.ndarray) -> tuple[np.ndarray, float]:
        return 1e-3 * np.exp(np.minimum(1e6 * y, 600.0)), 0.0

    with pytest.raises(ModelError, match=r"a step of .* times the allowed error"):
        list(advance(explode, np.zeros((1, STATE)), np.array([0.0, 1e4]), Tolerance()))
