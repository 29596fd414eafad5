"""The power of the process' variance that a part's error goes with (`core.surrogate.part`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from core.surrogate import Surrogate
from core.surrogate.fitting import reduced
from core.surrogate.followed import Followed
from core.surrogate.held_out import TOGETHER, Held, calibrate, power_of
from core.surrogate.history import constant
from core.surrogate.kernel import Hyper
from core.surrogate.part import Part
from core.surrogate.targets import Target

Array = NDArray[np.float64]
TIMES = [500.0, 8000.0, 50_000.0]
NODES = [299, 130]
POWER = 0.6


def powered(model: Surrogate, power: float) -> Surrogate:
    parts: Mapping[str, Part] = {
        name: replace(part, power=1.0 if name in TOGETHER or part.form == "per ceeq" else power)
        for name, part in model.parts.items()
    }
    return replace(model, parts=parts, _compilers={})


@pytest.fixture(scope="module")
def x(model: Surrogate) -> Array:
    return np.random.default_rng(5).uniform(model.low, model.high, (300, 4))


@pytest.mark.parametrize("quantity", ["ceeq", "creep_damage", "mises"])
def test_the_sd_goes_with_that_power_and_is_the_same_where_v_is_typical(
    model: Surrogate, x: Array, quantity: str
) -> None:
    _, plain = powered(model, 1.0).predict(x, quantity, TIMES, NODES)
    _, sd = powered(model, POWER).predict(x, quantity, TIMES, NODES)
    _, v = model.process.mean_and_variance(model.scaled(x), ())
    over = (v / model.v_typical) ** (0.5 * (POWER - 1.0))
    assert np.ptp(over) > 0.5
    np.testing.assert_allclose(sd / plain, np.broadcast_to(over[:, None, None], sd.shape))


@pytest.mark.parametrize("quantity", ["elongation", "deformation"])
def test_what_is_put_together_with_mean_ceeq_keeps_v(
    model: Surrogate, x: Array, quantity: str
) -> None:
    nodes = None if quantity == "elongation" else NODES
    for a, b in zip(
        powered(model, 1.0).predict(x, quantity, TIMES, nodes),
        powered(model, POWER).predict(x, quantity, TIMES, nodes),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("quantity", ["ceeq", "creep_damage", "mises"])
def test_compiled_rows_have_it(model: Surrogate, x: Array, quantity: str) -> None:
    own = powered(model, POWER)
    _, sd = own.predict(x, quantity, TIMES, NODES)
    _, found = own.response(quantity, TIMES, NODES).evaluate(x)
    _, plain = powered(model, 1.0).response(quantity, TIMES, NODES).evaluate(x)
    over = found / sd.reshape(len(x), -1)
    np.testing.assert_allclose(np.median(over, axis=0), 1.0, atol=0.05)
    assert np.all(np.quantile(over, [0.05, 0.95]) > 0.7)
    assert np.abs(np.log(plain / found)).max() > 0.3


@pytest.mark.parametrize("quantity", ["ceeq", "creep_damage"])
def test_rows_that_are_followed_in_time_have_it(model: Surrogate, x: Array, quantity: str) -> None:
    own, marks = powered(model, POWER), np.array(TIMES[1:])
    at = own.parts[quantity].factors.time_h
    marks = at[np.searchsorted(at, marks)]  # instants of the runs, where scales are no chords
    _, sd = own.predict(x[:40], quantity, marks, NODES)
    ((_, followed, _),) = constant(own, x[:40], marks, [Followed.of(own, quantity, NODES)])
    np.testing.assert_allclose(followed, sd.reshape(40, len(marks), -1), rtol=1e-6)


def made(seed: int, loss: float) -> tuple[Array, dict[str, Target]]:
    """80 runs of two inputs, dense about the middle: a field that the process learns, and, where
    `loss` is not 0, ripples over the rows that the bases leave out, of one size everywhere."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(-1, 1, (80, 2)) * rng.choice([0.3, 1.0], (80, 1))
    rows, time = np.linspace(0, 1, 60), np.geomspace(1, 1000, 8)
    smooth = np.exp(0.8 * z[:, :1]) * np.sin(2 * z[:, 1:]) * rows + np.cos(z[:, 1:]) * rows**2
    signs = rng.choice([-1.0, 1.0], (80, 60))
    values = smooth + loss * signs
    field = np.log(1 + time)[None, :, None] * values[:, None, :]
    return z, {"heat": Target("heat", "raw", time, field)}


def calibrated(seed: int, loss: float) -> Held:
    z, targets = made(seed, loss)
    return calibrate(z, targets, Hyper((1.5, 1.5), 1e-6, 2), seed)["heat"]


def test_where_bases_lose_more_than_the_process_the_power_is_below_one() -> None:
    assert all(calibrated(seed, 0.02).power < 0.95 for seed in range(4))
    assert all(calibrated(seed, 0.0).power == 1.0 for seed in range(4))  # it is never above


def test_reduction_leaves_what_the_ripples_are() -> None:
    _, targets = made(0, 0.02)
    fitted = reduced(targets["heat"], 0)
    assert np.mean(fitted.cut_time) > 1e-3


def test_noise_about_a_power_of_one_is_not_believed() -> None:
    """Of 200 made with the right v some 5 % have an interval without it; with half as many sds
    where v is large all have."""
    rng = np.random.default_rng(7)
    v = np.geomspace(0.01, 10, 40)
    sound = [power_of(v, np.abs(rng.standard_normal((40, 30, 1)))) for _ in range(200)]
    assert np.mean(np.array(sound) != 1.0) < 0.12
    over = (v**-0.1)[:, None, None]
    wrong = [power_of(v, over * np.abs(rng.standard_normal((40, 30, 1)))) for _ in range(50)]
    assert np.mean(wrong) == pytest.approx(0.8, abs=0.03)
