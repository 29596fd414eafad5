"""What all other readings of a blade say of one of its visits, as a normal distribution.

With the R rows of a blade linear about a fit at a shared node s*, whitened by their noise σ, and
their sensitivities J to the L local parameters, the rows V of one visit are foreseen by all the
others O (the *cavity*: without their own likelihood) with

    mean  Y_V(l_O),      precision  A = (I + J_V (J_Oᵀ J_O + Λ)⁻¹ J_Vᵀ)⁻¹   (whitened),

l_O the best fit of the others and Λ the information of the local parameters' priors. For linear
rows that follows from the fit to all readings, l and e = (y − Y(l))/σ, without another one:

    mean  y_V/σ_V − A⁻¹ e_V,      A = I − J_V (Jᵀ J + Λ)⁻¹ J_Vᵀ.

It is refitted where that would not do: where all readings press the fit against a bound, or a visit
is far from what is foreseen of it. All this is a look, at some model answers a blade; what rests on
it is weighed by the messages themselves.

A scan's rows are mixtures of the deformation's modes (`scans.Mixing`), of each scan its own; they
are told here by the modes, which scans of the same nodes have in common.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import BladeMessage
from core.calibration.scans import Mixing
from core.observation import Inspection

Array = NDArray[np.float64]
Visit = tuple[str, float]  # campaign, or "" and the hour
TURNS = 16
SETTLED = 1e-3  # of the box
STEP = 1e-4  # of the box, of differences
FAR = 2.0  # sds from which on a visit's others are fitted without it
UNIFORM = 12.0  # information of a uniform prior over its width


@dataclass(frozen=True, slots=True)
class Seen:
    """A visit of a blade, of q coordinates.

    readings  in the order of their coordinates
    alike     what they are, told so that visits of two blades that agree in it can be compared
    value     y, (q,) [unit]; mean (q,), precision (q, q): of what is foreseen of it
    others    whether the blade has readings of other visits
    """

    readings: tuple[Inspection, ...]
    alike: tuple[object, ...]
    value: Array
    mean: Array
    precision: Array
    others: bool

    @property
    def misfit(self) -> float:
        """chi² of the value against what is foreseen of it; 0 where nothing is."""
        off = self.value - self.mean
        return float(off @ self.precision @ off) if self.others else 0.0

    def log_density(self, values: Array) -> Array:
        """Of values (n, q), (n,); the constant of the dimension is left out.

        >>> one = Seen((), (), np.zeros(1), np.ones(1), 4.0 * np.eye(1), True)
        >>> one.log_density(np.array([[1.0], [2.0]])).round(3).tolist()
        [0.693, -1.307]
        """
        off = values - self.mean
        _, size = np.linalg.slogdet(self.precision)
        return np.asarray(0.5 * size - 0.5 * np.einsum("ni,ij,nj->n", off, self.precision, off))


def visit_of(reading: Inspection) -> Visit:
    """The campaign in which a reading was taken; its hour, where it names none."""
    return ("", reading.time_h) if reading.campaign is None else (reading.campaign, 0.0)


def visits_of(readings: Sequence[Inspection]) -> dict[Visit, list[int]]:
    """Places of a blade's readings, by visit; within one by what they are, and in their order."""
    found: dict[Visit, list[int]] = {}
    for place in sorted(range(len(readings)), key=lambda p: (_kind(readings[p]), p)):
        found.setdefault(visit_of(readings[place]), []).append(place)
    return found


def _kind(reading: Inspection) -> tuple[str, bytes]:
    return reading.quantity, b"" if reading.nodes is None else reading.nodes.tobytes()


def seen_of(message: BladeMessage, at: Array) -> dict[Visit, Seen]:
    """The visits of a blade, each foreseen from the others, at the node `at` (1, d)."""
    rows, fit = message.rows, LeastSquares(message, at)
    share, mean, sd, slope = fit.best(np.ones(len(fit.y)), np.full(len(fit.moved), 0.5))
    hat = slope @ np.linalg.solve(slope.T @ slope + fit.information, slope.T)
    pressed = bool(np.any((share <= 0.0) | (share >= 1.0)))
    of, miss = np.array(rows.of), (fit.y - mean) / sd
    visits = visits_of(rows.readings)
    found = {}
    for visit, places in visits.items():
        own = np.concatenate([np.flatnonzero(of == place) for place in places])
        left, noise = np.eye(len(own)) - hat[np.ix_(own, own)], sd[own]
        off = np.linalg.solve(left, miss[own])
        if pressed or off @ left @ off > FAR**2 * len(own):
            counts = np.ones(len(fit.y))
            counts[own] = 0.0
            _, mean_o, sd_o, slope_o = fit.best(counts, share)
            bend = slope_o.T @ (counts[:, None] * slope_o) + fit.information
            across = slope_o[own] @ np.linalg.solve(bend, slope_o[own].T)
            left, noise = np.linalg.inv(np.eye(len(own)) + across), sd_o[own]
            off = (fit.y[own] - mean_o[own]) / noise
        turn = _turn(rows.mixings, places, of)
        scaled = turn / noise[:, None]
        foreseen = fit.y[own] - noise * off
        readings = tuple(rows.readings[place] for place in places)
        found[visit] = Seen(
            readings,
            tuple(_kind(reading) for reading in readings),
            np.linalg.solve(turn, fit.y[own]),
            np.linalg.solve(turn, foreseen),
            scaled.T @ left @ scaled,
            len(visits) > 1,
        )
    return found


