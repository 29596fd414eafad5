r"""Cholesky's factor of a structured mesh's stiffness, by nested dissection.

A plane of nodes between elements cuts the mesh in two halves that know each other through it
alone. Halves are cut again until few nodes are left, and unknowns are eliminated from the leaves
of this tree up to its root: the factor then has O(n log n) entries on a shell-like body (A. George,
SIAM J. Numer. Anal. 10 (1973) 345). Each part is a dense front of its own unknowns o and of those
b that touch it and come later (multifrontal; I. S. Duff, J. K. Reid, ACM TOMS 9 (1983) 302),

    [ F_oo  F_bo^T ]      L_oo = chol(F_oo),  L_bo = F_bo L_oo^-T,
    [ F_bo  F_bb   ]      F_bb - L_bo L_bo^T   goes to the part above.

A creep run solves with one factor hundreds of times, and a solution reads the factor twice: what
counts is its size. Measured on mesh "paper" (81,148 unknowns, one thread of a busy EPYC), beside
SuperLU under minimum degree: see `tests/benchmarks/bench_solver.py` and its figures below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import blas, lapack

from core.blade.element import Array, Index
from core.compiled import compiled, contracted
from core.errors import InputError, ModelError

LEAF = 24
"""Nodes of a part that is not cut any more."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A part of the tree: its own nodes, and the numbers of the parts below it."""

    nodes: Index
    below: tuple[int, ...]


