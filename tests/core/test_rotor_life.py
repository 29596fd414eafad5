"""Which blades of a rotor pass a limit, and how surely any does: against joint draws."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from core.calibration.online import update
from core.calibration.state import Arrays, RotorSpec, RotorState, blade_posterior
from core.curves import SPAN, curves
from core.errors import InputError, RangeError
from core.life import instants, life
from core.model import Model, rotor_blade
from core.network import Network, Parameter, Quantity
from core.planning.ahead import Drawn
from core.prior import Prior
from core.rotor_life import RotorLife, rotor_life
from core.surrogate.formula import FormulaInput, FormulaModel
from tests.core.calibration.test_exact import conjugate, exact, readings

Array = NDArray[np.float64]
BLADES = tuple(f"b{b}" for b in range(8))
HOURS = (8000.0, 24_000.0, 40_000.0)
NODES, EACH = 40, 25


def made(
    shared: dict[str, Array], local: dict[str, Array], log_w: Array, own: Array | None = None
) -> RotorState:
    """A state by hand: shared values (K,) and weights (K,), local ones (B, K, m), own (B, K, m)."""
    arrays = {"shared/x": np.stack([*shared.values()], axis=1), "shared/log_w": log_w}
    values = np.stack([*local.values()], axis=-1)
    for blade, drawn in zip(BLADES, values, strict=False):
        arrays[f"blade/{blade}/local"] = drawn
        even = np.full(drawn.shape[:2], -np.log(drawn.shape[1]))
        arrays[f"blade/{blade}/log_w"] = even if own is None else own[BLADES.index(blade)]
    meta = {"shared": [*shared], "local": [*local]}
    return RotorState(meta, Arrays(arrays, arrays, arrays.__getitem__))


def hot(sums_to_one: bool = True, spread: float = 0.12) -> RotorState:
    """Shipped blades whose gas may run cool or hot: T1T is hardly known."""
    rng = np.random.default_rng(5)
    t1t = 0.87 + spread * (np.arange(NODES) / (NODES - 1) - 0.5)
    shape = (len(BLADES), NODES, EACH)
    local = {
        "tbc_thickness": rng.uniform(0.8, 1.2, shape),
        "creep_transient": rng.normal(0.0, 0.8, shape).clip(-3.0, 3.0),
        "creep_steady": rng.normal(0.0, 0.8, shape).clip(-3.0, 3.0),
    }
    own = rng.normal(0.0, 0.7, shape)
    if sums_to_one:
        own -= np.log(np.exp(own).sum(axis=2, keepdims=True))
    shared = {"t1t_rate": t1t, "sigma_obs.elongation": np.full(NODES, 0.02)}
    return made(shared, local, rng.normal(0.0, 0.5, NODES), own)


MODEL, LIMIT = rotor_blade(), 0.5


@pytest.fixture(scope="module")
def state() -> RotorState:
    return hot()


def told(state: RotorState, **more: object) -> RotorLife:
    given = {"blades": BLADES, "quantity": "elongation", "limit": LIMIT, "times": HOURS}
    return rotor_life(MODEL, state, **(given | more))  # type: ignore[arg-type]


def by_joint_draws(state: RotorState, n: int, *, apart: bool = False) -> Array:
    """Of n draws of the rotor: which blades have passed by HOURS, (n, B, T).

    A node for all blades, a particle of it and an error of the surrogate for each of them.
    apart   a node of its own for each blade, as if they shared nothing
    """
    rng = np.random.default_rng(8)
    time = np.union1d(HOURS, instants(MODEL, "elongation"))
    log_w = state.arrays["shared/log_w"]
    node_w = np.exp(log_w) / np.exp(log_w).sum()
    node = rng.choice(len(node_w), n, p=node_w)
    out = np.empty((n, len(BLADES), len(HOURS)), bool)
    for b, blade in enumerate(BLADES):
        if apart:
            node = rng.choice(len(node_w), n, p=node_w)
        w = np.exp(state.arrays[f"blade/{blade}/log_w"])
        reached = np.cumsum(w / w.sum(axis=1, keepdims=True), axis=1)
        inner = (rng.random((n, 1)) > reached[node]).sum(axis=1).clip(max=EACH - 1)
        own = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        one = curves(MODEL, own, "elongation", time)
        at = node * EACH + inner
        y = one.mean[at] + one.width[at] * rng.standard_normal((n, 1))
        over = np.logical_or.accumulate(y >= LIMIT, axis=1)
        out[:, b] = over[:, np.searchsorted(time, HOURS)]
    return out


def test_chances_are_those_of_joint_draws_of_the_rotor(state: RotorState) -> None:
    n = 40_000
    found, drawn = told(state), by_joint_draws(state, n)
    for b, blade in enumerate(BLADES):
        assert found.passed[blade] == pytest.approx(drawn[:, b].mean(axis=0), abs=2 / np.sqrt(n))
    number = drawn.sum(axis=1)
    error = 4 * number.std(axis=0) / np.sqrt(n) + 1e-4
    assert np.all(np.abs(found.expected - number.mean(axis=0)) < error)
    assert found.any == pytest.approx(drawn.any(axis=1).mean(axis=0), abs=2 / np.sqrt(n))
    assert 0.1 < found.any[-1] < 0.9, "the control: neither sure nor impossible"
    assert (found.unit, found.limit, found.time_h.tolist()) == ("mm", LIMIT, [*HOURS])


def test_blades_taken_for_independent_would_be_told_another_chance(state: RotorState) -> None:
    """Negative control: of blades that run hot together, or not at all."""
    found = told(state)
    alone = 1.0 - np.prod([1.0 - own for own in found.passed.values()], axis=0)
    n = 40_000
    apart = by_joint_draws(state, n, apart=True).any(axis=1).mean(axis=0)
    assert alone == pytest.approx(apart, abs=2 / np.sqrt(n))
    assert alone[-1] - found.any[-1] > 0.1
    known = told(hot(spread=0.0))
    alone = 1.0 - np.prod([1.0 - own for own in known.passed.values()], axis=0)
    assert known.any[-1] == pytest.approx(alone[-1], abs=5e-4), "where it is known, they are"


@pytest.mark.parametrize("sums_to_one", [True, False])
@pytest.mark.parametrize("most", [None, 400])
def test_a_blade_s_chance_is_what_core_life_tells_of_its_particles(
    sums_to_one: bool, most: int | None
) -> None:
    state = hot(sums_to_one)
    found = told(state, most=most)
    for blade in BLADES:
        own = Drawn.of(state, blade, most).posterior
        alone = life(MODEL, own, "elongation", LIMIT, HOURS)
        assert len(own.particles.w) == (1000 if most is None else 360)
        assert found.passed[blade] == pytest.approx(alone.passed, abs=1e-12)
        single = told(state, blades=[blade], most=most)
        assert single.any == pytest.approx(alone.passed, abs=1e-12)
        assert single.expected == pytest.approx(alone.passed, abs=1e-12)


def test_any_lies_between_the_likeliest_blade_and_all_of_them_together() -> None:
    for state in (hot(), hot(sums_to_one=False)):
        found = told(state, times=np.linspace(0.0, 50_000.0, 30))
        whole = np.stack([*found.passed.values()])
        assert np.all(found.any >= whole.max(axis=0) - 1e-12)
        assert np.all(found.any <= np.minimum(1.0, whole.sum(axis=0)) + 1e-12)
        assert np.all(np.diff(found.any) >= 0)
        assert found.expected == pytest.approx(whole.sum(axis=0))


def test_a_calibrated_rotor_is_told_what_exact_normals_tell() -> None:
    """y = 0.8 s + 1.3 l_b with one blade of eight read: 100,000 joint normals beside it."""
    model, sigma = conjugate(1), 0.2
    data = readings(1, [0.0], seed=4, sigma=sigma)
    spec = RotorSpec("r", BLADES, particles=6400, seed=3)
    found = rotor_life(model, update(model, spec, data), BLADES, "y", 1.6, [0.0])
    mean, cov, _ = exact(model, data, len(BLADES), 1)
    drawn = np.random.default_rng(2).multivariate_normal(mean, cov, 100_000)
    y = 0.8 * drawn[:, :1] + 1.3 * drawn[:, 1:]
    whole = np.array([found.passed[b][0] for b in BLADES])
    assert whole == pytest.approx((y >= 1.6).mean(axis=0), abs=0.02), "also of those never read"
    assert found.expected[0] == pytest.approx((y >= 1.6).sum(axis=1).mean(), abs=0.06)
    assert found.any[0] == pytest.approx((y >= 1.6).any(axis=1).mean(), abs=0.02)
    alone = 1.0 - np.prod(1.0 - whole)
    assert alone - found.any[0] > 0.05


def growing(shrinks: bool = False, falls: bool = False) -> Model:
    """y = (heat + rate) t / 10,000 h; back from the middle on; or 30 less that."""

    def formula(x: Array, t: float) -> Array:
        y = (x[:, 0] + x[:, 1]) * (min(t, 50_000.0 - t) if shrinks else t) / 1e4
        return 30.0 - y if falls else y

    parameters = (
        Parameter("heat", "shared", Prior("uniform", 0.0, 50.0)),
        Parameter("rate", "local", Prior("uniform", 0.0, 50.0)),
        Parameter("size", "known", Prior("uniform", 0.0, 9.0)),
    )
    quantity = Quantity("y", "mm", "scalar", Prior("log_uniform", 1e-3, 1.0), -99.0, 1e3)
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    name = f"growing {shrinks} {falls}"
    formulas = {"y": lambda x, t: formula(x, t) + x[:, 2]}
    return Model(
        Network("growing", parameters, (quantity,)),
        FormulaModel(inputs, formulas, name, horizon_h=50_000.0),
    )


def even(rates: Array) -> RotorState:
    """Two blades, of which the second runs at twice the rate of the first."""
    k = 200
    heat = np.exp(0.3 * ndtri((np.arange(k) + 0.5) / k))
    local = {"rate": np.stack([np.tile(rates, (k, 1)), np.tile(2 * rates, (k, 1))])}
    shared = {"heat": heat, "sigma_obs.y": np.full(k, 0.01)}
    return made(shared, local, np.zeros(k))


KNOWN = {"b0": {"size": 0.0}, "b1": {"size": 0.0}}


def test_what_was_passed_stays_passed_and_what_falls_passes_from_above() -> None:
    state, two = even(np.array([0.1, 0.2])), BLADES[:2]
    up = rotor_life(growing(), state, two, "y", 2.9, [25_000.0], known=KNOWN)
    for model, limit in ((growing(shrinks=True), 2.9), (growing(falls=True), 30.0 - 2.9)):
        late = rotor_life(model, state, two, "y", limit, [25_000.0, 49_000.0], known=KNOWN)
        assert late.any[0] == pytest.approx(up.any[0], abs=1e-9)
        alone = rotor_life(model, state, two, "y", limit, [49_000.0], known=KNOWN)
        assert alone.any[0] == pytest.approx(late.any[1], abs=1e-9), "asked for by itself"
        assert late.any[1] >= late.any[0]
        if limit < 10:
            assert late.any[1] == pytest.approx(up.any[0], abs=0.02), "and it stays"
            assert late.expected[1] == pytest.approx(up.expected[0], abs=0.04)
    assert up.passed["b0"][0] < up.passed["b1"][0] < 1.0


def test_hours_from_now_on_are_each_blade_s_own_from_its_age() -> None:
    """What was passed before stays passed, and `any` is of one outage, not of one age."""
    state, two = even(np.array([0.1, 0.2])), BLADES[:2]
    ages = {"b0": 20_000.0, "b1": 3_000.0}
    ahead = rotor_life(growing(), state, two, "y", 2.9, [0.0, 7_000.0], known=KNOWN, ages=ages)
    assert ahead.time_h.tolist() == [0.0, 7_000.0]
    for blade, age in ages.items():
        own = rotor_life(growing(), state, [blade], "y", 2.9, [age, age + 7_000.0], known=KNOWN)
        assert ahead.passed[blade] == pytest.approx(own.passed[blade], abs=1e-12)
    same = rotor_life(growing(), state, two, "y", 2.9, [27_000.0], known=KNOWN)
    assert same.passed["b0"][0] == pytest.approx(ahead.passed["b0"][1], abs=1e-12)
    assert same.any[0] > ahead.any[1] + 0.05, "negative control: one hour of all"
    near = [0.0, 1e-12, 7_000.0]
    merged = rotor_life(growing(), state, two, "y", 2.9, near, known=KNOWN, ages=ages)
    assert merged.any == pytest.approx(ahead.any[[0, 0, 1]], abs=1e-12), "one hour at such ages"
    zero = rotor_life(growing(), state, two, "y", 2.9, [27_000.0], known=KNOWN, ages={})
    assert zero.any == same.any
    shrunk = growing(shrinks=True)
    late = rotor_life(shrunk, state, two, "y", 2.9, [1_000.0], known=KNOWN, ages={"b0": 48_000.0})
    before = rotor_life(shrunk, state, two, "y", 2.9, [49_000.0], known=KNOWN)
    assert late.passed["b0"] == pytest.approx(before.passed["b0"], abs=1e-12)
    with pytest.raises(RangeError, match="not all within"):
        rotor_life(growing(), state, two, "y", 2.9, [1e4], known=KNOWN, ages={"b1": 45_000.0})


def test_a_blade_s_own_known_inputs_are_its_own() -> None:
    state, two = even(np.array([0.1, 0.2])), BLADES[:2]
    wide = KNOWN | {"b1": {"size": 5.0}}
    one = rotor_life(growing(), state, two, "y", 2.9, [10_000.0], known=KNOWN)
    other = rotor_life(growing(), state, two, "y", 2.9, [10_000.0], known=wide)
    assert other.passed["b0"] == one.passed["b0"]
    assert [other.passed["b1"][0], other.any[0]] == pytest.approx([1.0, 1.0])
    with pytest.raises(InputError, match="size = None"):
        rotor_life(growing(), state, two, "y", 2.9, [10_000.0])


def test_a_blade_with_an_effect_of_its_own_has_its_own_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    state, two = even(np.array([0.1, 0.2])), BLADES[:2]
    one = rotor_life(growing(), state, two, "y", 2.9, [49_000.0], known=KNOWN)
    other = growing(shrinks=True)
    monkeypatch.setattr(Model, "for_blade", lambda own, b: other if b == "b1" else own)
    found = rotor_life(growing(), state, two, "y", 2.9, [49_000.0], known=KNOWN)
    assert found.passed["b0"] == one.passed["b0"]
    assert found.passed["b1"][0] < one.passed["b1"][0] - 0.1


def test_the_order_and_number_of_the_hours_do_not_matter(state: RotorState) -> None:
    whole = told(state, times=np.linspace(0.0, 50_000.0, 3 * SPAN))
    some = whole.time_h[[9, 200, 350]]
    few = told(state, times=[*some[::-1], some[0]])
    assert few.time_h.tolist() == some.tolist()
    for one, other in ((few.any, whole.any), (few.expected, whole.expected)):
        assert one == pytest.approx(other[[9, 200, 350]], abs=1e-9)


def test_ends_of_belief_and_a_rotor_without_blades(state: RotorState) -> None:
    never, at_once = told(state, limit=1e6), told(state, limit=-1.0)
    assert (never.any.tolist(), never.expected.tolist()) == ([0.0] * 3, [0.0] * 3)
    assert at_once.any == pytest.approx([1.0] * 3)
    assert at_once.expected == pytest.approx([8.0] * 3)
    nobody = told(state, blades=())
    assert (nobody.any.tolist(), nobody.expected.tolist(), nobody.passed) == ([0.0] * 3,) * 2 + (
        {},
    )
    no_weight = made(
        {"t1t_rate": np.full(2, 0.9), "sigma_obs.elongation": np.full(2, 0.02)},
        {n: np.ones((1, 2, 3)) for n in ("tbc_thickness", "creep_transient", "creep_steady")},
        np.zeros(2),
        np.array([[[-np.inf] * 3, [0.0] * 3]]),
    )
    one = told(no_weight, blades=BLADES[:1])
    assert one.any == pytest.approx(one.passed["b0"], abs=1e-12), "a node without a draw"


def test_what_cannot_be_is_refused(state: RotorState) -> None:
    with pytest.raises(InputError, match=r"limit = nan is no number"):
        told(state, limit=float("nan"))
    with pytest.raises(RangeError, match="60000"):
        told(state, times=[0.0, 6e4])
    with pytest.raises(InputError, match="choose x, y or z"):
        told(state, quantity="deformation")


def test_a_surrogate_s_error_is_each_blade_s_own(state: RotorState) -> None:
    """Of particles all alike: Φ of the margin, and blades then know nothing of each other."""
    alike = made(
        {"t1t_rate": np.full(4, 0.9), "sigma_obs.elongation": np.full(4, 0.02)},
        {n: np.ones((8, 4, 3)) for n in ("tbc_thickness", "creep_transient", "creep_steady")},
        np.zeros(4),
    )
    own = blade_posterior(alike.meta, alike.arrays.__getitem__, "b0")
    one = curves(MODEL, own, "elongation", np.array([40_000.0]))
    limit = float(one.mean[0, 0] + one.width[0, 0])
    found = told(alike, limit=limit, times=[40_000.0])
    assert found.any[0] == pytest.approx(1.0 - ndtr(1.0) ** 8, abs=1e-9)
