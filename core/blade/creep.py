r"""The creep law at a material point.

q is von Mises' stress in MPa, T the temperature in K, t in hours, and alpha = `creep_transient`,
gamma = `creep_steady` are standard deviates.

    log10 t_r = (A - B log10 q) / T - C                       Larson-Miller rupture time
    r_s0 = C_MG / t_r(q, T),   r_s = r_s0 exp(s_gamma gamma) a(D)               secondary rate
    a(D) = (1 + c D) / (1 - D)^n                                                tertiary creep
    d eps_p/dt = max(P0 (q/100)^p exp(s_alpha alpha) - eps_p, 0) / tau          primary rate
    tau = c_tau / r_s0
    d eps_ij/dt = (3/2) (s_ij / q) (r_s + d eps_p/dt)                           Prandtl-Reuss
    CEEQ = eps_p + eps_s
    dD/dt = 1 / t_r(q_H, T)                                   Robinson's life fraction, uncapped
    q_H = q exp(b (J1 / S_s - 1)),  J1 = sigma_kk,  S_s = sqrt(sigma_ij sigma_ij)    Huddleston

(J1 is the sum and S_s² the sum of squares of the principal stresses.) In uniaxial tension q_H =
q. c and n are 0 unless `damage_acceleration` or `tertiary_exponent` says otherwise; D counts in
a(D) up to 1 and up to 0.95.

The state of a point is (eps_xx, eps_yy, eps_zz, 2eps_yz, 2eps_xz, 2eps_xy, eps_p, eps_s, D): nine
numbers, with engineering shear strains. Compiled, one point at a time; the loop over the points
and its cost are in :mod:`core.blade.kernels`.
"""

from __future__ import annotations

import math

import numpy as np

from core.blade.element import Array
from core.blade.properties import Creep
from core.compiled import compiled

STATE = 9
EPS_P, EPS_S, DAMAGE = 6, 7, 8


def coefficients(creep: Creep, creep_transient: float, creep_steady: float) -> Array:
    """The law's numbers for one pair (alpha, gamma), in the order that the kernels read."""
    return np.array(
        [
            creep.larson_miller_a,
            creep.larson_miller_b,
            creep.larson_miller_c,
            creep.monkman_grant,
            creep.primary_strain * math.exp(creep.transient_sd * creep_transient),
            creep.primary_exponent,
            creep.primary_scale,
            math.exp(creep.steady_sd * creep_steady),
            creep.huddleston,
            creep.tertiary_exponent,
            creep.damage_acceleration,
        ]
    )


@compiled
def _rupture_rate(law: Array, q: float, temperature: float) -> float:
    """1/t_r in 1/h."""
    exponent = law[2] - (law[0] - law[1] * math.log10(max(q, 1e-6))) / temperature
    return math.exp(math.log(10.0) * exponent)


@compiled
def _rates(
    law: Array, stress: Array, temperature: float, shear: float, state: Array, out: Array
) -> float:
    """Fill the nine rates of one point; return its decay rate 3 G dr/dq + 1/tau in 1/h."""
    mean = (stress[0] + stress[1] + stress[2]) / 3.0
    a, b, c = stress[0] - mean, stress[1] - mean, stress[2] - mean
    tangential = stress[3] ** 2 + stress[4] ** 2 + stress[5] ** 2
    q = math.sqrt(1.5 * (a * a + b * b + c * c) + 3.0 * tangential)
    if q < 1e-6:
        out[:] = 0.0
        return 0.0
    r0 = law[3] * _rupture_rate(law, q, temperature)
    secondary = r0 * law[7]
    if law[9] > 0.0:
        secondary *= (1.0 - min(state[8], 0.95)) ** (-law[9])
    if law[10] > 0.0:
        secondary *= 1.0 + law[10] * min(state[8], 1.0)
    target = law[4] * (q / 100.0) ** law[5]
    primary = max(target - state[6], 0.0) * r0 / law[6]
    flow = 1.5 * (secondary + primary) / q
    out[0], out[1], out[2] = flow * a, flow * b, flow * c
    out[3], out[4], out[5] = 2 * flow * stress[3], 2 * flow * stress[4], 2 * flow * stress[5]
    out[6], out[7] = primary, secondary
    total = math.sqrt(stress[0] ** 2 + stress[1] ** 2 + stress[2] ** 2 + 2.0 * tangential)
    out[8] = _rupture_rate(law, q * math.exp(law[8] * (3.0 * mean / total - 1.0)), temperature)
    slope = (secondary + primary) * law[1] / temperature / q
    decay = 0.0
    # a point within 0.1 % of saturation cannot leave it: max(…, 0) is its own limiter
    if target - state[6] > 1e-3 * target:
        slope += law[5] * target / q * r0 / law[6]
        decay = r0 / law[6]
    return float(3.0 * shear * slope + decay)


@compiled
def all_rates(
    law: Array, stress: Array, temperature: Array, shear: Array, state: Array, out: Array
) -> float:
    """The nine rates of every point into out; returns the fastest decay rate.

    In the same file as the law: numba's cache notices a change of its own file only.
    """
    fastest = 0.0
    for g in range(len(temperature)):
        decay = _rates(law, stress[g], temperature[g], shear[g], state[g], out[g])
        fastest = max(fastest, decay)
    return fastest


def rates(
    law: Array, stress: Array, temperature: float, shear: float, state: Array
) -> tuple[Array, float]:
    """The nine rates (1/h) of one point under stress (6,) MPa, and its decay rate (1/h).

    >>> law = coefficients(Creep(), 0.0, 0.0)
    >>> rate, _ = rates(law, np.array([0, 0, 330.0, 0, 0, 0]), 1143.15, 5e4, np.zeros(9))
    >>> round(1 / rate[8])  # hours to rupture; the table says 100
    92
    """
    out = np.zeros(STATE)
    decay = float(_rates(law, stress, temperature, shear, state, out))
    return out, decay
