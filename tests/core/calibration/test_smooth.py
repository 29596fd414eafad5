"""Columns computed at some of the shared nodes and known at the rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from core.calibration.columns import KeptColumns, columns, smooth_columns
from core.calibration.message import BladeMessage
from core.calibration.smooth import (
    NEARLY,
    TOLERANCE,
    Asked,
    Column,
    from_afar,
    stages,
    together,
)
from core.calibration.space import shared_space
from core.calibration.target import assemble
from core.model import rotor_blade
from core.observation import Inspection
from core.smc.placement import sobol
from core.smc.proposal import Proposal
from core.validation.simulate import simulate
from core.validation.variants import plan

Array = NDArray[np.float64]


def smoothly(
    compute: Callable[[Sequence[int], Array], Sequence[Array]],
    begun: Sequence[Column | None],
    unit: Array,
    tolerance: float = TOLERANCE,
    seen: Sequence[int] | None = None,
) -> list[Column]:
    """The columns of one kind of blades, from a function that computes them."""

    def each(asked: list[Asked]) -> list[Sequence[Array]]:
        return [compute(due, nodes) for _, due, nodes in asked]

    return together([stages(begun, unit, tolerance, seen)], each)[0]


def gentle(scale: float, u: Array) -> Array:
    """About what a blade of a large rotor says: a bell much wider than the nodes' region."""
    z = scale * (u - 0.45)
    return np.asarray(-0.5 * np.sum(z**2, axis=1) + 0.3 * np.tanh(z[:, 0]) - 4.0)


def jagged(u: Array) -> Array:
    return np.asarray(0.05 * np.sin(900.0 * u[:, 0]))


def asked(functions: Sequence[object], unit: Array) -> tuple[list[Array], list[int]]:
    """Columns of functions, and at how many nodes each was computed."""
    counts = [0] * len(functions)

    def compute(which: Sequence[int], nodes: Array) -> list[Array]:
        for i in which:
            counts[i] += len(nodes)
        return [functions[i](nodes) for i in which]  # type: ignore[operator]

    found = smoothly(compute, [None] * len(functions), unit)
    return [column.values for column in found], counts


@pytest.mark.parametrize("d", [1, 2, 4])
def test_a_smooth_column_is_computed_at_a_part_of_the_nodes(d: int) -> None:
    unit = 0.5 + 0.1 * (sobol(128, d, 3) - 0.5)
    scales = np.linspace(2.0, 12.0, 9)
    found, counts = asked([lambda u, s=s: gentle(s, u) for s in scales], unit)
    assert max(counts) <= 48
    for scale, column in zip(scales, found, strict=True):
        off = column - gentle(scale, unit)
        assert np.sqrt(np.mean(off**2)) < TOLERANCE / 3
        assert np.abs(off).max() < 2 * TOLERANCE


def test_a_column_that_is_not_smooth_is_computed_everywhere() -> None:
    unit = sobol(64, 2, 3)
    (column,), counts = asked([jagged], unit)
    assert counts == [64]
    assert column.tolist() == jagged(unit).tolist()


def test_a_column_that_is_not_finite_is_computed_everywhere() -> None:
    unit = sobol(64, 2, 3)

    def cut(u: Array) -> Array:
        return np.where(u[:, 0] < 0.3, -np.inf, gentle(1.0, u))

    (column,), counts = asked([cut], unit)
    assert counts == [64]
    assert column.tolist() == cut(unit).tolist()


def test_a_column_does_not_depend_on_its_company() -> None:
    unit = 0.5 + 0.1 * (sobol(64, 2, 3) - 0.5)
    functions = [jagged, *(lambda u, s=s: gentle(s, u) for s in (2.0, 7.0, 11.0))]
    together, _ = asked(functions, unit)
    for function, column in zip(functions, together, strict=True):
        (alone,), _ = asked([function], unit)
        assert alone.tobytes() == column.tobytes()


def test_a_column_that_was_nearly_known_goes_on_from_there() -> None:
    unit = 0.5 + 0.5 * (sobol(64, 2, 3) - 0.5)
    nodes: list[int] = []

    def compute(which: Sequence[int], at: Array) -> list[Array]:
        nodes.append(len(at))
        return [gentle(12.0, at) for _ in which]

    (near,) = smoothly(compute, [None], unit, NEARLY)
    assert near.computed < 64
    assert TOLERANCE < near.error < NEARLY
    (then,) = smoothly(compute, [near], unit)
    assert sum(nodes) == then.computed
    (at_once,) = smoothly(compute, [None], unit)
    assert at_once.values.tobytes() == then.values.tobytes()
    assert smoothly(compute, [at_once], unit, NEARLY) == [at_once]


def test_points_come_from_afar() -> None:
    z = np.random.default_rng(0).standard_normal((64, 2))
    order = from_afar(z)
    assert sorted(order.tolist()) == list(range(64))
    outermost = np.argsort(np.sum(z**2, axis=1))[-3:]
    assert set(outermost.tolist()) <= set(order[:16].tolist())


