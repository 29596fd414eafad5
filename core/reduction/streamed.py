r"""Randomised singular value decomposition of a matrix that does not fit into memory.

A (m, n) has few rows, the runs, of very many columns, and is read a few rows at a time. The row
space is what is wanted, so A^T is sampled:

    Y = A^T Omega           Omega (m, l) Gaussian, Y (n, l) a sum over the rows         one pass
    Q = orth(Y)             in place, by blocks
    C = A Q                 (m, l), row by row                                          one pass
    A ~ C Q^T,   C = U S W^T,   modes = Q W

Each power iteration puts Y = A^T orth(C) and a new Q in between, two passes more (N. Halko, P. G.
Martinsson, J. A. Tropp, SIAM Review 53 (2011) 217, algorithms 4.4 and 5.1, for A^T). Two passes
are exact where l reaches m. What is in memory are l = rank + oversample columns of n numbers and
the rows at hand: nothing grows with m but Omega and C.

orth is a QR decomposition by blocks of rows (TSQR): R of [R; block] from block to block, Q = Y R^-1
through the singular values of R, directions below rounding error left out, and all of it once
more, which makes Q orthonormal to rounding error of its own precision.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.reduction.dense import OVERSAMPLE, Basis, Floats
from core.rng import stream

Array = NDArray[np.float64]
BLOCK = 16_384  # columns of A that are worked on at a time
ITERATIONS = 1


class Rows(Protocol):
    """A matrix (m, n) that is read from its first row to its last, as often as asked for."""

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n)."""
        ...

    def blocks(self) -> Iterator[Floats]:
        """Its rows in order, a few at a time, (k, n)."""
        ...


@dataclass(frozen=True, slots=True)
class InMemory:
    """A matrix in memory as rows, `each` at a time."""

    matrix: Floats
    each: int = 4

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n)."""
        return self.matrix.shape[0], self.matrix.shape[1]

    def blocks(self) -> Iterator[Floats]:
        """Its rows."""
        for k in range(0, len(self.matrix), self.each):
            yield self.matrix[k : k + self.each]


def streamed_svd(
    rows: Rows,
    rank: int,
    seed: int,
    *,
    oversample: int = OVERSAMPLE,
    iterations: int = ITERATIONS,
    dtype: type[np.floating[Any]] = np.float64,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Array, Basis]:
    """U (m, r) and the basis of A's leading r = min(rank, rank of A) right vectors.

    dtype     of the l columns that are kept; sums are taken in double precision
    progress  called with (passes done, passes)

    >>> a = np.outer([3.0, 4.0], [1.0, 0.0, 0.0])
    >>> u, basis = streamed_svd(InMemory(a), 1, seed=1)
    >>> basis.singular.round(12).tolist(), abs(basis.modes.T).round(12).tolist()
    ([5.0], [[1.0, 0.0, 0.0]])
    """
    m, n = rows.shape
    if rank < 1 or m < 1 or n < 1:
        raise InputError("rank", rank, f"does not fit shape {(m, n)}", "give rows, rank 1+")
    width = min(rank + oversample, m, n)
    exact = width == m
    times = 0 if exact else iterations
    passes, done = 2 + 2 * times, 0
    omega = stream(seed, "streamed-svd", m, width).standard_normal((m, width))
    if exact:
        omega = np.eye(m)

    def told() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, passes)

    basis, total = _sampled(rows, omega, dtype)
    told()
    basis = _orthonormal(basis)
    for _ in range(times):
        code = _coded(rows, basis)
        told()
        del basis
        basis, _ = _sampled(rows, np.linalg.qr(code)[0], dtype)
        told()
        basis = _orthonormal(basis)
    code = _coded(rows, basis)
    told()
    u, s, wt = np.linalg.svd(code, full_matrices=False)
    keep = min(rank, len(s))
    _times(basis, wt.T)
    return u[:, :keep], Basis(basis[:, :keep], s[:keep], total)


def _sampled(rows: Rows, omega: Array, dtype: type[np.floating[Any]]) -> tuple[Floats, float]:
    """A^T omega (n, l), and the squared Frobenius norm of A."""
    n, width = rows.shape[1], omega.shape[1]
    sampled = np.zeros((n, width), dtype=dtype)
    total, at = 0.0, 0
    for block in rows.blocks():
        weight = omega[at : at + len(block)]
        at += len(block)
        for part in _parts(n):
            here = np.asarray(block[:, part], dtype=np.float64)
            total += float(np.vdot(here, here))
            sampled[part] += here.T @ weight
    _whole(rows, at)
    return sampled, total


def _coded(rows: Rows, basis: Floats) -> Array:
    """A basis (m, l)."""
    code = []
    for block in rows.blocks():
        sums = np.zeros((len(block), basis.shape[1]))
        for part in _parts(basis.shape[0]):
            sums += np.asarray(block[:, part], np.float64) @ np.asarray(basis[part], np.float64)
        code.append(sums)
    _whole(rows, sum(map(len, code)))
    return np.concatenate(code)


def _orthonormal(y: Floats) -> Floats:
    """An orthonormal basis of y's columns, in y's memory; fewer columns where they depend."""
    for _ in range(2):
        triangle: Array = np.zeros((0, y.shape[1]))
        for part in _parts(len(y)):
            both = np.vstack([triangle, y[part].astype(np.float64)])
            triangle = np.asarray(np.linalg.qr(both, mode="r"))
        _, s, vt = np.linalg.svd(triangle, full_matrices=False)
        floor = 10 * np.finfo(y.dtype).eps * np.sqrt(y.shape[1]) * s[0] if len(s) else 0.0
        keep = int(np.count_nonzero(s > floor))
        if keep == 0:
            raise InputError("rows", 0.0, "are all zero", "give rows that differ from zero")
        _times(y, vt[:keep].T / s[:keep])
        y = y[:, :keep]
    return y


def _times(y: Floats, matrix: Array) -> None:
    """y[:, :k] := y matrix (l, k), in place."""
    for part in _parts(len(y)):
        y[part, : matrix.shape[1]] = y[part].astype(np.float64) @ matrix


def _parts(n: int) -> Iterator[slice]:
    for k in range(0, n, BLOCK):
        yield slice(k, k + BLOCK)


def _whole(rows: Rows, count: int) -> None:
    if count != rows.shape[0]:
        raise InputError("rows", count, f"are not the {rows.shape[0]} told", "read all rows anew")
