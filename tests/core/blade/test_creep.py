from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.blade.creep import DAMAGE, EPS_P, EPS_S, coefficients, rates
from core.blade.integrate import Tolerance, advance
from core.blade.properties import Creep

LAW = coefficients(Creep(), 0.0, 0.0)
T = 1143.15
PULL = np.array([0.0, 0.0, 150.0, 0.0, 0.0, 0.0])


def rupture_hours(q: float, temperature: float) -> float:
    return 10 ** ((41566.8 - 6536.04 * math.log10(q)) / temperature - 20)


def rate(stress: np.ndarray, law: np.ndarray = LAW, state: np.ndarray | None = None) -> np.ndarray:
    return rates(law, stress, T, 5e4, np.zeros(9) if state is None else state)[0]


@pytest.mark.parametrize(
    ("celsius", "mpa", "hours"),
    [(815, 470, 100), (815, 345, 1000), (870, 330, 100), (870, 235, 1000), (980, 130, 100)],
)
def test_rupture_times_are_within_a_factor_of_1_6_of_the_table(
    celsius: float, mpa: float, hours: float
) -> None:
    damage = rates(LAW, np.array([mpa, 0.0, 0, 0, 0, 0]), celsius + 273.15, 5e4, np.zeros(9))[0][8]
    assert 1 / damage == pytest.approx(rupture_hours(mpa, celsius + 273.15), rel=1e-12)
    assert 1 / 1.6 < 1 / damage / hours < 1.6


def test_secondary_rate_times_rupture_time_is_the_monkman_grant_strain() -> None:
    assert rate(PULL)[EPS_S] * rupture_hours(150.0, T) == pytest.approx(0.02, rel=1e-12)


def test_a_deviate_of_gamma_scales_the_secondary_rate_and_leaves_primary_and_damage() -> None:
    shifted = rate(PULL, coefficients(Creep(), 0.0, 2.0))[6:] / rate(PULL)[6:]
    assert shifted == pytest.approx([1.0, math.exp(0.7), 1.0])


def test_a_deviate_of_alpha_scales_the_saturated_primary_strain() -> None:
    target = 1e-3 * 1.5**2 * math.exp(0.35 * -1.5)
    law = coefficients(Creep(), -1.5, 0.0)
    almost, over = np.zeros(9), np.zeros(9)
    almost[EPS_P], over[EPS_P] = 0.999 * target, 1.001 * target
    tau = 2e-4 / (0.02 / rupture_hours(150.0, T))
    assert rate(PULL, law, almost)[EPS_P] == pytest.approx(1e-3 * target / tau, rel=1e-9)
    assert rate(PULL, law, over)[EPS_P] == 0.0


def test_creep_keeps_the_volume_and_flows_along_the_deviator() -> None:
    stress = np.array([80.0, -30.0, 120.0, 15.0, -20.0, 40.0])
    out = rate(stress)
    assert out[:3].sum() == pytest.approx(0.0, abs=1e-12 * abs(out[2]))
    deviator = np.concatenate([stress[:3] - stress[:3].mean(), 2 * stress[3:]])
    assert out[:6] / deviator == pytest.approx(np.full(6, out[0] / deviator[0]))


def test_work_of_the_creep_rate_is_mises_stress_times_equivalent_rate() -> None:
    stress = np.array([80.0, -30.0, 120.0, 15.0, -20.0, 40.0])
    d = stress[:3] - stress[:3].mean()
    q = math.sqrt(1.5 * (d @ d) + 3 * (stress[3:] @ stress[3:]))
    out = rate(stress)
    assert stress @ out[:6] == pytest.approx(q * (out[EPS_P] + out[EPS_S]), rel=1e-12)


def test_huddleston_spares_compression_and_punishes_triaxial_tension() -> None:
    tension, compression = rate(PULL)[DAMAGE], rate(-PULL)[DAMAGE]
    assert tension == pytest.approx(1 / rupture_hours(150.0, T))
    assert compression == pytest.approx(1 / rupture_hours(150.0 * math.exp(-0.48), T), rel=1e-12)
    triaxial = rate(PULL + np.array([100.0, 100, 100, 0, 0, 0]))[DAMAGE]
    assert triaxial > 1.5 * tension


def test_damage_accelerates_secondary_creep_only_with_a_tertiary_exponent() -> None:
    worn = np.zeros(9)
    worn[DAMAGE] = 0.5
    assert rate(PULL, state=worn)[EPS_S] == rate(PULL)[EPS_S]
    coupled = coefficients(replace(Creep(), tertiary_exponent=3.0), 0.0, 0.0)
    assert rate(PULL, coupled, worn)[EPS_S] == pytest.approx(8 * rate(PULL)[EPS_S])


@pytest.mark.parametrize("c", [0.0, 1.5, 4.0])
def test_creep_under_constant_stress_accelerates_with_the_square_of_time(c: float) -> None:
    """D = t / t_r, so eps_s = r (t + c t² / 2 t_r) up to rupture, then the rate stays."""
    law = coefficients(replace(Creep(), damage_acceleration=c), 0.0, 0.0)
    r, t_r = rate(PULL)[EPS_S], 1.0 / rate(PULL)[DAMAGE]

    def rates_of(state: np.ndarray) -> tuple[np.ndarray, float]:
        out, decay = rates(law, PULL, T, 5e4, state[0])
        return out[None], decay

    instants = np.array([0.0, 0.25, 0.5, 1.0, 2.0]) * t_r
    tight = Tolerance(relative=1e-6, absolute=1e-12)
    found = [s[0, EPS_S] for s in advance(rates_of, np.zeros((1, 9)), instants, tight)]
    d = instants / t_r
    exact = r * t_r * np.where(d <= 1, d + c * d**2 / 2, 1 + c / 2 + (1 + c) * (d - 1))
    assert np.array(found) == pytest.approx(exact, rel=1e-4, abs=1e-15)


def test_a_point_without_stress_does_not_creep() -> None:
    out, decay = rates(LAW, np.zeros(6), T, 5e4, np.zeros(9))
    assert not out.any()
    assert decay == 0.0


def test_the_decay_rate_is_three_shear_moduli_times_the_slope_of_the_rate() -> None:
    state = np.zeros(9)
    state[EPS_P] = 1.0  # beyond saturation: secondary creep alone
    decay = rates(LAW, PULL, T, 5e4, state)[1]
    h = 1e-3
    up, down = (rate(PULL + np.array([0, 0, d, 0, 0, 0]), state=state) for d in (h, -h))
    slope = (up[EPS_S] - down[EPS_S]) / (2 * h)
    assert decay == pytest.approx(3 * 5e4 * slope, rel=1e-6)
