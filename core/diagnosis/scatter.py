"""How far blades scatter about a common effect, beyond what the noise allows.

With c_b and I_b blade b's shares of an effect's score and information, and a = U / I its amplitude,

    phi = Σ (c_b − a I_b)² / (Σ I_b − Σ I_b² / Σ I_b)

is one where noise alone scatters the blades that the effect concerns; (Σ I_b)² / Σ I_b² of them
count, for three hot blades may know more than all others. Above one it discounts
score and information alike (a quasi-likelihood: Wedderburn, Biometrika 61, 1974).

Cells of too few blades for a phi of their own have the typical one of the others. What parameters
imitate is none of these: of next to no information phi tells what second order leaves out, not how
blades scatter (of blades read once it was 57, and every sound rotor of these alarmed).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST_BLADES = 8  # from which phi is a cell's own
TOLD = 0.1  # information of an expected size below which a cell's phi sets no example


@dataclass(frozen=True, slots=True)
class Scatter:
    """What of phi does not go with the scores; C cells, B blades.

    seen      1 where a cell concerns a blade, else 0, (B, C); own: information there, else 0
    expected  Σ I_b − Σ I_b² / Σ I_b, (C,)
    many      cells of blades enough; typical: those of them that set an example to the others
    """

    seen: Array
    own: Array
    expected: Array
    many: NDArray[np.bool_]
    typical: NDArray[np.bool_]

    @staticmethod
    def of(
        own: Array,
        concerned: NDArray[np.bool_],
        alone: NDArray[np.bool_],
        least: int = LEAST_BLADES,
    ) -> Scatter:
        """From informations own (B, C); cells `alone` (C,) are of one blade.

        least  blades from which phi is a cell's own
        """
        seen = concerned & (own > 1e-12)
        held = np.where(seen, own, 0.0)
        whole, square = held.sum(axis=0), np.sum(held**2, axis=0)
        count = whole**2 / np.maximum(square, 1e-300)
        expected = np.where(seen.sum(axis=0) > 1, whole - square / np.maximum(whole, 1e-300), whole)
        if least < LEAST_BLADES:  # of few blades each counts
            count = seen.sum(axis=0).astype(float)
        many = np.asarray(count >= least)
        typical = many & ~alone & (whole >= TOLD)
        return Scatter(seen.astype(float), held, expected, many, typical)

    def phi(self, c: Array, u: Array, information: Array) -> Array:
        """phi ≥ 1 of each cell (C,) from contributions c (B, C), scores and informations (C,).

        >>> c = np.array([[3.0], [-3.0]] * 5)
        >>> one = Scatter.of(np.ones((10, 1)), np.ones((10, 1), bool), np.zeros(1, bool))
        >>> one.phi(c, c.sum(axis=0), np.array([10.0])).tolist()
        [10.0]
        """
        off = c * self.seen - (u / np.maximum(information, 1e-300)) * self.own
        excess = np.einsum("bc,bc->c", off, off)
        phi = np.maximum(1.0, excess / np.maximum(self.expected, 1e-300))
        typical = float(np.median(phi[self.typical])) if np.any(self.typical) else 1.0
        return np.asarray(np.where(self.many, phi, np.maximum(typical, 1.0)))
