"""What the twin says a blade does: bands, answers of the model itself, fields and their surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from service.fake.conjugate import HORIZON_H, SIGMA, moments
from service.ports import Array, Field, Get, ModelCard, NoiseFrom, Surface

LEVELS = (0.025, 0.16, 0.5, 0.84, 0.975)
LIFE_LEVELS = (0.025, 0.05, 0.16, 0.5, 0.84, 0.95, 0.975)  # those of core.life
GRID = 4001  # values of the rotor's rate, over ± 9 sd


@dataclass(frozen=True, slots=True)
class FakePrediction:
    """Bands of one quantity, by source."""

    time_h: Array
    mean: Array
    sd: Mapping[str, Array]
    lower: Array
    upper: Array
    quantiles: Mapping[float, Array]
    instrument: str | None = None
    noise_from: NoiseFrom = "prior"


@dataclass(frozen=True, slots=True)
class FakeLife:
    """When a blade passes a limit."""

    time_h: Array
    passed: Array
    quantiles: Mapping[float, float | None]


@dataclass(frozen=True, slots=True)
class FakeRotorLife:
    """Which blades pass a limit, and how surely any does."""

    time_h: Array
    passed: Mapping[str, Array]
    expected: Array
    any: Array


@dataclass(frozen=True, slots=True)
class FakeForward:
    """(m + l_b) h at a node, known exactly."""

    card: ModelCard
    quantity: str
    names: tuple[str, ...] = ("rate", "offset")
    units: tuple[str, ...] = ("mm", "mm")
    low: tuple[float, ...] = (-5.0, -5.0)
    high: tuple[float, ...] = (5.0, 5.0)

    def __call__(
        self, x: Sequence[float], times: Sequence[float], node: int | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scale = along(self.card, self.quantity, node)
        y = sum(x) * np.asarray(times, float)[:, None] / HORIZON_H * scale
        y = y if self.quantity == "deformation" else y[:, 0]
        return y, np.zeros_like(y)


def along(card: ModelCard, quantity: str, node: int | None) -> NDArray[np.float64]:
    """What a quantity at a node has of the elongation at the tip: (1,), of a deformation (3,)."""
    if quantity == "elongation":
        return np.ones(1)
    k = card.nodes["critical"] if node is None else node
    scale = np.array([0.0, 0.0, 1.0]) if quantity == "deformation" else np.array([0.01])
    return scale * (k + 1) / card.node_count


def banded(
    card: ModelCard,
    get: Get,
    blade: str,
    quantity: str,
    times: Sequence[float],
    node: int | None,
    probability: float,
) -> FakePrediction:
    mean, covariance = moments(get, blade)
    time_h = np.asarray(times, float)
    h = time_h[:, None] / HORIZON_H * along(card, quantity, node)
    h = h if quantity == "deformation" else h[:, 0]
    parameters = np.sqrt(covariance.sum()) * h
    zero, noise = np.zeros_like(h), np.full_like(h, SIGMA)
    total = np.hypot(parameters, noise)
    centre = mean.sum() * h
    half = ndtri(0.5 + probability / 2) * total
    parts = {"parameters": parameters, "surrogate": zero, "discrepancy": zero}
    return FakePrediction(
        time_h,
        centre,
        parts | {"noise": noise, "total": total},
        centre - half,
        centre + half,
        {level: centre + ndtri(level) * total for level in LEVELS},
    )


def life_of(
    card: ModelCard,
    get: Get,
    blade: str,
    quantity: str,
    limit: float,
    times: Sequence[float],
    node: int | None,
    component: int | None,
) -> FakeLife:
    """y = r h a passes L > 0 by the hour at which r = L / (h a), r normal; exactly."""
    mean, covariance = moments(get, blade)
    rate, sd = float(mean.sum()), float(np.sqrt(covariance.sum()))
    part = along(card, quantity, node)[0 if component is None else component]
    time_h = np.unique(np.asarray(times, float))
    passed = passed_by(rate, sd, limit, time_h / HORIZON_H * part)
    hours: dict[float, float | None] = {}
    for level in LIFE_LEVELS:
        needed = part * (rate + sd * float(ndtri(1 - level)))
        at = 0.0 if limit <= 0 else HORIZON_H * limit / needed if needed > 0 else np.inf
        hours[level] = at if at <= HORIZON_H else None
    return FakeLife(time_h, passed, hours)


def passed_by(rate: Array | float, sd: float, limit: float, h: Array) -> Array:
    """Whether r h >= limit by then, r ~ N(rate, sd²); of several rates (K, 1) each, (K, T)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        z = np.where(h > 0, (rate * h - limit) / (sd * h), np.where(limit <= 0, np.inf, -np.inf))
    return np.asarray(np.maximum.accumulate(ndtr(z), axis=-1))


def rotor_life_of(
    card: ModelCard,
    get: Get,
    blades: Sequence[str],
    quantity: str,
    limit: float,
    times: Sequence[float],
    node: int | None,
    component: int | None,
    ages: Mapping[str, float],
) -> FakeRotorLife:
    """Blades know of each other by the rotor's rate m alone: summed over m by the trapezoid."""
    time_h = np.unique(np.asarray(times, float))
    part = along(card, quantity, node)[0 if component is None else component]
    off = np.linspace(-9.0, 9.0, GRID)
    weight, passed = np.exp(-0.5 * off**2), dict[str, Array]()
    none = np.ones((GRID, len(time_h)))
    for blade in blades:
        h = (time_h + ages.get(blade, 0.0)) / HORIZON_H * part
        mean, covariance = moments(get, blade)
        variance, cross = covariance.sum(), covariance[0].sum()  # of r, and of r with m
        passed[blade] = passed_by(float(mean.sum()), float(np.sqrt(variance)), limit, h)
        given = mean.sum() + off[:, None] * cross / np.sqrt(covariance[0, 0])
        left = float(np.sqrt(variance - cross**2 / covariance[0, 0]))
        none *= 1.0 - passed_by(given, left, limit, h)
    at_all = weight @ (1.0 - none) / weight.sum()
    return FakeRotorLife(time_h, passed, np.sum([0.0 * time_h, *passed.values()], axis=0), at_all)


def field_of(
    card: ModelCard, meta: Mapping[str, Any], get: Get, blade: str, quantity: str, time_h: float
) -> Field:
    mean, covariance = moments(get, blade)
    scale = time_h / HORIZON_H * (np.arange(card.node_count) + 1) / card.node_count
    scale = scale[:, None] * [0.0, 0.0, 1.0] if quantity == "deformation" else 0.01 * scale
    return Field(mean.sum() * scale, np.sqrt(covariance.sum()) * scale, meta["particles"])


def surface_of(card: ModelCard) -> Surface:
    """A strip of two columns of nodes, from root to tip."""
    rows = card.node_count // 2
    number = np.arange(2 * rows).reshape(rows, 2)
    points = np.zeros((card.node_count, 3))
    points[: 2 * rows, 0], points[: 2 * rows, 2] = np.tile([0.0, 10.0], rows), number.ravel()
    a, b = number[:-1].T, number[1:].T
    pairs = [(a[0], a[1], b[0]), (a[1], b[1], b[0])]
    return Surface(points, np.concatenate([np.stack(one, axis=1) for one in pairs]))
