"""A lack without a name widens the bands by as much as the readings bear out; it is no cause."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from core.calibration.online import RotorSpec, RotorState, begun, update
from core.calibration.state import blade_posterior
from core.diagnosis import Case, Facts
from core.diagnosis import widen as module
from core.diagnosis.report import before_after
from core.diagnosis.tell import in_words
from core.diagnosis.widen import EARNED, Widened, widen
from core.model import Model
from core.prediction import predict
from core.quantity import Discrepancy
from tests.core.calibration.bar import bar, measured
from tests.core.diagnosis import fleet
from tests.core.diagnosis.test_diagnose import OFFSET

MODEL, BLADES, TIMES = bar(), 12, (0.4e4, 0.8e4, 1.2e4, 1.6e4, 2.0e4)
SPEC = RotorSpec("r", tuple(f"b{b}" for b in range(BLADES)), 300, 3)
HORIZON = MODEL.surrogate.horizon_h


def case_of(gain: Callable[[int, int], float], spec: RotorSpec = SPEC) -> Case:
    """Readings times 1 + gain(blade, visit)."""
    data = measured(len(spec.blades), TIMES, seed=8)
    data = [
        replace(r, values=r.values * (1.0 + gain(i // len(TIMES), i % len(TIMES))))
        for i, r in enumerate(data)
    ]
    return Case(spec, tuple(data), {b: Facts() for b in spec.blades}, (OFFSET,))


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


def test_its_evidence_is_that_of_the_same_model_calibrated_from_nothing() -> None:
    few = RotorSpec("r", SPEC.blades[:8], SPEC.particles, SPEC.seed)
    case = case_of(late, few)
    base, found = widened(case)
    alone = begun(found.model, few, case.readings).log_evidence
    assert found.gained > EARNED
    assert found.gained == pytest.approx(alone - base.meta["log_evidence"], abs=0.25)


def test_shares_and_sds_are_those_of_the_fleets_predictions(
    bent: tuple[Case, RotorState, Widened],
) -> None:
    case, base, found = bent

    def variances(model: Model, state: RotorState, blades: Sequence[str], of: str) -> float:
        sds = []
        for blade in blades:
            posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
            sds.append(predict(model, posterior, "y", [HORIZON], noise=False).sd[of][0])
        return float(np.mean(np.square(sds)))

    after = variances(found.model, found.state, SPEC.blades, "total")
    own = variances(found.model, found.state, SPEC.blades, "discrepancy")
    assert found.share == pytest.approx(own / after)
    assert found.sds[1] ** 2 == pytest.approx(after)
    assert found.sds[0] ** 2 == pytest.approx(variances(MODEL, base, SPEC.blades, "total"))
    left = replace(case, serving=("b2", "b7"))
    told = module._spread(found.model, found.state, left, "y", HORIZON)
    both = [
        variances(found.model, found.state, ("b2", "b7"), of) for of in ("total", "discrepancy")
    ]
    assert told == pytest.approx(tuple(both))
    assert told[0] != pytest.approx(after), "blades that have left are not in it"


def test_what_is_not_found_well_enough_is_not_borne_out(
    bent: tuple[Case, RotorState, Widened],
) -> None:
    *_, found = bent
    health = {**found.state.meta["health"], "met_floor": False}
    lost = replace(found.state, meta={**found.state.meta, "health": health})
    assert not replace(found, state=lost).borne_out
    assert not replace(found, gained=EARNED - 0.01).borne_out


def test_the_scores_say_what_two_modes_gain_exactly_where_all_is_linear() -> None:
    """Against the densities of all readings, whose shared parameter is normal too."""
    seen, _ = fleet.rotor(6, lambda b, k: 0.1 * k**2)
    blades, rows = seen.q.shape
    hours = np.array([[0.2, 0.5, 0.9], [0.3, -0.4, 0.1]])
    g = np.tile(hours.T, (blades, 1, 1))
    noise = block_diag(*np.linalg.inv(seen.information))
    slope, prior = seen.slope.reshape(-1, 1), seen.prior
    spread = noise + slope @ np.diag(prior) @ slope.T
    y, modes = spread @ seen.q.reshape(-1), g.reshape(blades * rows, 2)
    nothing = np.zeros(len(y))
    with_it = multivariate_normal(nothing, spread + modes @ modes.T).logpdf(y)
    exact = with_it - multivariate_normal(nothing, spread).logpdf(y)
    assert module._gain(seen, g, np.zeros(g.shape)) == pytest.approx(exact, abs=1e-6)


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


def test_a_gain_of_nothing_has_no_minus(bent: tuple[Case, RotorState, Widened]) -> None:
    none = replace(bent[-1], gained=-0.03)
    assert " gains 0.0 nat, where 2 are asked for" in in_words(none)
    assert " gains -1.2 nat, " in in_words(replace(none, gained=-1.2)), "a loss has one"
    here = Path(module.__file__).parent
    told = re.compile(r":[^{}z]*\.1f\} nat")
    assert [p.name for p in sorted(here.glob("*.py")) if told.search(p.read_text())] == []
