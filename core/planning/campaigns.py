"""Inspections of every blade at once, and what a calibrated model expects them to read.

One reading of one blade seldom tells what the whole rotor's would: an effect that is common to the
blades is told by all of them together, and most of all by their shapes. A `Campaign` reads every
blade once, an elongation or CEEQ each, or a 3-D scan each; as many rows a blade as the quantity has
(`core.calibration.scans`: a scan's readings through Qᵀ, its part off the modes tells nothing of the
blade). What is expected of it: `core.planning.moments`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.scans import doubt
from core.calibration.state import RotorState
from core.curves import corrected, inputs_of, noise_of
from core.discrepancy import AXES
from core.errors import InputError
from core.model import Model
from core.observation import Inspection
from core.planning.ahead import TO_COME, Drawn, answered
from core.planning.candidates import (
    AHEAD,
    UNREAD,
    Candidate,
    candidates,
    to_come,
    usual_interval_h,
)
from core.planning.moments import Awaited
from core.planning.ready import modes, ready
from core.response import Response

Array = NDArray[np.float64]
HOURS = AHEAD[::2]  # of the usual interval: now, and at the next visit
SCANNED = 64  # nodes of a scan, where none was scanned yet
MOST = 800  # particles of a blade
FAINT = 1e-6  # of the largest: directions that blades have in common


@dataclass(frozen=True, slots=True)
class Campaign:
    """One reading of each blade, `ahead_h` after its latest one.

    blades  that it reads, with their hours then
    nodes   of a scan; none: one value a blade
    """

    quantity: str
    ahead_h: float
    blades: tuple[tuple[str, float], ...]
    instrument: str | None = None
    sigma: float | None = None
    nodes: tuple[int, ...] | None = None

    def to_json(self) -> dict[str, Any]:
        """A plain dictionary, with numbers of blades and nodes."""
        return {
            "quantity": self.quantity,
            "ahead_h": self.ahead_h,
            "blades": len(self.blades),
            "instrument": self.instrument,
            "sigma": self.sigma,
            "nodes": None if self.nodes is None else len(self.nodes),
        }


def campaigns(
    model: Model, blades: Sequence[str], readings: Sequence[Inspection]
) -> tuple[Campaign, ...]:
    """Those that could be made: every quantity that the model answers for, now and later.

    Instruments as in `candidates`. A scan is of the nodes of the rotor's last one, else of
    `SCANNED` nodes evenly over the mesh.
    """
    together: dict[tuple[str, float, str | None, float | None], list[tuple[str, float]]] = {}
    step = usual_interval_h(readings) or UNREAD * model.surrogate.horizon_h
    hours = [share * step for share in HOURS]
    for one in candidates(model, blades, readings, hours):
        key = (one.quantity, one.ahead_h, one.instrument, one.sigma)
        together.setdefault(key, []).append((one.blade, one.time_h))
    found = [Campaign(q, h, tuple(own), by, sigma) for (q, h, by, sigma), own in together.items()]
    latest = {b: max([0.0, *(r.time_h for r in readings if r.blade == b)]) for b in blades}
    for q in model.network.quantities:
        if q.kind != "vector" or (nodes := _nodes(model, q.name, readings)) is None:
            continue
        there = to_come(latest, blades, hours, step, model.part(q.name).horizon_h)
        for ahead in hours:
            own = tuple((b, h) for (b, a), h in there.items() if a == ahead)
            if own:
                found.append(Campaign(q.name, ahead, own, None, None, nodes))
    return tuple(found)


def _nodes(model: Model, quantity: str, readings: Sequence[Inspection]) -> tuple[int, ...] | None:
    """Of a scan to come; none where the model has no shapes."""
    part = model.part(quantity)
    read = [r for r in readings if r.quantity == quantity and r.nodes is not None]
    if read:
        last = max(read, key=lambda r: (r.time_h, r.id)).nodes
        nodes = [] if last is None else last.tolist()
    else:
        count = min(SCANNED, part.node_count)
        nodes = np.linspace(0, part.node_count - 1, count).round().astype(int).tolist()
    try:
        part.deformation_modes(nodes)
    except (InputError, NotImplementedError):
        return None
    return tuple(nodes)


def compiled_for(
    model: Model, state: RotorState, singles: Sequence[Candidate], asked: Sequence[Campaign]
) -> None:
    """Whatever the model has to compile for all of these, at once: sooner than one by one."""
    readings = {(one.blade, one.quantity, one.time_h) for one in singles}
    shapes = {}
    for one in asked:
        if one.nodes is None:
            readings |= {(blade, one.quantity, hour) for blade, hour in one.blades}
        else:
            shapes[one.quantity, one.blades, one.nodes] = _basis(model, one)[1]
    read = {blade for blade, _, _ in readings}
    fewest = min((state.arrays[f"blade/{b}/log_w"].size for b in read), default=0)
    ready(model, fewest, sorted(readings), [(q, own, r) for (q, own, _), r in shapes.items()])


def awaited(
    model: Model,
    state: RotorState,
    asked: Campaign,
    known: Mapping[str, Mapping[str, float]] | None = None,
) -> Awaited:
    """Moments of a campaign's readings, by `MOST` particles of each blade of a state."""
    mean, own, given = [], [], []
    node_w: Array = np.zeros(0)
    basis = None if asked.nodes is None else _basis(model, asked)
    drawn_of = {blade: Drawn.of(state, blade, MOST) for blade, _ in asked.blades}
    made: Mapping[tuple[int, float], Response] = {}
    if basis is None:
        fewest = min(len(one.w) for one in drawn_of.values())
        ready(model, fewest, ((b, asked.quantity, hour) for b, hour in asked.blades))
    else:
        made = modes(model, asked.quantity, asked.blades, basis[1])
    for blade, hour in asked.blades:
        drawn = drawn_of[blade]
        f, noise = _rows(model.for_blade(blade), drawn, asked, blade, hour, known, basis, made)
        m, off, between = drawn.centred(f)
        node_w = drawn.node_w
        mean.append(m)
        own.append(_within(drawn, off) + noise)
        given.append(between)
    stacked = np.sqrt(node_w)[:, None] * np.concatenate(given, axis=1)  # (K, B c)
    _, size, way = np.linalg.svd(stacked, full_matrices=False)
    kept = size > FAINT * max(float(size[0]), 1e-300)
    common = (size[kept, None] * way[kept]).T.reshape(len(mean), -1, int(kept.sum()))
    covariance = np.array(own)
    return Awaited(np.array(mean), 0.5 * (covariance + np.swapaxes(covariance, 1, 2)), common)