def _turn(mixings: Mapping[int, Mixing], places: Sequence[int], of: Array) -> Array:
    """What makes a visit's rows of common coordinates: of a scan its W, of anything else 1."""
    sizes = [int(np.sum(of == place)) for place in places]
    out, end = np.eye(sum(sizes)), 0
    for place, size in zip(places, sizes, strict=True):
        if place in mixings:
            out[end : end + size, end : end + size] = mixings[place].turn
        end += size
    return out


class LeastSquares:
    """A blade's rows as a least-squares problem in its local parameters, at the node `at` (1, d).

    The parameters (L,) are told by their share of the box, which a fit does not leave.
    """

    def __init__(self, message: BladeMessage, at: Array) -> None:
        y, s2, _ = message.readings(at)
        self.y, self.s2 = y[0], s2[0]
        response, space = message.rows.response, message.space
        self.message, self.low, self.width = message, response.low, response.high - response.low
        self.x0 = self.low + 0.5 * self.width
        self.moved: list[int] = []
        for j, name in enumerate(response.names):
            if name in message.fixed:
                self.x0[j] = message.fixed[name]
            elif name in space.names:
                self.x0[j] = space.to_x(at)[0, space.names.index(name)]
            elif message.model.network.parameter(name).level == "local":
                self.moved.append(j)

    @cached_property
    def information(self) -> Array:
        """Λ, (L, L), of what is not a row of its own."""
        names = [self.message.rows.response.names[j] for j in self.moved]
        found = [self.message.model.network.parameter(name) for name in names]
        rows = [p.population is not None or p.prior.kind == "normal" for p in found]
        return np.diag([0.0 if row else UNIFORM for row in rows])

    def at(self, share: Array) -> tuple[Array, Array, Array]:
        """Rows (R,), their sds (R,) and whitened sensitivities (R, L)."""
        count = len(self.moved)
        x = np.tile(self.x0, (count + 1, 1))
        steps = np.where(share < 0.5, STEP, -STEP)
        x[:, self.moved] = self.low[self.moved] + share * self.width[self.moved]
        x[np.arange(1, count + 1), self.moved] += steps * self.width[self.moved]
        mean, own = self.message.rows.response.evaluate(x)
        sd = np.sqrt(self.s2 + own[0] ** 2)
        return mean[0], sd, ((mean[1:] - mean[0]) / steps[:, None]).T / sd[:, None]

    def best(self, counts: Array, share: Array) -> tuple[Array, Array, Array, Array]:
        """The fit from `share` on, and the rows there, by Levenberg's and Marquardt's steps.

        counts  of each row: 1, or 0 where it is left out
        """

        def cost(share: Array, mean: Array, sd: Array) -> float:
            off = share - 0.5
            return float(counts @ ((self.y - mean) / sd) ** 2 + off @ self.information @ off)

        found, damped = self.at(share), 1e-3
        least = cost(share, *found[:2])
        for _ in range(TURNS if self.moved else 0):
            mean, sd, slope = found
            pull = slope.T @ (counts * (self.y - mean) / sd) - self.information @ (share - 0.5)
            bend = slope.T @ (counts[:, None] * slope) + self.information
            bend[np.diag_indices_from(bend)] *= 1.0 + damped
            there = np.clip(share + np.linalg.solve(bend, pull), 0.0, 1.0)
            tried = self.at(there)
            if (now := cost(there, *tried[:2])) <= least:
                step = float(np.max(np.abs(there - share)))
                share, found, least, damped = there, tried, now, 0.1 * damped
                if step < SETTLED:
                    break
            else:
                damped = max(30.0 * damped, 1e-2)
        return (share, *found)
