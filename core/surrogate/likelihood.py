"""Length scales and nugget of the process by maximum restricted likelihood.

With R, H, Q and p of `core.surrogate.kernel` and n runs, the restricted log-likelihood with
sigma_j^2 = c_j^T Q c_j / (n - p) profiled out is

    2 L = -(n - p) sum_j w_j log sigma_j^2 - sum_j w_j (log|R| + log|H^T R^-1 H|),

maximised over the d length scales and the nugget (C. E. Rasmussen, C. K. I. Williams,
"Gaussian Processes for Machine Learning", 2006, section 2.7; weights w_j sum to one).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize

from core.monomials import monomials
from core.surrogate.kernel import Hyper, correlation

Array = NDArray[np.float64]
LENGTHS = (0.2, 20.0)
NUGGETS = (1e-9, 1e-2)
STARTS = (0.7, 1.5, 3.0)


def log_likelihood(z: Array, targets: Array, share: Array, hyper: Hyper) -> tuple[float, Array]:
    """The restricted log-likelihood L of the module's text and its slopes; share (J,) are w_j.

    Slopes are those with the logarithms of the length scales and of the nugget, (d + 1,). With
    a_j = Q c_j and M = (n - p) sum_j w_j a_j a_j^T / (c_j^T a_j) - Q,  dL = 1/2 sum(M * dR).
    A matrix that is not positive definite has L = -inf.
    """
    h, lengths = monomials(z, hyper.trend), np.array(hyper.lengths)
    n, p = h.shape
    r = correlation(z, z, lengths)
    kernel = r.copy()
    r[np.diag_indices_from(r)] += hyper.nugget
    try:
        lower = cholesky(r, lower=True)
        whiten = solve_triangular(lower, np.eye(n), lower=True)
        gram = cholesky(h.T @ whiten.T @ whiten @ h, lower=True)
    except np.linalg.LinAlgError:
        return -np.inf, np.zeros(len(lengths) + 1)
    along = solve_triangular(gram, h.T @ whiten.T, lower=True) @ whiten
    q = whiten.T @ whiten - along.T @ along
    solved = q @ targets
    square = np.maximum(np.sum(targets * solved, axis=0), np.finfo(float).tiny)
    determinant = 2.0 * float(np.sum(np.log(np.diag(lower))) + np.sum(np.log(np.diag(gram))))
    value = -0.5 * ((n - p) * float(share @ np.log(square / (n - p))) + determinant)
    m = (n - p) * (solved * (share / square)) @ solved.T - q
    slopes = [
        0.5 * np.sum(m * kernel**2 * (z[:, i, None] - z[:, i]) ** 2) / lengths[i] ** 2
        for i in range(len(lengths))
    ]
    return float(value), np.array([*slopes, 0.5 * hyper.nugget * np.trace(m)])


def fit_hyper(z: Array, targets: Array, share: Array, trend: int) -> Hyper:
    """Length scales and nugget by maximum restricted likelihood, from fixed starts."""
    d = z.shape[1]
    told = np.any(targets != 0, axis=0)  # coefficients that are 0 in every run tell nothing
    targets, share = (targets, share) if told.all() else (targets[:, told], share[told])
    bounds = [tuple(np.log(LENGTHS))] * d + [tuple(np.log(NUGGETS))]

    def unpack(theta: Array) -> Hyper:
        scales = np.exp(theta)
        return Hyper(tuple(float(s) for s in scales[:d]), float(scales[d]), trend)

    def cost(theta: Array) -> tuple[float, Array]:
        value, slopes = log_likelihood(z, targets, share, unpack(theta))
        return (-value, -slopes) if np.isfinite(value) else (1e10, slopes)

    best: Any = None
    for start in STARTS:
        theta = np.log(np.array([start] * d + [1e-5]))
        found = minimize(cost, theta, jac=True, method="L-BFGS-B", bounds=bounds)
        if best is None or found.fun < best.fun:
            best = found
    return unpack(best.x)
