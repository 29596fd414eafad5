"""What is told of weighted draws: moments, quantiles, correlations, and how sure these are."""

from __future__ import annotations

from typing import Any

import numpy as np

from core.smc.particles import weighted_quantile
from core.smc.parts import r_hat
from service.ports import Draws, Json

LEVELS = (0.025, 0.05, 0.16, 0.5, 0.84, 0.95, 0.975)


def summary(draws: Draws) -> Json:
    """Weighted moments and quantiles of draws; R of each, null where there is none.

    Quantiles lie between draws, as those do whose coverage studies count (`core.validation.sbc`): a
    shared parameter may have 64 draws, and the one at which the weights pass a share is off by half
    as much again.

    >>> two = Draws(("a",), np.array([[1.0], [3.0]]), np.log([0.75, 0.25]), np.arange(2))
    >>> summary(two)["parameters"]["a"]["mean"], round(summary(two)["ess"], 3)
    (1.5, 1.6)
    """
    w = np.exp(draws.log_w - draws.log_w.max())
    w /= w.sum()
    mean = w @ draws.values
    centred = draws.values - mean
    covariance = (centred * w[:, None]).T @ centred
    sd = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.nan_to_num(covariance / np.outer(sd, sd))
    np.fill_diagonal(correlation, 1.0)
    agreement = r_hat(draws.values, draws.log_w, draws.node)
    parameters: dict[str, Any] = {}
    for i, name in enumerate(draws.names):
        values = weighted_quantile(draws.values[:, i], w, np.array(LEVELS))
        parameters[name] = {
            "mean": float(mean[i]),
            "sd": float(sd[i]),
            "r_hat": float(agreement[i]) if np.isfinite(agreement[i]) else None,
            "quantiles": {str(p): float(v) for p, v in zip(LEVELS, values, strict=True)},
        }
    return {
        "parameters": parameters,
        "names": list(draws.names),
        "correlation": correlation.tolist(),
        "ess": float(1.0 / (w @ w)),
        "r_hat": float(agreement.max()) if np.all(np.isfinite(agreement)) else None,
        "draws": len(w),
    }
