from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from core.archive import Input
from core.monomials import monomials
from core.surrogate import Surrogate
from core.surrogate.compile import Compiler
from core.surrogate.fit import Fit
from core.surrogate.kernel import Hyper, SharedGP
from core.surrogate.report import polynomial_error

Array = NDArray[np.float64]
TIMES = [500.0, 8000.0, 50_000.0]
NODES = [299, 130]


@pytest.fixture(scope="module")
def x(model: Surrogate) -> Array:
    return np.random.default_rng(5).uniform(model.low, model.high, (300, 4))


@pytest.mark.parametrize(
    ("quantity", "tolerance"),
    [
        ("elongation", 1e-4),
        ("ceeq", 1e-4),
        ("creep_damage", 1e-4),
        ("mises", 1e-4),
        ("deformation", 1e-4),
        ("displacement", 1e-2),
    ],
)
def test_a_response_is_the_prediction_in_the_same_order(
    model: Surrogate, x: Array, quantity: str, tolerance: float
) -> None:
    nodes = None if quantity == "elongation" else NODES
    mean, sd = model.predict(x, quantity, TIMES, nodes)
    found, found_sd = model.response(quantity, TIMES, nodes).evaluate(x)
    mean, sd = mean.reshape(300, -1), sd.reshape(300, -1)
    scale = np.abs(mean).max(axis=0)
    assert np.all(scale > 0)
    assert np.max(np.abs(found - mean) / scale) < tolerance
    if quantity != "displacement":
        np.testing.assert_allclose(np.median(found_sd / sd, axis=0), 1.0, atol=0.1)


def test_logarithmic_rows_carry_their_error_in_b_and_raw_ones_in_a(model: Surrogate) -> None:
    log = model.response("ceeq", TIMES, NODES)
    assert np.all(log.a[:, 0] == 1)
    assert not log.a[:, 1:].any()
    assert not log.ka.any()
    assert np.all(log.kb > 0)
    ratio = model.response("elongation", TIMES)
    assert np.all(ratio.ka > 0)
    assert np.all(ratio.kb > 0)


def test_rows_at_zero_are_nothing(model: Surrogate, x: Array) -> None:
    for name, nodes in (("elongation", None), ("ceeq", NODES), ("deformation", NODES)):
        mean, sd = model.response(name, [0.0], nodes).evaluate(x)
        assert np.abs(mean).max() < 1e-25
        assert sd.max() < 1e-25


def test_each_degree_is_nearer_than_the_one_below(model: Surrogate) -> None:
    error = [
        polynomial_error(model, degree=degree, samples=200)["elongation"]["p95_percent"]
        for degree in (2, 3, 4)
    ]
    assert error[0] > 3 * error[1] > 9 * error[2]


def test_a_polynomial_process_is_compiled_exactly() -> None:
    z = np.random.default_rng(7).uniform(-1, 1, (40, 3))
    target = monomials(z, 2) @ np.arange(1.0, 11.0)[:, None]
    process = SharedGP.condition(z, target, Hyper((2.0, 2.0, 2.0), 1e-4, 2))
    made = Compiler.of(process, 3)
    np.testing.assert_allclose(made.polynomials[0, :10], np.arange(1.0, 11.0), rtol=1e-8)
    np.testing.assert_allclose(made.polynomials[0, 10:], 0.0, atol=1e-8)


def test_the_edge_of_the_box_is_no_worse_than_twenty_times_the_inside(model: Surrogate) -> None:
    corners = np.array(np.meshgrid(*zip(model.low, model.high, strict=True))).reshape(4, -1).T
    inside = np.random.default_rng(1).uniform(model.low, model.high, (200, 4))
    worst = []
    for x in (corners, inside):
        mean, _ = model.predict(x, "elongation", [20_000.0])
        found, _ = model.response("elongation", [20_000.0]).evaluate(x)
        worst.append(np.max(np.abs(found / mean - 1)))
    assert worst[0] < 20 * worst[1]


def test_polynomials_are_made_once(model: Surrogate) -> None:
    assert model.compiler(6) is model.compiler(6)


def test_rows_of_nothing_need_no_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of eight inputs one took 17 s of a processor and 160 MB, for the number of its terms."""

    def fitted(*given: int) -> None:
        raise AssertionError(f"points were fitted for {given}")

    monkeypatch.setattr("core.surrogate.fit.fitting", fitted)
    nothing = Fit([Input(f"x{j}", 0.0, 1.0) for j in range(8)], 5, False).nothing(3)
    mean, sd = nothing.evaluate(np.full((2, 8), 0.3))
    assert mean.shape == sd.shape == (2, 3)
    assert not mean.any()
