"""Which local parameters of a blade are thin and which broad, and where each monomial goes.

*Thin* ones t are those along which the readings fix the rest to a bell narrower than the box. A
blade's rows are polynomials of all local parameters; once the *broad* ones f are fixed they are
polynomials of the thin ones, and the tables here say how the one becomes the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from core.monomials import multi_indices

Array = NDArray[np.float64]
Index = NDArray[np.int64]
THIN = 4.0  # curvature, on the box [−1, 1], from which a parameter may be thin


@dataclass(frozen=True, slots=True)
class Split:
    """Broad and thin parameters, and where each monomial of the rows goes."""

    broad: tuple[int, ...]
    thin: tuple[int, ...]
    place: Index
    starts: Index
    rise: tuple[Index, Index]
    tables: tuple[Index, Index, Index, Index]

    @property
    def options(self) -> tuple[object, ...]:
        """What the compiled functions need of it."""
        return self.place, self.starts, self.rise, self.tables


def _ladder(table: Index) -> tuple[Index, Index, Index]:
    """For each monomial a lower one and the variable between; and by variable the lower one."""
    where = {tuple(e): q for q, e in enumerate(table.tolist())}
    parent, var = np.zeros(len(table), np.int64), np.zeros(len(table), np.int64)
    down = np.zeros_like(table)
    for q, e in enumerate(table.tolist()):
        for j in range(len(e)):
            if e[j]:
                lower = where[(*e[:j], e[j] - 1, *e[j + 1 :])]
                down[q, j] = parent[q] = lower
                var[q] = j
    return parent, var, down


@lru_cache(maxsize=64)
def split_of(exponents: bytes, places: int, thin: tuple[int, ...]) -> Split:
    """The split for local exponents (M, places), as bytes, and the thin places."""
    table = np.frombuffer(exponents, dtype=np.int64).reshape(-1, places)
    broad = tuple(j for j in range(places) if j not in thin)
    degree = int(table.sum(axis=1).max())
    of_f, of_t = multi_indices(len(broad), degree), multi_indices(len(thin), degree)
    left = degree - of_t.sum(axis=1)
    many = np.array([int(np.sum(of_f.sum(axis=1) <= n)) for n in left])
    starts = np.concatenate([[0], np.cumsum(many)]).astype(np.int64)
    where_f = {tuple(e): q for q, e in enumerate(of_f.tolist())}
    where_t = {tuple(e): q for q, e in enumerate(of_t.tolist())}
    place = np.array(
        [
            starts[where_t[tuple(t)]] + where_f[tuple(f)]
            for f, t in zip(
                table[:, list(broad)].tolist(), table[:, list(thin)].tolist(), strict=True
            )
        ],
        dtype=np.int64,
    )
    parent_f, var_f, _ = _ladder(of_f)
    parent_t, var_t, down = _ladder(of_t)
    return Split(
        broad, thin, place, starts, (parent_f, var_f), (parent_t, var_t, of_t.copy(), down)
    )


def pivots(curvature: Array) -> tuple[list[int], list[float]]:
    """Parameters by falling curvature, as long as it stays above `THIN`, and the curvatures.

    After a pivot, what is left of (D, D) is the curvature of the others once that one adapts.
    """
    left, found, values = curvature.copy(), list[int](), list[float]()
    for _ in range(len(left)):
        rest = np.where(np.isin(np.arange(len(left)), found), -np.inf, np.diag(left))
        j = int(np.argmax(rest))
        if found and rest[j] < THIN:
            break
        found.append(j)
        values.append(float(rest[j]))
        left = left - np.outer(left[:, j], left[j]) / left[j, j]
    return found, values
