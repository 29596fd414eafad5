"""Each reading as the model predicts it from all the others.

A residual of a reading that took part in the fit is too small: the fit went where the reading is.
Without calibrating once more for each, the reading is left out by the identity of the normal
distribution. With all readings ~ N(m, C), K = C⁻¹ and q = C⁻¹ (y − m), the readings of a set R,
given every other, are normal with

    y_R − E[y_R | others] = K_RR⁻¹ q_R,       Cov[y_R | others] = K_RR⁻¹

Both are known from the particles (`core.diagnosis.scores`): q_b is their mean of V⁻¹(y − f), exact
however skew the posterior is, and K_bb = Q_b − D_b D_bᵀ, in which blade b's own parameters and the
shared ones are integrated out, to first order in the sensitivities. C holds the noise, so the
standard deviation is a reading's, and z = q_i / √K_ii is standard normal where the model is right.

These z are correlated a little (they share the parameters); they are for looking at. The verdict
rests on the scan, whose null knows of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.scores import Scores
from core.observation import Inspection

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LeftOut:
    """Readings of one value, each as predicted by all others.

    readings  (R,), in the order of blades and rows
    mean, sd  of the reading before it was known [its unit], (R,); z = (y − mean) / sd
    skipped   readings of several values (scans), which are not in it
    """

    readings: tuple[Inspection, ...]
    mean: Array
    sd: Array
    skipped: int

    @property
    def z(self) -> Array:
        """(y − mean) / sd, (R,)."""
        y = np.array([float(r.values[0]) for r in self.readings])
        return np.asarray((y - self.mean) / self.sd)


def left_out(seen: Scores) -> LeftOut:
    """Every reading that is one row, without itself."""
    k = np.einsum("bii->bi", seen.information) - np.sum(seen.deviation**2, axis=2)
    found: list[tuple[Inspection, float, float]] = []
    skipped: set[str] = set()
    for b, i in np.argwhere(seen.real):
        reading = seen.reading(b, i)
        if reading.values.size > 1:
            skipped.add(reading.id)
            continue
        y, precision = float(reading.values[0]), float(k[b, i])
        if precision > 0 and np.isfinite(precision):
            off = float(seen.q[b, i]) / precision
            found.append((reading, y - off, precision**-0.5))
    return LeftOut(
        tuple(r for r, _, _ in found),
        np.array([m for _, m, _ in found]),
        np.array([s for _, _, s in found]),
        len(skipped),
    )
