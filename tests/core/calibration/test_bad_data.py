"""Bad data have stated outcomes: never NaN, never a silent collapse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration import health
from core.calibration.health import verdict
from core.calibration.online import update
from core.calibration.state import RotorSpec, RotorState, blade_posterior, shared_posterior
from core.errors import CalibrationError
from core.model import Model, rotor_blade
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel

SPEC = RotorSpec("r", tuple(f"b{i}" for i in range(6)), particles=1200, seed=4)


def sum_model() -> Model:
    """y = s + l, both uniform, the noise unknown unless a reading says it."""
    parameters = (
        Parameter("s", "shared", Prior("uniform", 0.0, 4.0)),
        Parameter("l", "local", Prior("uniform", -0.5, 0.5)),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    noise = Prior("log_uniform", 0.01, 1.0)
    quantity = Quantity("y", "1", "scalar", noise, -100.0, 100.0)
    return Model(
        Network("sum", parameters, (quantity,)),
        FormulaModel(inputs, {"y": lambda x, t: x[:, 0] + x[:, 1]}, "sum"),
    )


MODEL = sum_model()


def reading(
    blade: int, value: float, sigma: float | None = 0.02, t: float = 8e3, name: str = ""
) -> Inspection:
    return Inspection(
        name or f"b{blade}t{t:g}", f"b{blade}", "y", t, np.array([value]), sigma=sigma
    )


def clean(blades: int = 5, sigma: float | None = 0.02) -> list[Inspection]:
    rng = np.random.default_rng(2)
    return [
        reading(b, 1.1 + level + 0.02 * rng.normal(), sigma, t)
        for b, level in enumerate(rng.uniform(-0.5, 0.5, blades))
        for t in (8e3, 16e3)
    ]


def assert_finite(state: RotorState) -> None:
    """Neither NaN nor an infinity that would not survive JSON; a draw without weight is −inf."""
    assert np.isfinite(state.meta["log_evidence"])
    for name, array in state.arrays.items():
        assert not np.isnan(array).any(), name
        if not name.endswith("log_w"):
            assert np.isfinite(array).all(), name
    for blade in state.meta["blades"]:
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        assert np.isfinite(posterior.particles.mean).all()


def outcome(readings: list[Inspection], model: Model = MODEL) -> tuple[RotorState, dict]:
    state = update(model, SPEC, readings)
    assert_finite(state)
    return state, state.meta["health"]


def shared_mean(state: RotorState) -> np.ndarray:
    return shared_posterior(state.meta, state.arrays.__getitem__).particles.mean


def test_readings_that_fit_are_ok() -> None:
    for readings in ([], [reading(0, 1.3, None)], clean(), clean(sigma=None)):
        _, told = outcome(readings)
        assert (told["status"], told["reasons"], told["contradicted"]) == ("ok", [], [])
        assert told["met_floor"]


def test_no_reading_is_the_prior() -> None:
    state, _ = outcome([])
    assert state.meta["log_evidence"] == pytest.approx(0.0, abs=0.02)
    assert shared_mean(state)[0] == pytest.approx(2.0, abs=0.05)


def test_equal_readings_drive_the_noise_to_its_bound_and_no_further() -> None:
    same = [reading(0, 1.3, None, t) for t in (1e3, 2e3, 3e3, 4e3, 5e3, 6e3)]
    state, told = outcome(same)
    assert told["status"] == "ok"
    sigma = shared_posterior(state.meta, state.arrays.__getitem__).column("sigma_obs.y")
    assert sigma.min() >= 0.01
    assert shared_mean(state)[1] < 0.02


def test_a_blade_that_contradicts_the_rotor_is_named_with_its_exact_misfit() -> None:
    far = reading(5, 3.2, sigma=0.1)
    state, told = outcome([*clean(), far])
    assert told["status"] == "contradicted"
    assert [one["blade"] for one in told["contradicted"]] == ["b5"]
    best = state.arrays["shared/x"][np.argmax(state.arrays["shared/log_p"]), 0]
    one = told["contradicted"][0]
    assert one["misfit_nat"] == pytest.approx(0.5 * ((3.2 - best - 0.5) / 0.1) ** 2, abs=0.1)
    assert one["own_nat"] == pytest.approx(0.0, abs=0.05)
    assert "b5" in told["reasons"][0]
    assert "contradicts the rotor" in told["reasons"][0]


def test_readings_of_one_blade_that_contradict_each_other_are_told_apart() -> None:
    twice = [reading(5, 1.0, 1e-3, name="x"), reading(5, 1.4, 1e-3, name="y")]
    _, told = outcome([*clean(), *twice])
    assert [one["blade"] for one in told["contradicted"]] == ["b5"]
    exact = 2 * 0.5 * (0.2 / 1e-3) ** 2
    assert told["contradicted"][0]["misfit_nat"] == pytest.approx(exact, rel=1e-3)
    assert told["contradicted"][0]["own_nat"] == pytest.approx(exact, rel=1e-3)
    assert "contradicts the model or itself" in told["reasons"][0]


def suspected(told: dict) -> list[str]:
    return [one["reading"] for one in told["contradicted"][0]["suspects"]]


def test_the_reading_that_is_wrong_is_named_with_what_the_others_leave() -> None:
    """Eight readings of a blade, one of them half a millimetre off."""
    rng = np.random.default_rng(7)
    values = 1.2 + 0.02 * rng.normal(size=8)
    values[3] += 0.5
    many = [reading(5, v, 0.02, 1e3 * (k + 1)) for k, v in enumerate(values)]
    state, told = outcome([*clean(), *many])
    assert suspected(told) == ["b5t4000"]
    (one,) = told["contradicted"][0]["suspects"]
    rest = np.delete(values, 3)
    exact = float(np.sum((rest - rest.mean()) ** 2) / (2 * 0.02**2))
    assert one["misfit_nat"] == pytest.approx(exact, abs=0.06)
    assert one["time_h"] == 4e3
    assert told["reasons"][0].endswith(
        "; without reading b5t4000 (4,000 h) all others fit: look at that one"
    )
    mended = [r for r in many if r.id != one["reading"]]
    assert outcome([*clean(), *mended])[1]["status"] == "ok", "as it was said"
    assert update(MODEL, SPEC, [*many, *clean()]).digest == state.digest, "in any order"


def test_of_two_that_contradict_each_other_both_are_suspected() -> None:
    both = [reading(5, 1.0, 1e-3, name="x"), reading(5, 1.4, 1e-3, name="y")]
    _, told = outcome([*clean(), *both])
    assert sorted(suspected(told)) == ["x", "y"]
    assert "without one of the readings" in told["reasons"][0]


@pytest.mark.parametrize("values", [(3.2, 3.3, 3.1), (1.0, 2.4, 3.8, 0.2), (3.2,)])
def test_where_no_reading_alone_is_to_blame_none_is(values: tuple[float, ...]) -> None:
    """A blade that is another one, readings that all differ, one reading alone."""
    many = [reading(5, v, 0.1, 1e3 * (k + 1)) for k, v in enumerate(values)]
    _, told = outcome([*clean(), *many])
    assert [one["blade"] for one in told["contradicted"]] == ["b5"]
    assert suspected(told) == []
    assert "look at" not in told["reasons"][0]


def test_of_many_blades_those_that_miss_most_are_looked_through(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(health, "ACCUSED", 1)
    wrong = [reading(b, 1.4 + 0.3 * (b == 4), 1e-3, t=3e4, name=f"w{b}") for b in (3, 4)]
    fine = [reading(b, 1.2, 1e-3, t) for b in (3, 4) for t in (1e4, 2e4)]
    _, told = outcome([*clean(3), *fine, *wrong])
    found = {one["blade"]: len(one["suspects"]) for one in told["contradicted"]}
    assert found == {"b3": 0, "b4": 1}


@pytest.mark.parametrize("sigma", [1e-3, 0.02, None])
def test_readings_impossible_under_every_parameter_are_contradicted(sigma: float | None) -> None:
    _, told = outcome([reading(b, 40.0, sigma) for b in range(3)])
    assert told["status"] == "contradicted"
    assert [one["blade"] for one in told["contradicted"]] == ["b0", "b1", "b2"]
    assert all(one["own_nat"] > 20 for one in told["contradicted"])


def test_an_outlier_of_fifty_sigma_is_named_or_widens_an_unknown_noise() -> None:
    rng = np.random.default_rng(5)

    def many(sigma: float | None) -> list[Inspection]:
        values = 1.2 + 0.02 * rng.normal(size=8)
        return [reading(1, v, sigma, 1e3 * (i + 1)) for i, v in enumerate(values)]

    _, told = outcome([*many(0.02), reading(1, 2.2, 0.02, 9e4)])
    assert [one["blade"] for one in told["contradicted"]] == ["b1"]
    state, told = outcome([*many(None), reading(1, 2.2, None, 9e4)])
    assert told["status"] == "ok"
    assert shared_mean(state)[1] > 0.2


def test_a_quick_state_keeps_what_was_contradicted_and_sealing_judges_anew() -> None:
    far = reading(5, 3.2, sigma=0.1)
    before = update(MODEL, SPEC, [*clean(), far])
    late = reading(0, float(clean()[0].values[0]), 0.02, t=24e3)
    quick = update(MODEL, SPEC, [*clean(), far, late], before, quick=True)
    assert not quick.sealed
    assert [one["blade"] for one in quick.meta["health"]["contradicted"]] == ["b5"]
    mended = update(MODEL, SPEC, [*clean(), late], quick)
    assert mended.meta["health"]["status"] == "ok"
    assert mended.digest == update(MODEL, SPEC, [*clean(), late]).digest


def test_clean_rotors_are_not_accused() -> None:
    """60 blades in readings of their own noise; with a loose threshold the same test accuses."""
    rng = np.random.default_rng(6)
    accused = {-20.0: 0, -1.0: 0}
    for r in range(3):
        spec = replace(SPEC, blades=tuple(f"b{i}" for i in range(20)), seed=r)
        readings = [
            reading(b, 2.0 + level + 0.1 * rng.normal(), 0.1, t)
            for b, level in enumerate(rng.uniform(-0.5, 0.5, 20))
            for t in (8e3, 16e3, 24e3)
        ]
        for limit in accused:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(health, "IMPROBABLE", limit)
                state = update(MODEL, spec, readings)
            accused[limit] += len(state.meta["health"]["contradicted"])
    assert accused[-20.0] == 0
    assert accused[-1.0] > 0, "negative control"


def test_a_state_below_its_floor_says_so() -> None:
    fine = {"ess_ratio": 0.8, "ess": 51.0, "nodes": 64, "tempered": 1.0, "message_tilt_nat": 0.29}
    assert verdict(fine, [], sealed=True)["status"] == "ok"
    assert verdict(fine | {"message_tilt_nat": 0.31}, [], sealed=False)["status"] == "ok"
    for worse in (
        {"ess_ratio": 0.05, "ess": 3.2},
        {"tempered": 0.4},
        {"ess_ratio": float("nan")},
        {"message_tilt_nat": 0.31},
        {"message_tilt_nat": float("nan")},
    ):
        told = verdict(fine | worse, [], sealed=True)
        assert told["status"] == "degenerate"
        assert not told["met_floor"]
        assert len(told["reasons"]) == 1
    assert verdict(fine | {"ess_ratio": 0.15}, [], sealed=False)["met_floor"]


def test_a_tempered_quick_state_is_degenerate_until_it_is_sealed() -> None:
    before = update(MODEL, SPEC, clean())
    late = reading(5, 1.98, 0.02)
    quick = update(MODEL, SPEC, [*clean(), late], before, quick=True)
    told = quick.meta["health"]
    if told["tempered"] < 1:
        assert told["status"] == "degenerate"
    sealed = update(MODEL, SPEC, [*clean(), late])
    assert sealed.meta["health"]["met_floor"]


def test_a_noise_beyond_the_numbers_is_refused_by_name() -> None:
    with pytest.raises(CalibrationError, match="not a number"):
        update(MODEL, SPEC, [*clean(), reading(5, 1.0, 1e-200)])


def test_the_built_in_rotor_names_a_blade_that_no_parameters_explain() -> None:
    model, rng = rotor_blade(), np.random.default_rng(0)
    readings = []
    for b in range(4):
        truth = {"t1t_rate": 0.92, "tbc_thickness": rng.uniform(2 / 3, 4 / 3)}
        truth |= {n: rng.uniform(-3, 3) for n in ("creep_transient", "creep_steady")}
        x = np.array([[truth[n] for n in model.input_names]])
        y, _ = model.surrogate.predict(x, "elongation", np.array([8e3, 16e3]))
        readings += [
            Inspection(f"b{b}-{k}", f"b{b}", "elongation", t, y[0, [k]] + 0.004 * rng.normal())
            for k, t in enumerate((8e3, 16e3))
        ]
    _, told = outcome(readings, model)
    assert told["status"] == "ok"
    wrong = [*readings[1:], replace(readings[0], values=np.array([40.0]), sigma=1e-3)]
    _, told = outcome(wrong, model)
    assert told["status"] == "contradicted"
    worst = max(told["contradicted"], key=lambda one: one["misfit_nat"])
    assert worst["blade"] == "b0"
    assert [one["reading"] for one in worst["suspects"]] == ["b0-0"]
