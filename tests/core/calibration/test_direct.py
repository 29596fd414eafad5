"""Messages of closed forms against brute-force quadrature of the same target, and what guards them.

Nodes are spread over the whole priors, where strains span 1e-20 … 1e30 % and the readings' summit
may be 1e-5 of the rates' range wide, or one of two.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import logsumexp

from core.answers import Stacked
from core.builtin import creep_specimens as built
from core.builtin.creep_specimens import QUANTITY, strain
from core.calibration import boxes, windows
from core.calibration.direct import DirectMessage
from core.calibration.online import update
from core.calibration.space import nominal, shared_space
from core.calibration.state import RotorSpec, blade_posterior
from core.calibration.target import assemble
from core.calibration.windows import Readings, narrowed
from core.calibration.workspace import message_of
from core.errors import CalibrationError, InputError, ModelError
from core.model import Model
from core.network import Level, Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.surrogate.closed_form import ClosedForm
from core.surrogate.formula import FormulaInput

Array = NDArray[np.float64]
NODES = 48
ALL: dict[str, Level] = {"primary": "shared", "primary_strain": "shared", "tertiary": "shared"}
TRUTH = np.array([-4.4, 7.0, 0.3, 0.04, 0.4, 150.0])


def message(
    levels: dict[str, Level], count: int, noise: float = 0.03
) -> tuple[DirectMessage, Array]:
    """One specimen at 150 MPa with so many readings, and nodes all over the priors."""
    own = built.freed(built.network(), levels)
    bounded = {"primary": (0.01, 3.0), "tertiary": (0.01, 3.0)}
    parameters = tuple(
        replace(p, prior=Prior("uniform", *bounded[p.name]))
        if p.level == "local" and p.name in bounded
        else p
        for p in own.parameters
    )
    model = Model(replace(own, parameters=parameters), built.formula())
    rng = np.random.default_rng(1)
    times = np.linspace(0.05, 1.0, 10)[-count:] * 390.0
    readings = [
        Inspection(f"{t:.3f}", "a", QUANTITY, float(t), np.array([strain(TRUTH, t) + noise * e]))
        for t, e in zip(times, rng.normal(size=count), strict=True)
    ]
    rows = assemble(model, readings)
    assert rows is not None
    space = shared_space(model, [rows])
    fixed = nominal(model, rows.response.names, {"stress": 150.0})
    made = message_of(model, rows, space, fixed)
    assert isinstance(made, DirectMessage)
    return made, np.random.default_rng(3).random((NODES, space.dim))


def dense(own: DirectMessage, unit: Array, k: int, low: Array, high: Array, n: int) -> float:
    """log ∫ L dl at node k over a box (D,) by n points a side, in the units of a column."""
    readings, rest = own._answered(unit)
    sides = [a + (np.arange(n) + 0.5) / n * (b - a) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(low))
    total = []
    for part in np.array_split(points, -(-len(points) // 20_000)):
        rows = readings.answer(np.full(len(part), k), part)
        total.append(logsumexp(-0.5 * np.sum((rows - readings.y[k]) ** 2 / readings.s2[k], axis=1)))
    size = np.sum(np.log((high - low) / n))
    noise = 0.5 * np.sum(np.log(readings.s2[k]))
    return float(logsumexp(total) + size - noise + rest[k] + own._constant)


def window_of(own: DirectMessage, unit: Array, k: int) -> tuple[Array, Array]:
    """The hull of the boxes at node k."""
    found = own._pieces(unit, 1).boxes
    mine = found.node == k
    return found.low[mine].min(axis=0), found.high[mine].max(axis=0)


def off(own: DirectMessage, unit: Array) -> Array:
    """Column less dense quadrature over the window [nat]."""
    column = own.column(unit)
    return np.array(
        [column[k] - dense(own, unit, k, *window_of(own, unit, k), 40_000) for k in range(NODES)]
    )


@pytest.mark.parametrize("levels", [{}, ALL])
@pytest.mark.parametrize("count", [10, 1])
def test_a_message_is_exact_to_5e_3_nat_over_the_whole_priors(
    levels: dict[str, Level], count: int
) -> None:
    own, unit = message(levels, count)
    assert np.abs(off(own, unit)).max() < 5e-3


@pytest.fixture
def blind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: a window is never parted."""
    monkeypatch.setattr(windows, "VALLEY", np.inf)
    monkeypatch.setattr(windows, "_gaps", lambda kept, begin: np.zeros(begin.shape))