def _within(drawn: Drawn, off: Array) -> Array:
    """Covariance of values (n, c) about their means at the nodes, (c, c)."""
    nodes = len(drawn.node_w)
    w = drawn.w.reshape(nodes, -1)
    values = off.reshape(nodes, w.shape[1], -1)
    middle = np.einsum("km,kmc->kc", w, values) / np.maximum(w.sum(axis=1), 1e-300)[:, None]
    left = (values - middle[:, None]).reshape(off.shape)
    return np.asarray((left * drawn.w[:, None]).T @ left)


def _basis(model: Model, asked: Campaign) -> tuple[Array, Array]:
    """Q (3 n, c) and R (c, modes) of the nodes."""
    phi = model.part(asked.quantity).deformation_modes(list(asked.nodes or ()))
    q, r = np.linalg.qr(phi.reshape(len(AXES) * len(asked.nodes or ()), -1))
    return np.asarray(q), np.asarray(r)


def _rows(
    model: Model,
    drawn: Drawn,
    asked: Campaign,
    blade: str,
    hour: float,
    known: Mapping[str, Mapping[str, float]] | None,
    basis: tuple[Array, Array] | None,
    made: Mapping[tuple[int, float], Response],
) -> tuple[Array, Array]:
    """A blade's rows at its particles (N, c), and E S, (c, c).

    made  rows of scans, by blades that have the same effects and by hour
    """
    posterior, fixed = drawn.posterior, (known or {}).get(blade)
    if basis is None:
        one = Candidate(blade, asked.quantity, hour, asked.ahead_h, asked.instrument, asked.sigma)
        f, v = answered(model, posterior, [one], fixed, noise=True)
        return f, np.diag(drawn.w @ v)
    (q, r), declared = basis, model.network.quantity(asked.quantity)
    part, reader = model.part(asked.quantity), (asked.instrument, TO_COME)
    f, sd = made[id(model), hour].evaluate(inputs_of(model, posterior, asked.quantity, fixed))
    at, axes = np.array([hour]), range(len(AXES))
    wrong = [corrected(model, posterior, declared, at, axis, reader) for axis in axes]
    gain, off = wrong[0][0], np.concatenate([one[1] for one in wrong], axis=1)
    f = gain * f + off @ q.reshape(-1, len(AXES), q.shape[1]).sum(axis=0)
    z, error = drawn.w @ f, np.sqrt(drawn.w @ (gain * sd) ** 2)
    sigma = noise_of(model, posterior, asked.quantity)
    sigma2 = float(drawn.w @ sigma**2) if asked.sigma is None else asked.sigma**2
    sigma_delta, left = float(wrong[0][2][0]), float(wrong[0][3][0])
    noise = doubt(part.mode_covariance(hour), r, z, error, declared.numerical)
    noise += (sigma2 + sigma_delta**2) * np.eye(len(z)) + left**2 * np.outer(z, z)
    return f, noise