def test_a_column_goes_from_node_to_node_by_what_it_depends_on() -> None:
    """Of six coordinates two: 16 of 128 nodes are computed; by all six none could be left out."""
    unit = sobol(128, 6, 1)

    def compute(which: Sequence[int], nodes: np.ndarray) -> list[np.ndarray]:
        return [np.exp(0.3 * nodes[:, 1]) * np.cos(0.5 * nodes[:, 4]) for _ in which]

    (exact,) = compute([0], unit)
    (seen,) = smoothly(compute, [None], unit, seen=(1, 4))
    (blind,) = smoothly(compute, [None], unit)
    assert (seen.computed, np.abs(seen.values - exact).max() < TOLERANCE) == (16, True)
    assert blind.computed > 32
    (wrong,) = smoothly(compute, [None], unit, seen=(1, 2))
    assert wrong.computed == 128, "a coordinate that is missing is noticed, and all are computed"


def test_a_blade_sees_the_noises_of_its_own_readings() -> None:
    """Elongations alone: not the scans' noise nor that of CEEQ; messages as with all parameters."""
    variant, model = plan("mixed", 5), rotor_blade()
    made = simulate(model, variant, 0, 5)
    by_blade: dict[str, list[Inspection]] = {}
    for reading in made.readings:
        by_blade.setdefault(reading.blade, []).append(reading)
    rows = {b: one for b, own in by_blade.items() if (one := assemble(model, own)) is not None}
    space = shared_space(model, rows.values())
    seen = {b: [space.names[j] for j in BladeMessage(model, r, space, {}).seen]
            for b, r in rows.items()}  # fmt: skip
    assert seen["B001"] == ["t1t_rate", "sigma_obs.elongation", "sigma_obs.deformation"]
    assert seen["B002"] == ["t1t_rate", "sigma_obs.elongation"]
    assert any("sigma_obs.ceeq" in names for names in seen.values())
    assert [space.names[j] for j in space.heavy] == ["sigma_obs.elongation", "sigma_obs.ceeq"]
    message = BladeMessage(model, rows["B002"], space, {})
    unit = np.tile(sobol(4, space.dim, 0)[:1], (4, 1))
    unit[:, 2:] = sobol(4, space.dim, 0)[:, 2:]
    assert np.ptp(message.column(unit)) == 0.0


def of_a_rotor(wide: float = 1.0) -> tuple[list[BladeMessage], Array]:
    """The messages of twenty built-in blades, and 64 nodes about the truth."""
    variant, model = plan("rotor-20", 20), rotor_blade()
    made = simulate(model, variant, 0, 5)
    by_blade: dict[str, list[object]] = {}
    for reading in made.readings:
        by_blade.setdefault(reading.blade, []).append(reading)
    rows = [assemble(model, readings) for readings in by_blade.values()]  # type: ignore[arg-type]
    space = shared_space(model, [r for r in rows if r is not None])
    messages = [BladeMessage(model, r, space, {}) for r in rows if r is not None]
    low, high = np.array([p.box for p in space.priors]).T
    truth = np.array([made.shared[name] for name in space.names])
    scaled = [p.log_scale for p in space.priors]
    centre = (np.where(scaled, np.log(truth), truth) - low) / (high - low)
    unit, _ = Proposal(centre, wide * np.diag([0.01, 0.02])).nodes(sobol(64, 2, 0))
    return messages, unit


def test_the_blades_of_a_rotor_are_known_between_the_nodes() -> None:
    """The built-in blade: what is not computed is off by less than the quadrature itself."""
    messages, unit = of_a_rotor()
    exact = np.array(columns(messages, unit, rough=False))
    found = np.array([column.values for column in smooth_columns(messages, unit)])
    off = found - exact
    assert np.mean(off != 0.0) > 0.25, "less than a quarter was known without being computed"
    assert np.sqrt(np.mean(off**2)) < 0.001
    assert np.abs(off).max() < 0.02
    assert np.abs(off.sum(axis=0)).max() < 0.03


def test_a_near_column_does_not_depend_on_what_was_known_before() -> None:
    """By near columns is decided where nodes stand: a process that knows the exact ones already
    has to decide alike."""
    messages, unit = of_a_rotor(4.0)
    named = {str(i): m for i, m in enumerate(messages)}
    cold, warm = KeptColumns(), KeptColumns()
    first = cold.all(named, unit, "near")
    exact = warm.all(named, unit, "exact")
    computed = warm.computed
    again = warm.all(named, unit, "near")
    assert warm.computed == computed, "nothing is computed for it"
    assert all(np.array_equal(first[b], again[b]) for b in named)
    assert not all(np.array_equal(exact[b], again[b]) for b in named), "control: they differ"
    later = cold.all(named, unit, "exact")
    assert all(np.array_equal(exact[b], later[b]) for b in named)