@pytest.mark.usefixtures("blind")
def test_without_windows_for_each_summit_a_message_is_wrong_by_hundreds_of_nats() -> None:
    """One reading against a distant population: two summits, and the kernel climbs the lower."""
    own, unit = message({}, 1)
    assert np.abs(off(own, unit)).max() > 100.0


@pytest.mark.parametrize("count", [10, 1])
def test_what_a_window_leaves_out_is_less_than_e_to_the_minus_40(count: int) -> None:
    """By 20,000 places outside each window, none of which may reach that density."""
    own, unit = message(ALL, count)
    readings, _ = own._answered(unit)
    _, low, high = own._local
    found, narrow = own._pieces(unit, 1).boxes, 0
    for k in range(NODES):
        a, b = window_of(own, unit, k)
        mine = found.node == k
        lows, highs = found.low[mine], found.high[mine]
        x = np.linspace(low[0], high[0], 20_001)
        inside = np.linspace(a[0], b[0], 4001)
        log_l = [
            -0.5
            * np.sum(
                (readings.answer(np.full(len(at), k), at[:, None]) - readings.y[k]) ** 2
                / readings.s2[k],
                axis=1,
            )
            for at in (x[~np.any((x >= lows) & (x <= highs), axis=0)], inside)
        ]
        whole = logsumexp(log_l[1]) + np.log(inside[1] - inside[0])
        outside = logsumexp(log_l[0]) if len(log_l[0]) else -np.inf
        assert outside + np.log(x[1] - x[0]) < whole - 40.0
        narrow += bool(b[0] - a[0] < 0.2 * (high[0] - low[0]))
    assert narrow > NODES // 3


def test_the_bounds_hold_for_the_declared_direction_and_not_for_another() -> None:
    """y = l1 − l2 with a reading of 0: the lower bound of the integral, s √(2π), and the mutant's
    that is above it."""
    s, none = 0.01, np.zeros(2)
    readings = Readings(
        lambda node, local: local[:, [0]] - local[:, [1]],
        np.zeros((1, 1)),
        np.full((1, 1), s**2),
        np.array([False, True]),
        ["y"],
    )
    truth = np.log(s * np.sqrt(2 * np.pi))
    *_, floor = narrowed(readings, none, none + 1.0)
    assert floor[0] < truth
    *_, floor = narrowed(replace(readings, falling=np.array([False, False])), none, none + 1.0)
    assert floor[0] > truth + 1.0


@pytest.mark.parametrize("levels", [{}, ALL])
def test_rows_on_the_boxes_follow_the_formula_within_the_stated_share_of_noise_and_misfit(
    levels: dict[str, Level],
) -> None:
    own, unit = message(levels, 10)
    found, (readings, _) = own._pieces(unit, 1), own._answered(unit)
    rng, made = np.random.default_rng(0), found.boxes
    z = rng.uniform(-1, 1, len(made.node))
    local = made.low + 0.5 * (z[:, None] + 1.0) * (made.high - made.low)
    powers = z[:, None] ** np.arange(6)
    value = np.einsum("brm,bm->br", made.a, powers) * np.exp(
        np.einsum("brm,bm->br", made.b, powers)
    )
    exact = readings.answer(made.node, local)
    scale = np.sqrt(readings.s2[made.node] + (exact - readings.y[made.node]) ** 2)
    missed = np.abs(value - exact) / scale
    assert np.sqrt(np.sum(missed**2, axis=1)).max() < boxes.TOLERANCE
    assert np.all(missed <= 1.5 * made.error + 1e-9)
    assert made.error.max() <= boxes.TOLERANCE


def test_draws_weigh_one_and_have_the_moments_of_dense_quadrature() -> None:
    own, unit = message(ALL, 10)
    column = own.column(unit)
    values, log_w = own.draws(unit, 480, np.random.default_rng(0), column)
    readings, _ = own._answered(unit)
    w = np.exp(log_w)
    assert np.abs(w.sum(axis=1) - 1.0).max() < 0.01
    for k in range(0, NODES, 6):
        a, b = window_of(own, unit, k)
        x = np.linspace(a[0], b[0], 40_001)
        rows = readings.answer(np.full(len(x), k), x[:, None])
        log_l = -0.5 * np.sum((rows - readings.y[k]) ** 2 / readings.s2[k], axis=1)
        p = np.exp(log_l - logsumexp(log_l))
        mean, drawn = p @ x, w[k] @ values[k, :, 0] / w[k].sum()
        sd = np.sqrt(p @ (x - mean) ** 2)
        assert abs(drawn - mean) < 0.03 * sd
        spread = np.sqrt(w[k] @ (values[k, :, 0] - drawn) ** 2 / w[k].sum())
        assert spread == pytest.approx(sd, rel=0.03)


