"""A lack without a name widens the bands by as much as the readings bear out; it is no cause."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from core.calibration.online import RotorSpec, RotorState, begun, update
from core.diagnosis import Case, Facts
from core.diagnosis.report import before_after
from core.diagnosis.widen import EARNED, Widened, widen
from core.quantity import Discrepancy
from tests.core.calibration.bar import bar, measured
from tests.core.diagnosis.test_diagnose import OFFSET

MODEL, BLADES, TIMES = bar(), 12, (0.4e4, 0.8e4, 1.2e4, 1.6e4, 2.0e4)
SPEC = RotorSpec("r", tuple(f"b{b}" for b in range(BLADES)), 300, 3)
HORIZON = MODEL.surrogate.horizon_h


def case_of(gain: Callable[[int, int], float]) -> Case:
    """Readings times 1 + gain(blade, visit)."""
    data = measured(BLADES, TIMES, seed=8)
    data = [
        replace(r, values=r.values * (1.0 + gain(i // len(TIMES), i % len(TIMES))))
        for i, r in enumerate(data)
    ]
    return Case(SPEC, tuple(data), {b: Facts() for b in SPEC.blades}, (OFFSET,))


def widened(case: Case) -> tuple[RotorState, Widened]:
    """The state without a discrepancy, and what one makes of it."""
    state = update(MODEL, case.spec, case.readings)
    found = widen(MODEL, state, case, "y", HORIZON)
    assert found is not None
    return state, found


def late(b: int, v: int) -> float:
    """All blades run late, up to 25 % long, faster than they creep: no family here says so."""
    return 0.25 * (v / 4) ** 3


@pytest.fixture(scope="module")
def bent() -> tuple[Case, RotorState, Widened]:
    case = case_of(late)
    return case, *widened(case)


def test_what_all_blades_have_in_common_over_hours_is_borne_out_and_widens_the_bands(
    bent: tuple[Case, RotorState, Widened],
) -> None:
    *_, found = bent
    assert found.borne_out
    assert found.gained > 3 * EARNED
    assert 0.1 < found.share < 1.0
    assert found.sds[1] > 1.4 * found.sds[0]
    assert found.discrepancy.kind == "gp"


def test_its_evidence_is_that_of_the_same_model_calibrated_from_nothing(
    bent: tuple[Case, RotorState, Widened],
) -> None:
    case, base, found = bent
    alone = begun(found.model, SPEC, case.readings).log_evidence
    assert found.gained == pytest.approx(alone - base.meta["log_evidence"], abs=0.25)


def test_late_readings_that_neither_used_are_foreseen_nearer_with_it(
    bent: tuple[Case, RotorState, Widened],
) -> None:
    """A process knows nothing of what comes, but that it goes on: by a fifth, not in full."""
    case, base, found = bent
    models, states = (MODEL, found.model), (base, found.state)
    both = before_after(models, SPEC, case.readings, HORIZON, "y", states=states)
    assert both.after.rmse < 0.9 * both.before.rmse
    assert abs(both.after.bias) < abs(both.before.bias)
    assert both.after.within_68 > both.before.within_68


def test_sound_readings_bear_nothing_out() -> None:
    _, found = widened(case_of(lambda b, v: 0.0))
    assert not found.borne_out
    assert found.gained < 0.5


def test_a_misfit_that_blades_have_not_in_common_bears_nothing_out_and_is_noise() -> None:
    _, found = widened(case_of(lambda b, v: 0.12 * (-1) ** (b + v)))
    assert not found.borne_out
    assert found.share < 0.5


def test_a_quantity_that_declares_a_discrepancy_is_left_as_it_is() -> None:
    own = replace(MODEL.network.quantities[0], discrepancy=Discrepancy("constant", sd=0.01))
    network = replace(MODEL.network, quantities=(own,))
    model = MODEL.of(network, MODEL.surrogate)
    case = case_of(lambda b, v: 0.0)
    state = update(model, SPEC, case.readings)
    assert widen(model, state, case, "y", TIMES[-1]) is None
