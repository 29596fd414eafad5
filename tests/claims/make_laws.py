"""What a law of creep can do at best on the measured curves: least squares, no priors, no noise.

    python -m tests.claims.make_laws

writes tests/claims/results/specimens/laws.json, and its table, laws.md. Each law has a rate r_i of
each specimen's own, x = r_i t, primary creep P (1 − exp(−x / e)), and the rest as in `LAWS`; all
but the rates is one for all specimens, unless the law says otherwise. No calibration of the same
law fits better than its least squares. A stress is held out altogether: the curves of the other
three are fitted, the rate at the stress goes by the straight line of ln r over ln stress.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import service.one_thread  # noqa: F401  before numpy, as every command does

# isort: split
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from core.builtin import creep_specimens as built
from tests.claims.make_specimens import OUT, STRESSES
from tests.claims.specimen_data import Specimen, specimens

Array = NDArray[np.float64]
MOST = 60.0  # largest exponent


@dataclass(frozen=True)
class Law:
    """A law of strain over x [%] with parameters p (d,), all logarithms; `own` differ by specimen.

    starts  where least squares begin, (s, d): the best end counts
    """

    what: str
    strain: Callable[[Array, Array], Array]
    starts: tuple[tuple[float, ...], ...]
    own: int | None = None


def _primary(x: Array, p: Array) -> Array:
    return np.asarray(np.exp(p[0]) * -np.expm1(-np.minimum(x / np.exp(p[1]), MOST)))


def _shipped(x: Array, p: Array) -> Array:
    """The law of `core.builtin.creep_specimens`, by its own code."""
    inputs = np.array([0.0, 0.0, *np.exp(p), built.STRESS0])
    return built.strain(inputs, x)


def _strain_power(x: Array, p: Array) -> Array:
    """d eps / dx = 1 + (c eps)^m of what is not primary, integrated on a grid even in ln eps."""
    c, m = np.exp(p[2]), np.exp(p[3])
    z = np.linspace(0.0, np.log1p(12.0 * c), 4000)
    eps = np.expm1(z) / c
    slope = np.exp(z) / c / (1.0 + (c * eps) ** m)
    at = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(z))])
    return np.asarray(_primary(x, p) + np.interp(x, at, eps))


def _void(x: Array, p: Array) -> Array:
    """Damage by time, d eps / dx = (1 − x / M)^−q, as Kachanov has it."""
    m, q = np.exp(p[2]), 1.0 + np.exp(p[3])
    left = np.maximum(1.0 - x / m, 1e-3)
    return np.asarray(_primary(x, p) + m / (q - 1.0) * (left ** (1.0 - q) - 1.0))


def _section(x: Array, p: Array) -> Array:
    """d eps / dx = exp(c eps)."""
    c = np.exp(p[2])
    return np.asarray(_primary(x, p) - np.log(np.maximum(1.0 - c * x, 1e-6)) / c)


def _time_power(x: Array, p: Array) -> Array:
    later = np.exp(p[2]) * np.minimum(x, 1e3) ** np.exp(p[3])
    return np.asarray(_primary(x, p) + x + later)


def _theta(x: Array, p: Array) -> Array:
    later = np.exp(p[2]) * np.expm1(np.minimum(x * np.exp(p[3]), MOST))
    return np.asarray(_primary(x, p) + x + later)


_LAW = ((-1.6, -3.0, -0.9), (0.0, -3.2, 4.0))
LAWS = {
    "shipped": Law("primary + (exp(c x) − 1) / c", _shipped, _LAW),
    "own amplitude": Law("the same, c of each specimen's own", _shipped, _LAW, 2),
    "own primary": Law("the same, P of each specimen's own", _shipped, _LAW, 0),
    "strain power": Law(
        "primary + d eps/dx = 1 + (c eps)^m", _strain_power, ((-1.6, -3.0, -0.9, 0.1),)
    ),
    "Kachanov": Law(
        "primary + d eps/dx = (1 − x/M)^−q",
        _void,
        ((-1.6, -3.0, 1.0, 0.3), (-0.5, -3.0, 0.0, 0.0), (-1.0, -3.0, 0.5, 1.0)),
    ),
    "theta": Law(
        "primary + x + B (exp(k x) − 1)",
        _theta,
        ((-1.6, -3.0, -1.0, 0.0), (0.0, -3.0, -4.0, 3.0)),
    ),
    "power": Law("primary + x + B x^m", _time_power, ((-1.6, -3.0, -1.0, 0.7),)),
    "exponential": Law("primary + d eps/dx = exp(c eps)", _section, ((-1.6, -3.0, -1.0),)),
}
# priors of the shipped law (P, e, c), wherever its parameters are fitted
BOUNDS = (np.log([0.01, 0.002, 0.01]), np.log([3.0, 1.0, 120.0]))


def fitted(law: Law, of: tuple[Specimen, ...]) -> tuple[Array, Array, list[Array]]:
    """Parameters of each specimen (n, d), their ln rates (n,), and what each misses [%]."""
    n, d = len(of), len(law.starts[0])

    def parts(v: Array) -> tuple[Array, Array]:
        p = np.tile(v[:d], (n, 1))
        if law.own is not None:
            p[:, law.own] = v[d + n :]
        return p, v[d : d + n]

    def off(v: Array) -> list[Array]:
        p, rate = parts(v)
        return [
            law.strain(np.exp(r) * one.time_h, q) - one.strain
            for q, r, one in zip(p, rate, of, strict=True)
        ]

    low, high = np.full(d, -30.0), np.full(d, 30.0)
    if law.strain is _shipped:
        low, high = BOUNDS
    best = None
    for start in law.starts:
        rates = [np.log(1.5 / one.time_h[-1]) for one in of]
        own = [] if law.own is None else [start[law.own]] * n
        bounds = [
            np.concatenate([b, np.full(n, r), np.full(len(own), b[law.own or 0])])
            for b, r in ((low, -30.0), (high, 10.0))
        ]
        found = least_squares(
            lambda v: np.concatenate(off(v)),
            np.concatenate([start, rates, own]),
            bounds=tuple(bounds),
            x_scale="jac",
            max_nfev=500,
        )
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return *parts(best.x), off(best.x)


def rms(parts: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def held_out(law: Law, every: tuple[Specimen, ...], stress: float) -> float:
    """Error at a stress of which nothing is known [%]; own parameters by their mean logarithm."""
    rest = tuple(one for one in every if one.stress != stress)
    p, rate, _ = fitted(law, rest)
    line = np.polyfit(np.log([one.stress / built.STRESS0 for one in rest]), rate, 1)
    at = float(np.exp(np.polyval(line, np.log(stress / built.STRESS0))))
    middle = p.mean(axis=0)
    return rms(
        [law.strain(at * one.time_h, middle) - one.strain for one in every if one.stress == stress]
    )


def made(name: str) -> dict[str, Any]:
    """Everything about one law."""
    law, every = LAWS[name], specimens()
    p, _, off = fitted(law, every)
    return {
        "law": law.what,
        "parameters": [float(f"{v:.3g}") for v in np.exp(p.mean(axis=0))],
        "fit": round(rms(off), 4),
        "by_stress": [
            round(rms([o for o, one in zip(off, every, strict=True) if one.stress == s]), 3)
            for s in STRESSES
        ],
        "new_stress": [round(held_out(law, every, s), 3) for s in STRESSES],
    }


def table(found: dict[str, Any]) -> str:
    lines = [
        "`python -m tests.claims.make_laws`: least squares of laws on all 1359 readings up to 8 %, "
        "a rate of each specimen's own. Root mean squares [% strain]; of stresses at 140 / 170 / "
        "200 / 230 MPa; a new stress gets its rate by a line of ln r over ln stress.\n\n",
        "| law | fit | by stress | new stress |\n",
        "| --- | --- | --- | --- |\n",
    ]
    for name, own in found.items():
        by, new = (
            " / ".join(f"{v:.2f}" if v < 100 else f"{v:.0f}" for v in own[which])
            for which in ("by_stress", "new_stress")
        )
        lines.append(f"| {name}: {own['law']} | {own['fit']:.4f} | {by} | {new} |\n")
    return "".join(lines)


if __name__ == "__main__":
    found = {name: made(name) for name in LAWS}
    (OUT / "laws.json").write_text(json.dumps(found, indent=1) + "\n")
    (OUT / "laws.md").write_text(table(found))
