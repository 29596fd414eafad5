"""The conjugate twin: its posterior and predictions are exact.

Each blade elongates at a rate of its own around the rotor's::

    r_b = m + l_b,   m ~ N(0.5, 0.1²),   l_b ~ N(0, 0.2²)            [mm per 50,000 h]
    y   = r_b h + e,  h = t / 50,000,    e ~ N(0, sigma²)             [mm]

with sigma given by the reading or 0.02 mm. With n = Σ h²/sigma² and s = Σ h y/sigma² of a blade,
its message about m is N(s/n, 1/n + 0.2²).
A deformation at node k of N is (0, 0, r_b h (k+1)/N); ceeq there is r_b h (k+1)/(100 N).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.digest import array_digest, state_digest
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.readings import columns_of, digest_of
from service.ports import Array, Get, ModelCard, RotorSpec

MEAN, SD, SCATTER, SIGMA = 0.5, 0.1, 0.2, 0.02
HORIZON_H = 50_000.0


def fake_network() -> Network:
    """The declaration of the conjugate twin."""
    noise = Prior("log_uniform", 1e-3, 0.2)
    return Network(
        name="fake",
        parameters=(
            Parameter("rate", "shared", Prior.gaussian(MEAN, SD), "mm"),
            Parameter("offset", "local", Prior.gaussian(0.0, SCATTER), "mm"),
        ),
        quantities=(
            Quantity("elongation", "mm", "scalar", noise, -5.0, 50.0),
            Quantity("deformation", "mm", "vector", noise, -50.0, 50.0),
            Quantity("ceeq", "1", "field", noise, 0.0, 0.5, "critical"),
        ),
    )


@dataclass(frozen=True, slots=True)
class FakeState:
    """Sufficient statistics: ``column/<blade>`` (n, s) and ``shared/moments`` (mean, variance).

    kept   arrays that are those of the state before
    """

    meta: Mapping[str, Any]
    arrays: Mapping[str, Array]
    kept: frozenset[str] = frozenset()

    @property
    def fresh(self) -> frozenset[str]:
        return frozenset(self.arrays) - self.kept

    @property
    def digest(self) -> str:
        return state_digest(self.meta, {n: array_digest(a) for n, a in self.arrays.items()})


def fitted(
    card: ModelCard,
    rotor: RotorSpec,
    readings: Sequence[Inspection],
    *,
    sealed: bool,
    previous: FakeState | None = None,
) -> FakeState:
    """The posterior of these readings; of the state before only equal arrays are taken."""
    columns = sums_of(card, rotor, readings)
    precision, weighted = 1.0 / SD**2, MEAN / SD**2
    for n, s in columns.values():
        if n > 0:
            precision += 1.0 / (1.0 / n + SCATTER**2)
            weighted += (s / n) / (1.0 / n + SCATTER**2)
    arrays: dict[str, Array] = {f"column/{name}": column for name, column in columns.items()}
    arrays["shared/moments"] = np.array([weighted / precision, 1.0 / precision])
    exact = {"status": "ok", "reasons": [], "met_floor": True, "contradicted": []}
    meta = {
        "algorithm_version": "fake-1",
        "events_digest": digest_of(readings),
        "sealed": sealed,
        "health": {"ess": rotor.particles, "ess_ratio": 1.0} | exact,
        "blades": list(rotor.blades),
        "particles": rotor.particles,
        "seed": rotor.seed,
        "readings": len(readings),
    }
    before = {} if previous is None else {n: a.tobytes() for n, a in previous.arrays.items()}
    kept = frozenset(name for name, a in arrays.items() if before.get(name) == a.tobytes())
    return FakeState(meta, arrays, kept)


def sums_of(
    card: ModelCard, rotor: RotorSpec, readings: Sequence[Inspection]
) -> dict[str, NDArray[np.float64]]:
    """(n, s) of each blade, each reading added in its order."""
    place = {blade: k for k, blade in enumerate(rotor.blades)}
    columns = columns_of(readings)
    blade = columns.counts(lambda head: place[head.blade])
    scalar = columns.counts(lambda head: head.quantity == "elongation") > 0
    ends, node_ends = columns.value_ends(), columns.node_ends()
    h = columns.time_h / HORIZON_H
    y = columns.values[ends - 1]
    square, product = h * h, h * y
    for k in np.flatnonzero(~scalar).tolist():
        head = columns.heads[columns.code[k]]
        own = columns.values[ends[k] - prod(head.shape) : ends[k]].reshape(head.shape)
        nodes = columns.nodes[node_ends[k] - head.node_count : node_ends[k]]
        by = sensitivity(head.quantity, h[k], None if head.node_count < 0 else nodes, card)
        square[k], product[k] = by @ by, by @ (own[:, -1] if own.ndim == 2 else own)
    sigma = np.nan_to_num(columns.sigma, nan=SIGMA) if len(columns.sigma) else SIGMA
    precision = 1.0 / sigma**2
    sums = [np.bincount(blade, precision * part, len(place)) for part in (square, product)]
    found = np.column_stack(sums).astype(np.float64)  # of no reading they are integers
    return dict(zip(rotor.blades, found, strict=True))


def sensitivity(
    quantity: str, h: float, nodes: NDArray[np.int64] | None, card: ModelCard
) -> NDArray[np.float64]:
    """What values at nodes are of their blade's rate; None: at the critical one."""
    at = np.array([3]) if nodes is None else nodes
    scale = 1.0 if quantity == "deformation" else 0.01
    return np.asarray(scale * h * (at + 1) / card.node_count)


def moments(get: Get, blade: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean (2,) and covariance (2, 2) of (m, l_b) given everything."""
    (mean, variance), (n, s) = get("shared/moments"), get(f"column/{blade}")
    gain = n * SCATTER**2 / (1.0 + n * SCATTER**2)
    rate = s / n if n > 0 else 0.0
    local_variance = SCATTER**2 * (1.0 - gain)
    centre = np.array([mean, gain * (rate - mean)])
    cross = -gain * variance
    covariance = [[variance, cross], [cross, local_variance + gain**2 * variance]]
    return centre, np.array(covariance)
