"""The posterior of a network as the prior of another, from a stored state alone.

Where a lower network's readings are at hand, its messages are (`core.calibration.levels`): nothing
is approximated. Where only its state is kept, its nodes still hold the log density of the shared
parameters, exactly, at K places u_k of the unit box. A surface through them
(`core.calibration.surface`) lives in the box; what it may be off is known beforehand, `error_nat`.
Parameters that are not passed on are integrated out at each place by points of their conditional
normal, weighted exactly.

A state's weighted nodes say nothing of a blade's own parameters here: a blade that has readings in
the stored state must not have further ones above it, nor the same ones again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.space import shared_prior
from core.calibration.state import RotorState
from core.calibration.surface import Surface
from core.errors import InputError
from core.model import Model
from core.prior import Prior
from core.smc.particles import normalised
from core.smc.placement import moments, sobol
from core.smc.proposal import WIDEN, Proposal

Array = NDArray[np.float64]
INNER = 64  # points at which parameters that are not passed on are integrated out


@dataclass(frozen=True)
class StoredPosterior:
    """A joint prior of shared parameters: the posterior that a sealed state holds.

    names      parameters passed on
    priors     their priors in the network below, whose bounds hold on
    error_nat  leave-one-out error of the log density [nat]
    seen       readings that it rests on: {rotor: {blade: digest}}
    """

    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    error_nat: float
    seen: Mapping[str, Mapping[str, str]]
    source: str
    below: tuple[str, ...]
    surface: Surface
    log_evidence: float
    moments: tuple[Array, Array]

    @staticmethod
    def of(model: Model, state: RotorState, names: Sequence[str] | None = None) -> StoredPosterior:
        """The posterior of `names` (default: all shared parameters) in a state of `model`.

        Raises InputError for a state that is not sealed, that too few nodes carry or that is of
        another model, and for an unknown name.
        """
        meta, arrays = state.meta, state.arrays
        if not state.sealed:
            raise InputError("state", "provisional", "is not sealed", "wait for the sealed one")
        if not meta["health"]["met_floor"]:
            raise InputError(
                "state",
                "; ".join(meta["health"]["reasons"]),
                "is no posterior to go on from",
                "declare narrower priors, or give it more readings",
            )
        if meta["model"] != model.digest:
            raise InputError("model", model.version, "did not make this state", "give its own")
        below = tuple(meta["shared"])
        passed = tuple(below if names is None else names)
        unknown = sorted(set(passed) - set(below))
        if unknown or not passed:
            raise InputError("names", unknown, "are not in the state", f"choose among {below}")
        unit, log_w = arrays["shared/unit"], arrays["shared/log_w"]
        w = normalised(log_w)
        surface, error = Surface.through(unit, arrays["shared/log_p"], w, arrays["shared/x"])
        before: Mapping[str, Mapping[str, str]] = meta.get("prior", {}).get("seen", {})
        own = {**before.get(meta["rotor"], {}), **meta["readings"]}
        return StoredPosterior(
            passed,
            tuple(shared_prior(model, n) for n in passed),
            error,
            {**before, meta["rotor"]: own},
            state.digest,
            below,
            surface,
            meta["log_evidence"],
            moments(unit, w),
        )

    @property
    def summary(self) -> dict[str, Any]:
        """What a state that starts from this prior says of it."""
        return {
            "source": self.source,
            "names": list(self.names),
            "error_nat": round(self.error_nat, 6),
            "seen": {rotor: dict(own) for rotor, own in self.seen.items()},
        }

    def check(self, model: Model, rotor: str, readings: Mapping[str, str]) -> None:
        """Refuse bounds that differ from those below, and readings that the prior rests on.

        readings   {blade: digest of its readings} of the update on `rotor`
        """
        for name, prior in zip(self.names, self.priors, strict=True):
            own = shared_prior(model, name)
            if own.box != prior.box:
                raise InputError(
                    f"bounds of {name}",
                    (own.low, own.high),
                    f"are not those of the stored posterior, {prior.low:g} … {prior.high:g}",
                    "declare the same bounds on both levels",
                )
        known = {digest for own_readings in self.seen.values() for digest in own_readings.values()}
        for blade, digest in readings.items():
            if digest in known or blade in self.seen.get(rotor, {}):
                raise InputError(
                    "component",
                    blade,
                    "has readings that the stored posterior rests on already",
                    "leave them out, or calibrate both levels from their readings",
                )

    def moments_of(self, name: str) -> tuple[float, float]:
        """Mean and standard deviation of one parameter, on its prior's working scale."""
        low, high = self.priors[self.names.index(name)].box
        j = self.below.index(name)
        mean, cov = self.moments
        return (
            float(low + mean[j] * (high - low)),
            float(np.sqrt(cov[j, j]) * (high - low)),
        )

    @cached_property
    def _inner(self) -> tuple[list[int], list[int], Array, Array]:
        """Places of what is passed on and of what is not, the regression of these, their chol."""
        kept = [self.below.index(n) for n in self.names]
        rest = [j for j in range(len(self.below)) if j not in kept]
        cov = self.moments[1]
        slope = np.asarray(
            np.linalg.solve(cov[np.ix_(kept, kept)], cov[np.ix_(kept, rest)]).T, float
        )
        left = cov[np.ix_(rest, rest)] - slope @ cov[np.ix_(kept, rest)]
        chol = np.asarray(np.linalg.cholesky(left + 1e-14 * np.eye(len(rest))), float)
        return kept, rest, slope, chol

    def log_density(self, unit: Array) -> Array:
        """Log density of the parameters passed on, with respect to the unit box, (n,)."""
        kept, rest, slope, chol = self._inner
        mean = self.moments[0]
        points = np.empty((len(unit), INNER if rest else 1, len(self.below)))
        points[:, :, kept] = unit[:, None, :]
        log_q = np.zeros(points.shape[:2])
        if rest:
            base = sobol(INNER, len(rest), 0)
            for i, u in enumerate(unit):
                centre = np.clip(mean[rest] + slope @ (u - mean[kept]), 0.0, 1.0)
                points[i][:, rest], log_q[i] = Proposal(centre, WIDEN * chol).nodes(base)
        values = self.surface(points.reshape(-1, points.shape[2])).reshape(log_q.shape) - log_q
        top = values.max(axis=1)
        mass = np.log(np.mean(np.exp(values - top[:, None]), axis=1))
        return np.asarray(top + mass - self.log_evidence)
