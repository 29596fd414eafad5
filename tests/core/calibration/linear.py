"""Linear networks with normal priors and any number of local parameters: everything is Gaussian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.model import Model
from core.monomials import multi_indices
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.response import Response
from core.surrogate.formula import FormulaInput, FormulaModel

SHARED = 0.8


def slopes(t: float, many: int) -> np.ndarray:
    """c_j(t) = cos(j t + 0.3 j²): rows of different directions."""
    j = np.arange(many)
    return np.asarray(np.cos(j * t + 0.3 * j**2))


@dataclass(frozen=True)
class Linear(FormulaModel):
    """y = 0.8 s + Σ c_j(t) l_j, its polynomials written down instead of fitted."""

    def response(
        self,
        quantity: str,
        times: Sequence[float] | np.ndarray,
        nodes: Sequence[int] | None = None,
        degree: int = 5,
    ) -> Response:
        d = len(self.inputs)
        table = multi_indices(d, degree)
        a = np.zeros((len(times), len(table)))
        for r, t in enumerate(times):
            c = np.array([SHARED, *slopes(t, d - 1)])
            a[r, 0] = c @ (self.low + self.high) / 2
            for j in range(d):
                at = int(np.flatnonzero((table == np.eye(d, dtype=int)[j]).all(axis=1))[0])
                a[r, at] = c[j] * (self.high[j] - self.low[j]) / 2
        zero, none = np.zeros_like(a), np.zeros(len(a))
        names = tuple(i.name for i in self.inputs)
        return Response(names, self.low, self.high, degree, a, zero, none, none, zero)


def linear(many: int) -> Model:
    """The network with `many` local parameters of mean −1, −0.5, … and sd 0.6."""

    def formula(x: np.ndarray, t: float) -> np.ndarray:
        return np.asarray(SHARED * x[:, 0] + x[:, 1:] @ slopes(t, many))

    parameters = (
        Parameter("s", "shared", Prior.gaussian(2.0, 0.5)),
        *(Parameter(f"l{j}", "local", Prior.gaussian(-1.0 + 0.5 * j, 0.6)) for j in range(many)),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    quantity = Quantity("y", "1", "scalar", Prior("log_uniform", 0.01, 1.0), -50.0, 50.0)
    return Model(
        Network("linear", parameters, (quantity,)), Linear(inputs, {"y": formula}, f"linear-{many}")
    )


def exact_column(readings: Sequence[Inspection], s: np.ndarray, many: int) -> np.ndarray:
    """log N(y; 0.8 s + C mean, C Sigma C' + sigma²) at each s."""
    c = np.array([slopes(r.time_h, many) for r in readings])
    y, sigma = np.array([r.values[0] for r in readings]), np.array([r.sigma for r in readings])
    cov = 0.36 * c @ c.T + np.diag(sigma**2)
    miss = y - SHARED * s[:, None] - c @ (-1.0 + 0.5 * np.arange(many))
    square = np.sum(miss * np.linalg.solve(cov, miss.T).T, axis=1)
    return np.asarray(-0.5 * square - 0.5 * np.linalg.slogdet(2 * np.pi * cov)[1])


def exact_locals(
    readings: Sequence[Inspection], s: float, many: int
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the local parameters at one s."""
    c = np.array([slopes(r.time_h, many) for r in readings])
    y, sigma = np.array([r.values[0] for r in readings]), np.array([r.sigma for r in readings])
    mean = -1.0 + 0.5 * np.arange(many)
    gain = 0.36 * c.T @ np.linalg.inv(0.36 * c @ c.T + np.diag(sigma**2))
    return mean + gain @ (y - SHARED * s - c @ mean), 0.36 * (np.eye(many) - gain @ c)
