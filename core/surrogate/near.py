"""The last of a correlation in one pass, for processes that calibrate (`core.surrogate.kernel`).

Each number goes through the same operations as by arrays, so that no bit differs.
"""

from __future__ import annotations

from core.compiled import compiled


@compiled
def nearness(half):  # type: ignore[no-untyped-def]
    """1 / (1 + max(half, 0)) in place, of half squared distances (n, m)."""
    for i in range(half.shape[0]):
        for j in range(half.shape[1]):
            value = half[i, j]
            half[i, j] = 1.0 / ((0.0 if value < 0.0 else value) + 1.0)
