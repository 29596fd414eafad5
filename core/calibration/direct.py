"""A blade's message where a closed form answers: the formula itself at every shared node.

At each value of the shared parameters the rows are polynomials of the local ones alone, on boxes
that hold all but e^−40 of the message (`windows`); shared, known and dormant inputs enter exactly.
So a dormant parameter that is freed, rates over ten decades, a prior in log x cost no accuracy. The
message is the sum of the kernels' integrals over the boxes, and draws come from the boxes in
proportion to them.

The kernels take 16 nodes with common coefficients and each node's own factors; here every box has
coefficients of its own, and the factors only say which are whose.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from core.calibration import draws as drawing
from core.calibration import kernel
from core.calibration.at_nodes import AtNodes
from core.calibration.boxes import Boxes, Pieces, boxes, laid_out, picked
from core.calibration.layout import cut_offset
from core.calibration.message import PARTS, BladeMessage, prior_draws, side_by_side, split
from core.calibration.space import locals_of
from core.calibration.vector import LANES
from core.calibration.windows import Readings
from core.errors import CalibrationError, InputError
from core.surrogate.closed_form import FormulaRows

Array = NDArray[np.float64]
Index = NDArray[np.int64]
MOST_LOCAL = 3


class DirectMessage(BladeMessage):
    """The message of one blade's readings that a closed form answers."""

    smooth, cheap = False, True  # all nodes at once cost no more than a few of them

    @cached_property
    def _rows(self) -> FormulaRows:
        rows = self.rows.response
        assert isinstance(rows, FormulaRows)
        local = [p.name for p in locals_of(self.model, rows.names)]
        if len(local) > MOST_LOCAL:
            raise InputError(
                f"local parameters of {rows.model.name}",
                local,
                f"are more than {MOST_LOCAL}, which a closed form is integrated over",
                "declare some as shared, known or dormant",
            )
        unknown = [name for name in local if not rows.model.direction(name)]
        if unknown:
            raise InputError(
                f"local parameters of {rows.model.name}",
                unknown,
                "are not declared as rising or falling, so that no window can be bounded",
                "declare it (core.surrogate.closed_form), or make them shared",
            )
        return rows

    @cached_property
    def _local(self) -> tuple[list[int], Array, Array]:
        """Places of the local parameters among the rows' inputs, and their bounds (D,)."""
        names = self._rows.names
        at = [names.index(p.name) for p in locals_of(self.model, names)]
        return at, self._rows.low[at], self._rows.high[at]

    @property
    def offset(self) -> float:
        return sum(cut_offset(p) for p in locals_of(self.model, self._rows.names))

    @cached_property
    def _kept(self) -> AtNodes[Pieces]:
        return AtNodes()

    def column(self, unit: Array, rough: bool = False, parts: int = PARTS) -> Array:
        """log m_b at nodes `unit` (n, d) of the unit box, (n,)."""
        found = self._pieces(unit, parts)
        top = np.full(len(unit), -np.inf)
        np.maximum.at(top, found.boxes.node, found.sums)
        total = np.zeros(len(unit))
        np.add.at(total, found.boxes.node, np.exp(found.sums - top[found.boxes.node]))
        return top + np.log(total) + found.rest + self._constant

    @property
    def _constant(self) -> float:
        """Constants of the normal densities and of the uniform priors."""
        _, low, high = self._local
        return (
            self.offset
            - 0.5 * len(self._rows) * math.log(2 * math.pi)
            - float(np.sum(np.log(high - low)))
        )

    def draws(
        self,
        unit: Array,
        per_node: int,
        rng: np.random.Generator,
        column: Array,
        parts: int = PARTS,
    ) -> tuple[Array, Array]:
        """Weighted local parameters at each node; see `BladeMessage.draws`."""
        dim, n = len(self._local[0]), len(unit)
        found = self._pieces(unit, parts)
        shift = self._constant + (found.rest - column) - math.log(per_node)
        if dim == 0:
            log_w = np.repeat((shift + found.sums)[:, None], per_node, axis=1)
            return prior_draws(self.model, self.space, unit, per_node, rng)[0], log_w
        share = drawing.SHARE if dim == 3 else 1
        u = drawing.even_points(rng, n, per_node, share, dim)
        box, inside, log_share = picked(found, u[:, :, 3 - dim])
        u[:, :, 3 - dim] = inside
        used, place = np.unique(box, return_inverse=True)
        out, weight = self._drawn(found, used, box, u, dim, parts)
        flat = place.reshape(n, per_node)
        count = np.tile(np.arange(per_node), (n, 1))
        z = out[flat, count][:, :, 3 - dim :]
        a, b = found.boxes.low[box], found.boxes.high[box]
        values = a + 0.5 * (z + 1.0) * (b - a)
        log_w = weight[flat, count] + np.sum(np.log((b - a) / 2.0), axis=2) - log_share
        log_w += shift[:, None]
        if not np.all(log_w < np.inf):  # neither NaN nor an unbounded weight
            raise CalibrationError(
                f"{int(np.sum(~(log_w < np.inf)))} draws of a blade have no weight; its readings: "
                f"{self.rows.y.tolist()[:12]}"
            )
        every = locals_of(self.model)
        if dim == len(every):
            return values, log_w
        touched, (values, _) = values, prior_draws(self.model, self.space, unit, per_node, rng)
        values[:, :, [every.index(p) for p in locals_of(self.model, self._rows.names)]] = touched
        return values, log_w

    def _answered(self, unit: Array) -> tuple[Readings, Array]:
        """The formula at the nodes, as a function of the local parameters; and what moves with
        none of them."""
        rows, (at, _, _), x = self._rows, self._local, self.space.to_x(unit)
        base = np.empty((len(unit), len(rows.names)))
        for j, name in enumerate(rows.names):
            if name in self.space.names:
                base[:, j] = x[:, self.space.names.index(name)]
            elif j not in at:
                base[:, j] = self.fixed[name]

        def answer(node: Index, local: Array) -> Array:
            inputs = base[node]
            inputs[:, at] = local
            return rows.evaluate(inputs)[0]

        y, s2, rest = self.readings(unit)
        falling = np.array([rows.model.direction(rows.names[j]) < 0 for j in at], dtype=bool)
        labels = [
            f"the prior of {one}" if isinstance(one, str) else f"{one[0]} at {one[1]:g} h"
            for one in rows.asked
        ]
        return Readings(answer, y, s2, falling, labels), rest

    def _pieces(self, unit: Array, parts: int) -> Pieces:
        return self._kept.of(unit.tobytes(), lambda: self._made(unit, parts))

    def _made(self, unit: Array, parts: int) -> Pieces:
        _, low, high = self._local
        readings, rest = self._answered(unit)
        y, s2 = readings.y, readings.s2
        if not len(low):
            node = np.arange(len(unit))
            off = readings.answer(node, np.empty((len(unit), 0))) - y
            none, empty = np.empty((len(unit), 0)), np.empty((len(unit), len(self._rows), 0))
            sums = -0.5 * np.sum(off**2 / s2 + np.log(s2), axis=1)
            error = np.zeros((len(unit), len(self._rows)))
            return Pieces(Boxes(node, none, none, empty, empty, error), sums, y, s2, rest)
        made = boxes(readings, low, high)
        blocks = [
            laid_out(made, np.arange(i, i + LANES), y, s2) for i in range(0, len(made.node), LANES)
        ]
        dim, sums = len(low), np.empty((len(blocks), LANES))

        def work(part: slice) -> None:
            for k in range(part.start, part.stop):
                given, out = blocks[k], sums[k : k + 1]
                if dim == 3:
                    kernel.volume_messages(*given, 0, out)
                else:
                    (kernel.plane_messages if dim == 2 else kernel.line_messages)(*given, out)

        side_by_side(work, split(len(blocks), parts))
        size = np.sum(np.log((made.high - made.low) / 2.0), axis=1)
        return Pieces(made, sums.ravel()[: len(made.node)] + size, y, s2, rest)

    def _drawn(
        self, found: Pieces, entries: Index, box: Index, u: Array, dim: int, parts: int
    ) -> tuple[Array, Array]:
        """Draws (E, per_node, 3) of each box in `entries` and their log L / q on [-1, 1]^D.

        Only those are of use whose number stands in `box` (n, per_node); they get its points `u`.
        """
        per_node = u.shape[1]
        own = np.full((len(entries), per_node, 3), 0.5)
        node, count = np.nonzero(box >= 0)
        own[np.searchsorted(entries, box[node, count]), count] = u[node, count]
        n = -(-len(entries) // LANES)
        out, log_w = np.empty((n, LANES, per_node, 3)), np.empty((n, LANES, per_node))
        padded = np.concatenate([own, np.repeat(own[-1:], n * LANES - len(own), axis=0)])
        points = padded.reshape(n, LANES, per_node, 3)

        def work(part: slice) -> None:
            for k in range(part.start, part.stop):
                here = entries[np.minimum(np.arange(k * LANES, (k + 1) * LANES), len(entries) - 1)]
                given = laid_out(found.boxes, here, found.y, found.s2)
                one = slice(k, k + 1)
                if dim == 3:
                    kernel.volume_draws(*given, 1, points[one], out[one], log_w[one])
                else:
                    kernel.fewer_draws(*given, dim, points[one], out[one], log_w[one])

        side_by_side(work, split(n, parts))
        return out.reshape(-1, per_node, 3), log_w.reshape(-1, per_node)
