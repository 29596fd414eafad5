"""A blade's rows at its particles, as they are and with one parameter moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.state import Posterior
from core.calibration.target import BladeRows
from core.discrepancy import total
from core.network import Parameter

Array = NDArray[np.float64]
Places = NDArray[np.int64]
STEP = 1e-3  # of a prior's width, for slopes of the log posterior


@dataclass(frozen=True)
class Answering:
    """R rows of a blade, those of normal priors behind its readings', at N particles.

    names  of the rows' inputs; x: their values, (N, d)
    """

    posterior: Posterior
    rows: BladeRows
    names: Sequence[str]
    x: Array

    def at(
        self, moved: str | None = None, to: Array | None = None, of: Places | None = None
    ) -> tuple[Array, Array]:
        """The rows and their surrogate's sd (P, R), at particles `of`, one parameter moved."""
        x = self.x.copy() if of is None else self.x[of]
        if to is not None and moved is not None and moved in self.names:
            x[:, list(self.names).index(moved)] = to
        f, sd = self.rows.response.evaluate(x)
        for i, one in enumerate(self.rows.discrepancy):
            if one.gain or one.offset:
                gain = 1.0 + total(one.gain, lambda name: self._column(name, moved, to, of))
                offset = total(one.offset, lambda name: self._column(name, moved, to, of))
                f[:, i], sd[:, i] = gain * f[:, i] + offset, gain * sd[:, i]
        return f, sd

    def _column(self, name: str, moved: str | None, to: Array | None, of: Places | None) -> Array:
        if to is not None and name == moved:
            return to
        return self.posterior.column(name) if of is None else self.posterior.column(name)[of]

    def spread(self, sd: Array) -> Array:
        """V (N, R) of noise and surrogate, whose sd is given."""
        own = [
            np.square(self.posterior.column(s) if isinstance(s, str) else s)
            for s in self.rows.sigma
        ]
        sigma2 = np.stack([np.broadcast_to(one, len(sd)) for one in own], axis=1)
        rows = self.rows
        v = sigma2 + rows.extra + (rows.relative * rows.y) ** 2
        return np.asarray(v * rows.discount + sd**2)  # the surrogate's scale holds the discount

    def slopes(self, parameters: Sequence[Parameter]) -> tuple[Array, Array]:
        """The blade's own parameters on their priors' scale u (N, l), and d log p / du there."""
        u = np.empty((len(self.x), len(parameters)))
        slope = np.empty_like(u)
        for k, one in enumerate(parameters):
            low, high = one.prior.box
            u[:, k] = one.prior.to_u(self.posterior.column(one.name))
            ends = [
                np.clip(u[:, k] + side * STEP * (high - low), low, high) for side in (1.0, -1.0)
            ]
            up, down = (self._log_p(one.name, one.prior.to_x(end)) for end in ends)
            slope[:, k] = (up - down) / (ends[0] - ends[1])
        return u, slope

    def _log_p(self, moved: str, to: Array) -> Array:
        """log p of the readings and of normal priors, (N,), but for what is constant."""
        f, sd = self.at(moved, to)
        v, y = self.spread(sd), np.tile(self.rows.y, (len(f), 1))
        for row, mean, _, _ in self.rows.populations:
            y[:, row] = self.posterior.column(mean)
        return np.asarray(-0.5 * np.sum((y - f) ** 2 / v + np.log(v), axis=1))
