"""Our posterior against a reference: means, spreads, correlations.

For every blade the joint of its local parameters, the shared ones and its predicted elongation at
one later hour is compared, by

    (mean − mean_ref) / sd_ref,   sd / sd_ref,   correlation − correlation_ref.

Accepted are 0.1, 0.95 … 1.05 and 0.05, for every blade and every pair; none is averaged away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from core.calibration.responses import DEGREE
from core.calibration.state import Posterior, RotorSpec, RotorState, blade_posterior
from core.curves import inputs_of
from core.errors import InputError
from core.model import Model

Array = NDArray[np.float64]
MEAN, SPREAD, CORRELATION, EVIDENCE = 0.1, 0.05, 0.05, 0.1
AT_H = 32_000.0
PREDICTED = "elongation"


@dataclass(frozen=True)
class Moments:
    """Of each blade's joint (local, shared, predicted elongation [mm]).

    mean, sd (B, P), correlation (B, P, P)
    """

    names: tuple[str, ...]
    blades: tuple[str, ...]
    mean: Array
    sd: Array
    correlation: Array

    @staticmethod
    def of(model: Model, rotor: RotorSpec, found: Mapping[str, Posterior]) -> Moments:
        """Moments of each blade's weighted joint particles."""
        joint = {b: with_prediction(model, found[b]) for b in rotor.blades}
        rows = [_moments(psi, found[b].particles.w) for b, psi in joint.items()]
        mean, sd, correlation = (np.array(part) for part in zip(*rows, strict=True))
        names = (*found[rotor.blades[0]].names, PREDICTED)
        return Moments(names, rotor.blades, mean, sd, correlation)

    @staticmethod
    def of_state(model: Model, rotor: RotorSpec, state: RotorState) -> Moments:
        """Moments of one of our states."""
        return Moments.of(model, rotor, posteriors(rotor, state))


def posteriors(rotor: RotorSpec, state: RotorState) -> dict[str, Posterior]:
    """Each blade's joint posterior in one of our states."""
    get = state.arrays.__getitem__
    return {blade: blade_posterior(state.meta, get, blade) for blade in rotor.blades}


def with_prediction(model: Model, posterior: Posterior) -> Array:
    """Particles (N, P) with the model's elongation at AT_H [mm] as the last column."""
    response = model.part(PREDICTED).response(PREDICTED, np.array([AT_H]), None, degree=DEGREE)
    y = response.evaluate(inputs_of(model, posterior, PREDICTED))[0]
    return np.concatenate([posterior.particles.psi, y], axis=1)


def _moments(psi: Array, w: Array) -> tuple[Array, Array, Array]:
    mean = w @ psi
    d = psi - mean
    cov = (d * w[:, None]).T @ d
    sd = np.sqrt(np.diag(cov))
    return mean, sd, cov / np.outer(sd, sd)


@dataclass(frozen=True)
class Comparison:
    """Differences per blade and column: mean and ratio (B, P), correlation (B, P, P)."""

    names: tuple[str, ...]
    blades: tuple[str, ...]
    mean: Array
    ratio: Array
    correlation: Array

    @staticmethod
    def of(found: Moments, reference: Moments) -> Comparison:
        """Raises InputError where the two do not speak of the same parameters and blades."""
        if found.names != reference.names or found.blades != reference.blades:
            raise InputError(
                "reference", reference.names, f"does not fit {found.names}", "make it anew"
            )
        return Comparison(
            found.names,
            found.blades,
            (found.mean - reference.mean) / reference.sd,
            found.sd / reference.sd,
            found.correlation - reference.correlation,
        )

    def beyond(self) -> dict[str, list[str]]:
        """What lies outside the acceptance, or is no number."""
        found: dict[str, list[str]] = {"mean": [], "ratio": [], "correlation": []}
        for b, blade in enumerate(self.blades):
            for j, name in enumerate(self.names):
                if not abs(self.mean[b, j]) <= MEAN:
                    found["mean"].append(f"{blade} {name} {self.mean[b, j]:+.3f}")
                if not abs(self.ratio[b, j] - 1) <= SPREAD:
                    found["ratio"].append(f"{blade} {name} {self.ratio[b, j]:.3f}")
            for i, j in combinations(range(len(self.names)), 2):
                if not abs(self.correlation[b, i, j]) <= CORRELATION:
                    names = f"{self.names[i]}~{self.names[j]}"
                    found["correlation"].append(f"{blade} {names} {self.correlation[b, i, j]:+.3f}")
        return found

    def table(self) -> dict[str, dict[str, float]]:
        """The worst over all blades, by column."""
        return {
            name: {
                "mean": round(float(np.abs(self.mean[:, j]).max()), 4),
                "ratio_low": round(float(self.ratio[:, j].min()), 4),
                "ratio_high": round(float(self.ratio[:, j].max()), 4),
                "correlation": round(float(np.abs(self.correlation[:, j]).max()), 4),
            }
            for j, name in enumerate(self.names)
        }