@pytest.mark.parametrize(
    "levels", [{"tertiary": "local"}, {"primary": "local", "tertiary": "local"}]
)
def test_dormant_parameters_of_single_specimens_can_be_freed_too(levels: dict[str, Level]) -> None:
    """Two and three local parameters, at nodes near the posterior: 5e-3 nat."""
    own, _ = message(levels, 3, noise=0.0)
    space = own.space
    truth = {"n": 7.0, "mean.log_rate": -4.4, "sd.log_rate": 0.3, "sigma_obs.creep_strain": 0.3}
    rng = np.random.default_rng(0)
    unit = np.empty((4, space.dim))
    for j, (name, prior) in enumerate(zip(space.names, space.priors, strict=True)):
        low, high = prior.box
        u = (float(prior.to_u(np.array(truth[name]))) - low) / (high - low)
        unit[:, j] = np.clip(u + 0.02 * rng.normal(size=4), 0.01, 0.99)
    column, points = own.column(unit), {2: 600, 3: 100}[1 + len(levels)]
    for k in range(4):
        assert column[k] == pytest.approx(
            dense(own, unit, k, *window_of(own, unit, k), points), abs=5e-3
        )
    values, log_w = own.draws(unit, 480, rng, column)
    assert values.shape == (4, 480, 1 + len(levels))
    assert np.abs(np.exp(log_w).sum(axis=1) - 1.0).max() < 0.1


def kinked(level: Level, **directions: tuple[str, ...]) -> tuple[Model, list[Inspection]]:
    """y = t (l + ⌊200 l⌋ / 200), a staircase that no polynomial follows."""
    prior = Prior("uniform", 0.0, 1.0)
    network = Network(
        "stairs",
        (Parameter("l", level, prior),),
        (Quantity("y", "1", "scalar", Prior("log_uniform", 0.1, 1.0), -10.0, 10.0),),
    )
    form = ClosedForm(
        (FormulaInput("l", 0.0, 1.0),),
        {"y": lambda x, t: t * (x[..., 0] + np.floor(200 * x[..., 0]) / 200)},
        "stairs",
        **directions,
    )
    return Model(network, form), [Inspection("i", "a", "y", 1.0, np.array([0.8]))]


def column_of(model: Model, readings: list[Inspection]) -> Array:
    rows = assemble(model, readings)
    assert rows is not None
    space = shared_space(model, [rows])
    return message_of(model, rows, space, {}).column(np.full((2, space.dim), 0.4))


def test_rows_that_no_boxes_can_follow_are_refused_by_name() -> None:
    with pytest.raises(CalibrationError, match=r"y at 1 h is no polynomial of degree 5 even on 1"):
        column_of(*kinked("local", rising=("l",)))


def test_a_local_parameter_of_unknown_direction_is_refused_and_a_shared_one_is_not() -> None:
    with pytest.raises(InputError, match="not declared as rising or falling"):
        column_of(*kinked("local"))
    model, readings = kinked("shared")
    value = column_of(model, readings)
    sigma = 0.1 * 10.0**0.4
    rate = 0.4 + np.floor(80.0) / 200
    exact = -0.5 * ((0.8 - rate) / sigma) ** 2 - np.log(sigma * np.sqrt(2 * np.pi))
    assert value == pytest.approx(np.full(2, exact), abs=1e-9)


