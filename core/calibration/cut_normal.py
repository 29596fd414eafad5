"""A normal distribution cut at an interval: its draws and their density, compiled.

At the quantile u of a normal N(c, s²) cut at [a, b],

    x = c + s Φ⁻¹(Φ(α) + u (Φ(β) − Φ(α))),   α = (a − c) / s,   β = (b − c) / s,
    log q(x) = −½ ((x − c) / s)² − log(s √(2π)) − log(Φ(β) − Φ(α)),

in the lower tail, where small probabilities are exact. Beyond `FAR` standard deviations the tail is
drawn as an exponential.
"""

from __future__ import annotations

import math

from core.compiled import compiled

FAR = 30.0  # standard deviations beyond which a normal's tail is drawn as an exponential


@compiled
def normal_quantile(p):  # type: ignore[no-untyped-def]
    """Inverse of the normal distribution function, to 1e-9 (P. J. Acklam's rational functions)."""
    if p < 0.02425 or p > 0.97575:
        tail = p if p < 0.5 else 1.0 - p
        q = math.sqrt(-2.0 * math.log(max(tail, 1e-300)))
        top = -7.784894002430293e-03 * q - 3.223964580411365e-01
        top = ((top * q - 2.400758277161838) * q - 2.549732539343734) * q + 4.374664141464968
        top = top * q + 2.938163982698783
        under = 7.784695709041462e-03 * q + 3.224671290700398e-01
        under = ((under * q + 2.445134137142996) * q + 3.754408661907416) * q + 1.0
        return top / under if p < 0.5 else -top / under
    q = p - 0.5
    r = q * q
    top = -3.969683028665376e01 * r + 2.209460984245205e02
    top = ((top * r - 2.759285104469687e02) * r + 1.383577518672690e02) * r
    top = (top - 3.066479806614716e01) * r + 2.506628277459239
    under = -5.447609879822406e01 * r + 1.615858368580409e02
    under = ((under * r - 1.556989798598866e02) * r + 6.680131188771972e01) * r
    under = (under - 1.328068155288572e01) * r + 1.0
    return top * q / under


@compiled
def cut_normal(centre, sd, low, high, u):  # type: ignore[no-untyped-def]
    """Draw of a normal cut at [low, high], at the quantile u, and its log density."""
    a, b, sign = (low - centre) / sd, (high - centre) / sd, 1.0
    if a + b > 0.0:  # work in the lower tail, where small probabilities are exact
        a, b, sign, u = -b, -a, -1.0, 1.0 - u
    if b < -FAR:
        rate = -b
        left = math.exp(-rate * (b - a)) if rate * (b - a) < 700.0 else 0.0
        drop = math.log(max(left + u * (1.0 - left), 1e-300))
        z = b + drop / rate
        log_q = math.log(rate) + drop - math.log1p(-left)
    else:
        below = 0.5 * math.erfc(-a / math.sqrt(2.0))
        mass = 0.5 * math.erfc(-b / math.sqrt(2.0)) - below
        z = min(max(normal_quantile(below + u * mass), a), b)
        log_q = -0.5 * z * z - 0.5 * math.log(2.0 * math.pi) - math.log(mass)
    x = centre + sd * sign * z
    return min(max(x, low), high), log_q - math.log(sd)
