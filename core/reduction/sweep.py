"""What a basis loses of runs, rank by rank and quantity by quantity.

A row a has the code c = V^T a, and its first r coefficients lose a - sum_{k<=r} c_k v_k. Of the
columns q of one quantity that is, squared,

    |a_q|² - 2 c·h_q + c·G_q c,     h_q = V_q^T a_q,   G_q = V_q^T V_q,     cut to the first r,

so that all ranks are one product for each run. What is lost below 1e-7 is not told. Errors are
those of the numbers themselves:

    lost(r)   sum of squares of what is lost, per run and quantity
    error     sqrt(sum of lost / sum of x²): relative to the quantity's root mean square
    spread    the same relative to x - mean: 1 says that the mean run is as good
    rmse      sqrt(sum of lost / count)

The paper tells one number for all quantities together, the root-mean-square error over every
number of every quantity, whatever its unit, beside the mean magnitude of these numbers:
`paper_rmse` and `paper_magnitude`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.reduction.dense import Basis
from core.reduction.runs import Part, RunRows
from core.reduction.streamed import BLOCK

Array = NDArray[np.float64]
EPS = 1e-14


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Sums over each run's numbers of each quantity, in the quantity's unit squared.

    ranks      (R,) ascending
    lost       (runs, parts, R)
    square     (runs, parts) of x
    centred    (runs, parts) of x - mean
    magnitude  (runs, parts) sum of |x|
    """

    parts: tuple[Part, ...]
    ranks: tuple[int, ...]
    lost: Array
    square: Array
    centred: Array
    magnitude: Array

    def _sizes(self) -> Array:
        return np.array([float(p.columns.stop - p.columns.start) for p in self.parts])

    @property
    def error(self) -> Array:
        """(parts, R), relative to the root mean square."""
        return np.asarray(np.sqrt(self.lost.sum(axis=0) / self.square.sum(axis=0)[:, None]))

    @property
    def spread(self) -> Array:
        """(parts, R), relative to the spread about the mean run."""
        return np.asarray(np.sqrt(self.lost.sum(axis=0) / self.centred.sum(axis=0)[:, None]))

    @property
    def rmse(self) -> Array:
        """(parts, R) in the quantities' units."""
        return np.asarray(np.sqrt(self.lost.mean(axis=0) / self._sizes()[:, None]))

    @property
    def worst(self) -> Array:
        """(parts, R): the error of the run that is reconstructed worst."""
        return np.asarray(np.sqrt(self.lost / self.square[:, :, None]).max(axis=0))

    @property
    def overall(self) -> Array:
        """(R,): root mean square of the quantities' errors."""
        return np.asarray(np.sqrt((self.error**2).mean(axis=0)))

    @property
    def paper_rmse(self) -> Array:
        """(R,), all quantities in one, whatever their units."""
        return np.asarray(np.sqrt(self.lost.sum(axis=1).mean(axis=0) / self._sizes().sum()))

    @property
    def paper_magnitude(self) -> float:
        """Mean |x| over all quantities in one."""
        return float(self.magnitude.sum(axis=1).mean() / self._sizes().sum())


def sweep(
    rows: RunRows,
    basis: Basis,
    ranks: Sequence[int],
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Reconstruct each run of `rows` with the first r modes, for every r of `ranks`."""
    most = basis.modes.shape[1]
    chosen = tuple(sorted(set(ranks)))
    if not chosen or chosen[0] < 1 or chosen[-1] > most:
        raise InputError("ranks", list(ranks), f"are not in 1 … {most}", "ask for what there is")
    if basis.modes.shape[0] != rows.shape[1]:
        raise InputError(
            "basis", basis.modes.shape, f"does not fit rows of {rows.shape[1]}", "use its own rows"
        )
    parts, count = rows.parts, 0
    gram = np.zeros((len(parts), most, most))
    for p, here in _pieces(parts):
        modes = np.asarray(basis.modes[here], dtype=np.float64)
        gram[p] += modes.T @ modes
    lost, sums = list[Array](), list[Array]()
    for block in rows.blocks():
        share = np.zeros((len(parts), len(block), most))
        own = np.zeros((3, len(block), len(parts)))
        for p, here in _pieces(parts):
            values = block[:, here]
            share[p] += values @ np.asarray(basis.modes[here], dtype=np.float64)
            raw = rows.mean[here] + rows.scale[p] * values
            own[0, :, p] += np.einsum("kn,kn->k", raw, raw)
            own[1, :, p] += rows.scale[p] ** 2 * np.einsum("kn,kn->k", values, values)
            own[2, :, p] += np.abs(raw).sum(axis=1)
        left = np.empty((len(block), len(parts), len(chosen)))
        for k, r in enumerate(chosen):
            code, first = share.sum(axis=0)[:, :r], gram[:, :r, :r]
            kept = 2 * np.einsum("kr,pkr->kp", code, share[:, :, :r])
            kept -= np.einsum("kr,prs,ks->kp", code, first, code)
            left[:, :, k] = own[1] - rows.scale**2 * kept
        # below the rounding error of the sums nothing is known
        lost.append(np.maximum(left, EPS * own[1][:, :, None]))
        sums.append(own)
        count += len(block)
        if progress is not None:
            progress(count, len(rows.indices))
    square, centred, magnitude = np.concatenate(sums, axis=1)
    return Sweep(parts, chosen, np.concatenate(lost), square, centred, magnitude)


def _pieces(parts: Sequence[Part]) -> Any:
    """Every quantity's columns, a block at a time."""
    for p, part in enumerate(parts):
        for start in range(part.columns.start, part.columns.stop, BLOCK):
            yield p, slice(start, min(start + BLOCK, part.columns.stop))


def rank_for(values: Sequence[float], ranks: Sequence[int], below: float) -> int | None:
    """The smallest rank from which on values are at or below a bound; none: not among these.

    >>> rank_for([0.2, 0.009, 0.03, 0.004, 0.002], [1, 5, 10, 20, 30], 0.01)
    20
    """
    found = None
    for value, rank in zip(reversed(values), reversed(ranks), strict=True):
        if value > below:
            break
        found = rank
    return found
