"""Runs of an archive at some of their nodes, in memory.

A contest goes through the same runs hundreds of times. Kept are a seeded sample of the nodes, over
which errors of fields are measured, and for each run the node with the largest CEEQ at the end. A
`Kept` is an archive of those nodes, so that targets are made of it as of any other; mean CEEQ is
there the mean over the nodes that are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive
from core.errors import InputError, ModelError
from core.rng import stream

Array = NDArray[np.float64]
NEEDED = ("ceeq", "displacement", "elongation")


@dataclass(frozen=True, slots=True)
class Kept(Archive):
    """indices: of the runs; nodes: which are kept, the first `sampled` of them the sample.

    worst    (n,) position in `nodes` of each run's largest CEEQ at the end
    x        inputs, (n, d);  arrays: of each quantity at the nodes kept, (n, T, …)
    """

    indices: tuple[int, ...]
    nodes: NDArray[np.int64]
    sampled: int
    worst: NDArray[np.int64]
    x: Array
    arrays: Mapping[str, NDArray[np.floating[Any]]]

    def stack(self, quantity: str, indices: Sequence[int]) -> NDArray[np.floating[Any]]:
        """One quantity of several runs, (n, T, …)."""
        return np.asarray(self.arrays[quantity][[self.indices.index(i) for i in indices]])

    @property
    def z(self) -> Array:
        """Inputs scaled to [-1, 1], (n, d)."""
        low = np.array([item.low for item in self.declaration.inputs])
        high = np.array([item.high for item in self.declaration.inputs])
        return np.asarray(2.0 * (self.x - low) / (high - low) - 1.0)

    @property
    def instants(self) -> Array:
        """The instants after the first one, at which errors are measured [h]."""
        return np.array(self.declaration.time_h)[1:]

    def truth(self, runs: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Of runs (positions): tip elongation (n, T), CEEQ (n, T, R), deformation (n, T, 3 R)."""

        def of(quantity: str) -> Array:
            return np.asarray(self.arrays[quantity][runs], dtype=float)

        tip, ceeq = of("elongation")[:, 1:], of("ceeq")[:, 1:]
        moved = of("displacement")
        moved = moved[:, 1:] - moved[:, :1]
        return tip, ceeq, moved.reshape(*moved.shape[:2], -1)


def keep(
    archive: Archive,
    runs: Sequence[int],
    *,
    nodes: int,
    seed: int,
    progress: Callable[[int], None] = lambda done: None,
) -> Kept:
    """Read the runs; one at a time is whole in memory."""
    declared = archive.declaration
    names = {quantity.name for quantity in declared.quantities}
    if missing := [name for name in NEEDED if name not in names]:
        raise ModelError(
            f"{archive.path} has no {', '.join(missing)}: the contest needs {', '.join(NEEDED)}"
        )
    if absent := sorted(set(runs) - set(archive.done())):
        raise InputError(
            "runs", absent[:5], f"are not in {archive.path.name}", "finish the archive first"
        )
    if nodes < 1:
        raise InputError("nodes", nodes, "are none", "keep one or more")
    sample = stream(seed, "contest-nodes").permutation(declared.nodes)[:nodes]
    last = [archive.stack("ceeq", [run])[0, -1] for run in runs]
    hottest = np.array([int(np.argmax(row)) for row in last])
    chosen = np.concatenate([np.sort(sample), np.setdiff1d(hottest, sample)]).astype(np.int64)
    place = {int(node): at for at, node in enumerate(chosen)}
    rows: dict[str, list[Any]] = {quantity.name: [] for quantity in declared.quantities}
    for done, run in enumerate(runs, 1):
        read = archive.read(run).values
        for quantity in declared.quantities:
            values = read[quantity.name]
            rows[quantity.name].append(values if quantity.kind == "scalar" else values[:, chosen])
        progress(done)
    return Kept(
        archive.path,
        declared,
        tuple(runs),
        chosen,
        len(sample),
        np.array([place[int(node)] for node in hottest]),
        archive.inputs(runs),
        {name: np.stack(some) for name, some in rows.items()},
    )
