"""Every reading predicted before it is used: against exact answers, and in many rotors."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.online import Workspace, update
from core.calibration.state import RotorSpec
from core.diagnosis.grammar import Facts
from core.diagnosis.residuals import predicted, residuals
from core.diagnosis.visits import MOST, Residual, visits_of
from core.errors import InputError
from core.observation import Inspection
from tests.core.calibration.test_exact import SLOPES, conjugate

MODEL, SIGMA, TIMES = conjugate(2), 0.15, (0.5, 1.0, 1.5)
BLADES = 6
SPEC = RotorSpec("r", tuple(f"b{b}" for b in range(BLADES)), particles=2000, seed=3)


def rotor(seed: int, off: float = 0.0) -> list[Inspection]:
    """Six blades drawn from the priors, read at three visits; the second one may be off."""
    rng = np.random.default_rng(seed)
    s, data = rng.normal(2.0, 0.5), []
    for b in range(BLADES):
        local = np.array([-1.0, 0.0]) + 0.6 * rng.normal(size=2)
        for k, t in enumerate(TIMES):
            y = 0.8 * s + sum(SLOPES[j] * t**j * local[j] for j in range(2)) + SIGMA * rng.normal()
            y += off * (k == 1)
            data.append(
                Inspection(
                    f"{b}-{k}", f"b{b}", "y", t, np.array([y]), sigma=SIGMA, campaign=f"c{k}"
                )
            )
    return data


def exactly(data: list[Inspection], before: list[Inspection], one: Inspection) -> tuple[float, ...]:
    """Mean and sd of a reading given others, by the formula of the joint normal."""
    every = [*before, one]
    design = np.zeros((len(every), 1 + 2 * BLADES))
    for row, r in enumerate(every):
        design[row, 0] = 0.8
        for j in range(2):
            design[row, 1 + 2 * int(r.blade[1:]) + j] = SLOPES[j] * r.time_h**j
    mean = design @ np.array([2.0, *([-1.0, 0.0] * BLADES)])
    own = np.diag([0.5, *([0.6, 0.6] * BLADES)]) ** 2
    joint = design @ own @ design.T + SIGMA**2 * np.eye(len(every))
    y = np.array([float(r.values[0]) for r in before])
    gain = joint[-1, :-1] @ np.linalg.inv(joint[:-1, :-1]) if before else np.zeros(0)
    variance = joint[-1, -1] - gain @ joint[:-1, -1]
    return float(mean[-1] + gain @ (y - mean[:-1])), float(np.sqrt(variance))


def found(data: list[Inspection], *, used: bool = False) -> list[Residual]:
    """The residuals; `used`: the mutant, which predicts from all readings, its own included."""
    if not used:
        return [r for visit in residuals(MODEL, SPEC, data, {}) for r in visit.residuals]
    state = update(MODEL, SPEC, data, workspace=Workspace())
    parts = [predicted(MODEL, SPEC, state, v, {}, k) for k, v in enumerate(visits_of(data, {}))]
    return [r for visit in parts for r in visit.residuals]


def test_mean_and_sd_are_those_of_the_joint_normal_given_the_visits_before() -> None:
    data = rotor(5)
    for visit in residuals(MODEL, SPEC, data, {}):
        for one in visit.residuals:
            before = [r for r in data if r.time_h < one.reading.time_h]
            mean, sd = exactly(data, before, one.reading)
            assert abs(one.mean - mean) < 0.12 * sd, one
            assert one.sd == pytest.approx(sd, rel=0.08)
            assert one.z == pytest.approx((one.y - mean) / sd, abs=0.25)


def test_the_covariance_of_a_visit_s_z_is_that_of_the_joint_normal() -> None:
    data = rotor(5)
    second = residuals(MODEL, SPEC, data, {})[1]
    before = [r for r in data if r.time_h < 1.0]
    one, two = (second.residuals[i].reading for i in (0, 1))
    (_, a), (m, b) = (exactly(data, before, r) for r in (one, two))
    moved, _ = exactly(data, [*before, one], two)
    slope = (moved - m) / (float(one.values[0]) - exactly(data, before, one)[0])
    assert second.covariance[0, 1] == pytest.approx(slope * a / b, abs=0.06)
    drawn = second.signal + second.noise * np.random.default_rng(1).standard_normal((2000, BLADES))
    assert np.abs(np.cov(drawn.T) - second.covariance).max() < 0.12


def uneven(per_rotor: list[list[float]]) -> list[float]:
    """How far PITs are from uniform, in standard errors counted by rotors; at 0.1 … 0.9."""
    shares = np.array([[np.mean(np.array(p) < q) for q in (0.1, 0.25, 0.5, 0.75, 0.9)]
                       for p in per_rotor])  # fmt: skip
    error = shares.std(axis=0, ddof=1) / np.sqrt(len(shares))
    return list(np.abs(shares.mean(axis=0) - [0.1, 0.25, 0.5, 0.75, 0.9]) / error)


ROTORS = range(100, 124)


def test_pits_of_clean_rotors_are_uniform_all_counted() -> None:
    pits = [[r.pit for r in found(rotor(seed))] for seed in ROTORS]
    assert {len(p) for p in pits} == {3 * BLADES}
    assert max(uneven(pits)) < 3.5


def test_readings_used_before_they_are_predicted_have_pits_that_are_not() -> None:
    """The mutant: its residuals are too small."""
    assert max(uneven([[r.pit for r in found(rotor(s), used=True)] for s in ROTORS])) > 5


def test_the_order_of_arrival_leaves_no_trace() -> None:
    data = rotor(7)
    told = [(r.reading.id, r.mean, r.sd, r.pit) for r in found(data)]
    assert [(r.reading.id, r.mean, r.sd, r.pit) for r in found(data[::-1])] == told


def test_a_blade_that_joined_later_is_predicted_with_those_of_its_day() -> None:
    old = [Inspection(f"o{h}", "old", "y", h, [0.0]) for h in (10.0, 20.0, 30.0)]
    new = Inspection("n", "new", "y", 5.0, [0.0])
    plain = visits_of([*old, new], {})
    by_day = visits_of([*old, new], {"new": Facts(offset_h=20.0)})
    assert [len(v) for v in plain] == [1, 1, 1, 1]
    assert [sorted(r.id for r in v) for v in by_day] == [["o10.0"], ["o20.0"], ["n"], ["o30.0"]]
    assert [sorted(r.id for r in v) for v in visits_of(
        [*old, new], {"new": Facts(offset_h=25.0)})][2] == ["n", "o30.0"]  # fmt: skip


def test_many_hours_are_joined_to_as_many_visits_as_are_borne() -> None:
    data = [Inspection(f"{k:03d}", "b", "y", float(k + 1), [0.0]) for k in range(100)]
    visits = visits_of(data, {})
    assert len(visits) == MOST
    assert [r.id for v in visits for r in v] == [r.id for r in data], "none is lost, none moves"
    assert max(map(len, visits)) <= 4 * min(map(len, visits))


def test_without_readings_there_is_nothing_to_predict() -> None:
    with pytest.raises(InputError, match="post inspections"):
        residuals(MODEL, SPEC, [], {})