def dissect(lattice: Index, closed: int = 0, leaf: int = LEAF) -> list[Part]:
    """Parts of a structured mesh, each after those below it; the last one is the root.

    lattice  (N, 3) whole coordinates of the nodes, even on the borders of elements
    closed   period of the first coordinate, if it runs around

    >>> line = np.stack([np.arange(9), np.zeros(9, int), np.zeros(9, int)], axis=1)
    >>> [part.nodes.tolist() for part in dissect(line, leaf=2)][-1]
    [4]
    """
    parts: list[Part] = []

    def add(nodes: Index, *below: int) -> int:
        parts.append(Part(nodes, below))
        return len(parts) - 1

    def cut(nodes: Index) -> int:
        at = lattice[nodes]
        low, high = at.min(axis=0), at.max(axis=0)
        middle = 2 * ((low + high + 2) // 4)
        inside = (low < middle) & (middle < high)
        on = at == middle
        size = np.where(inside, on.sum(axis=0), len(nodes) + 1)
        axis = int(size.argmin())
        if len(nodes) <= leaf or not inside[axis]:
            return add(nodes)
        left, right = at[:, axis] < middle[axis], at[:, axis] > middle[axis]
        return add(nodes[on[:, axis]], cut(nodes[left]), cut(nodes[right]))

    every = np.arange(len(lattice))
    if closed:
        half = 2 * (closed // 4)
        first = lattice[:, 0]
        between = (first > 0) & (first < half), first > half
        add(every[(first == 0) | (first == half)], *(cut(every[one]) for one in between))
    else:
        cut(every)
    return parts


class Factor:
    """L of a symmetric positive definite matrix (n, n), ready to solve.

    unknowns  the parts' own unknowns, each part after those below it, together 0 … n - 1
    below     for each part the numbers of the parts below it
    """

    def __init__(
        self, matrix: sparse.csr_matrix, unknowns: list[Index], below: list[tuple[int, ...]]
    ) -> None:
        self._order = np.concatenate(unknowns)
        ends = np.cumsum([len(own) for own in unknowns])
        starts = ends - [len(own) for own in unknowns]
        rows = matrix[self._order][:, self._order].tocsr()
        rows.sort_indices()
        later = _later(rows, starts, ends, below)
        wide, high = ends - starts, np.array([len(one) for one in later])
        self._at = np.stack([starts, ends], axis=1)
        self._later_at = np.concatenate([[0], np.cumsum(high)])
        self._later = np.concatenate([*later, np.zeros(0, dtype=np.int64)])
        self._data_at = np.concatenate([[0], np.cumsum(wide * (wide + high))])
        self._data = np.empty(self._data_at[-1])
        self._work = np.empty(int((wide + high).max()))
        self._factorise(rows, later, below)

    @property
    def entries(self) -> int:
        """Stored numbers."""
        return len(self._data)

    def solve(self, load: Array) -> Array:
        """The solution (n,) for a load (n,)."""
        x = load[self._order].astype(np.float64)
        _solve(self._at, self._later_at, self._later, self._data_at, self._data, self._work, x)
        out = np.empty_like(x)
        out[self._order] = x
        return out

    def _factorise(
        self, rows: sparse.csr_matrix, later: list[Index], below: list[tuple[int, ...]]
    ) -> None:
        waiting: dict[int, Array] = {}
        for number, (start, end) in enumerate(self._at):
            wide, behind = end - start, later[number]
            high = len(behind)
            own = np.zeros((wide, wide), order="F")
            side = np.zeros((high, wide), order="F")
            rest = np.zeros((high, high), order="F")
            _assemble(rows.indptr, rows.indices, rows.data, start, end, behind, own, side)
            index = np.concatenate([np.arange(start, end), behind])
            for child in below[number]:
                place = np.searchsorted(index, later[child])
                _extend(waiting.pop(child), place, own, side, rest)
            factor, info = lapack.dpotrf(own, lower=1, clean=0, overwrite_a=1)
            if info:
                raise ModelError(
                    f"the stiffness is not positive definite (unknown {start + info - 1} of "
                    f"{len(self._order)}): the blade is not held, or an element is folded"
                )
            if high:
                side = blas.dtrsm(1.0, factor, side, side=1, lower=1, trans_a=1, overwrite_b=1)
                rest = blas.dsyrk(-1.0, side, beta=1.0, c=rest, lower=1, overwrite_c=1)
                waiting[number] = rest
            first, last = self._data_at[number], self._data_at[number + 1]
            panel = self._data[first:last].reshape((wide, wide + high)).T
            panel[:wide], panel[wide:] = factor, side
            panel[np.arange(wide), np.arange(wide)] = 1 / factor.diagonal()


def _later(
    rows: sparse.csr_matrix, starts: Index, ends: Index, below: list[tuple[int, ...]]
) -> list[Index]:
    """For each part the unknowns behind its own that its front touches, ascending."""
    found: list[Index] = []
    for start, end, children in zip(starts, ends, below, strict=True):
        above = [found[child] for child in children]
        if any(len(one) and one[0] < start for one in above):
            raise InputError(
                "parts", len(starts), "do not separate the mesh", "cut along borders of elements"
            )
        touched = [rows.indices[rows.indptr[start] : rows.indptr[end]], *above]
        every = np.unique(np.concatenate(touched)).astype(np.int64)
        found.append(every[every >= end])
    return found


@compiled
def _assemble(
    pointer: Index,
    column: Index,
    value: Array,
    start: int,
    end: int,
    behind: Index,
    own: Array,
    side: Array,
) -> None:
    """The matrix's entries of the rows start … end - 1 into a front's lower triangle."""
    for row in range(start, end):
        for k in range(pointer[row], pointer[row + 1]):
            at = column[k]
            if at >= end:
                side[np.searchsorted(behind, at), row - start] = value[k]
            elif at >= row:
                own[at - start, row - start] = value[k]


@compiled
def _extend(update: Array, place: Index, own: Array, side: Array, rest: Array) -> None:
    """Add a lower triangle from below to the front; `place` (ascending) are its rows there."""
    wide = own.shape[0]
    for j in range(len(place)):
        column = place[j]
        for i in range(j, len(place)):
            row = place[i]
            if row < wide:
                own[row, column] += update[i, j]
            elif column < wide:
                side[row - wide, column] += update[i, j]
            else:
                rest[row - wide, column - wide] += update[i, j]


@contracted
def _solve(
    at: Index,
    later_at: Index,
    later: Index,
    data_at: Index,
    data: Array,
    work: Array,
    x: Array,
) -> None:
    """x := L^-T L^-1 x. Panels by columns, four at a time: the work is in reading them."""
    parts = at.shape[0]
    for p in range(parts):
        start, wide = at[p, 0], at[p, 1] - at[p, 0]
        behind = later[later_at[p] : later_at[p + 1]]
        rows = wide + len(behind)
        work[:wide] = x[start : start + wide]
        work[wide:rows] = 0.0
        panel, j = data[data_at[p] : data_at[p + 1]], 0
        while j + 4 <= wide:
            a, b = panel[j * rows : (j + 1) * rows], panel[(j + 1) * rows : (j + 2) * rows]
            c, d = panel[(j + 2) * rows : (j + 3) * rows], panel[(j + 3) * rows : (j + 4) * rows]
            t0 = work[j] * a[j]
            t1 = (work[j + 1] - t0 * a[j + 1]) * b[j + 1]
            t2 = (work[j + 2] - t0 * a[j + 2] - t1 * b[j + 2]) * c[j + 2]
            t3 = work[j + 3] - t0 * a[j + 3] - t1 * b[j + 3] - t2 * c[j + 3]
            t3 *= d[j + 3]
            work[j], work[j + 1], work[j + 2], work[j + 3] = t0, t1, t2, t3
            for i in range(j + 4, rows):
                work[i] -= t0 * a[i] + t1 * b[i] + t2 * c[i] + t3 * d[i]
            j += 4
        while j < wide:
            a = panel[j * rows : (j + 1) * rows]
            t0 = work[j] * a[j]
            work[j] = t0
            for i in range(j + 1, rows):
                work[i] -= t0 * a[i]
            j += 1
        x[start : start + wide] = work[:wide]
        for i in range(len(behind)):
            x[behind[i]] += work[wide + i]
    for p in range(parts - 1, -1, -1):
        start, wide = at[p, 0], at[p, 1] - at[p, 0]
        behind = later[later_at[p] : later_at[p + 1]]
        rows = wide + len(behind)
        work[:wide] = x[start : start + wide]
        for i in range(len(behind)):
            work[wide + i] = x[behind[i]]
        panel, j = data[data_at[p] : data_at[p + 1]], wide
        while j % 4:
            j -= 1
            a, s0 = panel[j * rows : (j + 1) * rows], 0.0
            for i in range(j + 1, rows):
                s0 += a[i] * work[i]
            work[j] = (work[j] - s0) * a[j]
        while j > 0:
            j -= 4
            a, b = panel[j * rows : (j + 1) * rows], panel[(j + 1) * rows : (j + 2) * rows]
            c, d = panel[(j + 2) * rows : (j + 3) * rows], panel[(j + 3) * rows : (j + 4) * rows]
            s0 = s1 = s2 = s3 = 0.0
            for i in range(j + 4, rows):
                s0 += a[i] * work[i]
                s1 += b[i] * work[i]
                s2 += c[i] * work[i]
                s3 += d[i] * work[i]
            t3 = (work[j + 3] - s3) * d[j + 3]
            t2 = (work[j + 2] - s2 - c[j + 3] * t3) * c[j + 2]
            t1 = (work[j + 1] - s1 - b[j + 2] * t2 - b[j + 3] * t3) * b[j + 1]
            t0 = (work[j] - s0 - a[j + 1] * t1 - a[j + 2] * t2 - a[j + 3] * t3) * a[j]
            work[j], work[j + 1], work[j + 2], work[j + 3] = t0, t1, t2, t3
        x[start : start + wide] = work[:wide]
