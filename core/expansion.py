"""Karhunen–Loève modes of a discrepancy's Gaussian process over a model's hours.

The theory is in `core.discrepancy`; here is what a declaration and a number of hours make of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.quantity import LEAST_GAIN, WIDTH, Quantity

Array = NDArray[np.float64]
HELD, MOST_MODES, NODES = 0.995, 6, 96


@dataclass(frozen=True, slots=True)
class Modes:
    """Karhunen–Loève modes of a unit-variance process on [0, 1], at quadrature nodes (NODES,).

    weight (NODES,); value (NODES, k) holds phi_k, eigenvalue (k,) lambda_k, largest first.
    """

    length: float
    node: Array
    weight: Array
    value: Array
    eigenvalue: Array

    def at(self, t: Array) -> Array:
        """sqrt(lambda_k) phi_k at t (n,): (n, k)."""
        kernel = np.exp(-0.5 * ((t[:, None] - self.node) / self.length) ** 2)
        return np.asarray((kernel * self.weight) @ self.value / np.sqrt(self.eigenvalue))


@lru_cache(maxsize=64)
def modes(length: float) -> Modes:
    """Modes of a process with this length, as a share of the horizon, that hold `HELD`.

    >>> len(modes(0.5).eigenvalue), len(modes(2.0).eigenvalue)
    (4, 2)
    """
    x, w = np.polynomial.legendre.leggauss(NODES)
    node, weight = 0.5 * (x + 1), 0.5 * w
    root = np.sqrt(weight)
    kernel = np.exp(-0.5 * ((node[:, None] - node) / length) ** 2)
    values, vectors = np.linalg.eigh(root[:, None] * kernel * root)
    values, vectors = values[::-1], vectors[:, ::-1]
    phi = vectors / root[:, None]
    held = np.cumsum(values * phi**2, axis=1).min(axis=0)
    count = int(np.argmax(held >= HELD)) + 1
    phi = phi[:, :count] * np.where(
        phi[-1, :count] < 0, -1.0, 1.0
    )  # on every machine the same sign
    return Modes(length, node, weight, phi, values[:count])


def modes_over(quantity: Quantity, horizon_h: float) -> Modes:
    """Those of a ``gp`` over 0 … horizon_h; InputError where they are too many, or let the gain
    fall too far."""
    declared = quantity.discrepancy
    assert declared.length_h is not None
    assert declared.sd is not None
    # anything shorter needs every mode as well
    found = modes(max(declared.length_h / horizon_h, 1.0 / NODES**2))
    if len(found.eigenvalue) > MOST_MODES:
        raise InputError(
            f"discrepancy length_h of {quantity.name}",
            declared.length_h,
            f"needs {len(found.eigenvalue)} modes up to {horizon_h:g} h, more than {MOST_MODES}",
            "give a longer one",
        )
    reach = WIDTH * declared.sd * np.abs(found.at(np.linspace(0, 1, 101))).sum(axis=1).max()
    if 1 - reach < LEAST_GAIN:
        raise InputError(
            f"discrepancy sd of {quantity.name}",
            declared.sd,
            f"lets 1 + f fall to {1 - reach:.3g}, below {LEAST_GAIN}",
            "give a smaller one",
        )
    return found
