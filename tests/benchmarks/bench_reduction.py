"""Memory and time of the out-of-core reduction at the paper's size, without its archive.

    OPENBLAS_NUM_THREADS=1 python tests/benchmarks/bench_reduction.py [RUNS] [NODES] [PASSES]

RUNS (66) rows of NODES (27,360) × 54 instants × 6 quantities are made up block by block, with
singular values that fall by half each; a basis of 32 features is found in PASSES (4) passes.
Prints processor seconds, the peak memory (MB), what memory the rows would take (MB), and the
largest relative error of the first 12 singular values.
"""

from __future__ import annotations

import json
import resource
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from time import process_time

import numpy as np

from core.reduction.streamed import streamed_svd

FALL = 0.5
RANK = 32


@dataclass(frozen=True)
class MadeUp:
    """Rows u_k s_k v_k^T, the v_k being parts of one long cosine series (orthogonal)."""

    runs: int
    columns: int
    each: int = 4

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n)."""
        return self.runs, self.columns

    def blocks(self) -> Iterator[np.ndarray]:
        """A few rows at a time."""
        modes = 24
        u, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((self.runs, modes)))
        phase = np.pi * (np.arange(self.columns) + 0.5) / self.columns
        for first in range(0, self.runs, self.each):
            block = np.zeros((min(self.each, self.runs - first), self.columns))
            for k in range(modes):
                wave = np.cos((k + 1) * phase) * np.sqrt(2 / self.columns)
                for row, weight in zip(block, u[first : first + self.each, k], strict=True):
                    row += weight * FALL**k * wave
            yield block


def main(runs: int, nodes: int, passes: int) -> dict[str, float]:
    """Measure."""
    rows = MadeUp(runs, nodes * 54 * 6)
    start = process_time()
    _, basis = streamed_svd(rows, RANK, 1, iterations=passes // 2 - 1, dtype=np.float32)
    wanted = FALL ** np.arange(12)
    return {
        "seconds": round(process_time() - start, 1),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "rows_mb": round(8 * runs * rows.columns / 2**20),
        "error": float(np.abs(basis.singular[:12] / wanted - 1).max()),
    }


if __name__ == "__main__":
    words = [*sys.argv[1:], *["66", "27360", "4"][len(sys.argv) - 1 :]]
    print(json.dumps(main(*map(int, words))))
