"""Draws of the twin's exact posterior, and what readings they would give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.observation import Inspection
from core.rng import stream
from service.fake.conjugate import HORIZON_H, SIGMA, moments
from service.fake.outputs import along
from service.ports import Draws, Get, JointDraws, ModelCard


def shared_draws(meta: Mapping[str, Any], get: Get) -> Draws:
    mean, variance = get("shared/moments")
    z = stream(meta["seed"], "shared").standard_normal((meta["particles"], 1))
    return Draws(("rate",), mean + np.sqrt(variance) * z, np.zeros(len(z)), np.arange(len(z)))


def blade_draws(meta: Mapping[str, Any], get: Get, blade: str) -> Draws:
    mean, covariance = moments(get, blade)
    z = stream(meta["seed"], "blade", blade).standard_normal((meta["particles"], 2))
    root = np.linalg.cholesky(covariance + 1e-15 * np.eye(2))
    return Draws(("rate", "offset"), mean + z @ root.T, np.zeros(len(z)), np.arange(len(z)))


def joint_draws(meta: Mapping[str, Any], get: Get, blades: Sequence[str], count: int) -> JointDraws:
    """m first, then each l_b given m."""
    rng = stream(meta["seed"], "joint")
    centre, variance = get("shared/moments")
    shared = centre + np.sqrt(variance) * rng.standard_normal((count, 1))
    local = np.empty((count, len(blades), 1))
    for i, blade in enumerate(blades):
        mean, covariance = moments(get, blade)
        slope = covariance[1, 0] / variance
        left = np.sqrt(covariance[1, 1] - slope**2 * variance)
        local[:, i] = mean[1] + slope * (shared - centre)
        local[:, i] += left * rng.standard_normal((count, 1))
    return JointDraws(("rate",), shared, ("offset",), tuple(blades), local, meta["particles"])


def replicated(
    card: ModelCard, drawn: JointDraws, readings: Sequence[Inspection]
) -> list[NDArray[np.float64]]:
    """(m + l_b) h at the reading's nodes, with its noise."""
    found = []
    for one in readings:
        rate = drawn.shared[:, 0] + drawn.local[:, drawn.blades.index(one.blade), 0]
        nodes = [None] if one.nodes is None else one.nodes.tolist()
        scale = np.concatenate([along(card, one.quantity, node) for node in nodes])
        y = np.outer(rate, scale * one.time_h / HORIZON_H)
        z = stream(0, "replicated", one.id).standard_normal(y.shape)
        found.append(y + (one.sigma or SIGMA) * z)
    return found