@pytest.mark.parametrize("own", ["local", "shared"])
def test_a_parameter_that_a_closed_form_does_not_see_keeps_its_prior(own: Level) -> None:
    """y = l and z = m: a reading of y says nothing of m."""
    box = Prior("uniform", 0.0, 1.0)
    noise = Prior("log_uniform", 0.01, 1.0)
    network = Network(
        "two forms",
        (Parameter("s", "shared", box), Parameter("l", own, box), Parameter("m", "local", box)),
        tuple(Quantity(name, "1", "scalar", noise, -10.0, 10.0) for name in "yz"),
    )
    of_s, of_l, of_m = (FormulaInput(name, 0.0, 1.0) for name in "slm")
    y = ClosedForm((of_s, of_l), {"y": lambda x, t: x[..., 1] + 0 * t}, "y", rising=("l",))
    z = ClosedForm((of_m,), {"z": lambda x, t: x[..., 0] + 0 * t}, "z", rising=("m",))
    model = Model(network, Stacked(((y, ("y",)), (z, ("z",)))))
    read = Inspection("i", "a", "y", 1.0, np.array([0.3]), sigma=0.05)
    state = update(model, RotorSpec("r", ("a",), 4000), [read])
    found = blade_posterior(state.meta, state.arrays.__getitem__, "a")
    w = found.particles.w
    for name, mean, sd in (("l", 0.3, 0.05), ("m", 0.5, 12**-0.5)):
        values = found.column(name)
        assert w @ values == pytest.approx(mean, abs=0.05 * sd)
        assert np.sqrt(w @ (values - mean) ** 2) == pytest.approx(sd, rel=0.05)


def test_draws_that_lack_a_local_parameter_are_refused() -> None:
    arrays = {"blade/a/local": np.zeros((2, 3, 1)), "blade/a/log_w": np.zeros((2, 3))}
    arrays |= {"shared/x": np.zeros((2, 1)), "shared/log_w": np.zeros(2)}
    meta = {"local": ["l", "m"], "shared": ["s"]}
    with pytest.raises(ModelError, match=r"blade a: draws of 1 local .* 2: l, m"):
        blade_posterior(meta, arrays.__getitem__, "a")


def test_a_local_prior_in_log_x_is_refused_and_a_shared_one_enters_exactly() -> None:
    """y = t x, x log-uniform: its message would be that of a uniform prior."""
    form = ClosedForm(
        (FormulaInput("x", 0.01, 1.0),), {"y": lambda x, t: t * x[..., 0]}, "line", rising=("x",)
    )
    readings = [Inspection("i", "a", "y", 1.0, np.array([0.3]), sigma=0.1)]

    def model(level: Level) -> Model:
        noise = Prior("log_uniform", 0.1, 1.0)
        own = Parameter("x", level, Prior("log_uniform", 0.01, 1.0))
        quantity = Quantity("y", "1", "scalar", noise, -10.0, 10.0)
        return Model(Network("line", (own,), (quantity,)), form)

    with pytest.raises(InputError, match=r"prior of x.*formula in its logarithm"):
        assemble(model("local"), readings)
    exact = -0.5 * ((0.3 - 0.01 * 100**0.4) / 0.1) ** 2 - np.log(0.1 * np.sqrt(2 * np.pi))
    assert column_of(model("shared"), readings) == pytest.approx(np.full(2, exact), abs=1e-9)


def test_a_formula_that_is_no_number_at_the_end_of_a_prior_is_refused_by_row_and_place() -> None:
    """As x log x is at 0: no probe of `ClosedForm` lies there, and every window begins there."""

    def formula(x: Array, t: Array) -> Array:
        own, s = np.moveaxis(x, -1, 0)
        return np.where(own > 0.0, own, np.nan) * s * t

    box, noise = Prior("uniform", 0.0, 1.0), Prior("log_uniform", 0.01, 1.0)
    form = ClosedForm(
        (FormulaInput("l", 0.0, 1.0), FormulaInput("s", 0.5, 1.5)), {"y": formula}, "f",
        rising=("l", "s"),
    )  # fmt: skip
    both = (Parameter("l", "local", box), Parameter("s", "shared", Prior("uniform", 0.5, 1.5)))
    model = Model(Network("f", both, (Quantity("y", "1", "scalar", noise, -9.0, 9.0),)), form)
    read = [Inspection("i", "a", "y", 2.0, np.array([1.1]))]
    with pytest.raises(CalibrationError, match=r"y at 2 h is not a number where .* \[0\.0\]"):
        update(model, RotorSpec("r", ("a",), 1000), read)


def test_what_needs_polynomials_says_so() -> None:
    own, _ = message({}, 3)
    with pytest.raises(ModelError, match="answers by closed formulas"):
        _ = own.rows.polynomials
