"""What all contestants learn: features of one joint singular value decomposition.

Each part y_p of the runs (`core.surrogate.targets`) is put in Tucker form, with coefficients c_p.
The coefficients of all parts, each part divided by the root s_p of its total variance, stand side
by side, and their singular value decomposition gives the features:

    [ (c_1 - mean) / s_1 | (c_2 - mean) / s_2 | … ]  =  f V^T,    f (n, F),

so that F numbers a run predict every quantity, node and instant together, as in the published
method (20 features of six quantities there). Since Tucker modes are orthonormal this is the joint
decomposition of the scaled fields themselves. Two sets of targets are put to the contest:

    ``raw``          every quantity as it is; of the displacement the field at 0+ and what follows
    ``transformed``  as the surrogate learns them: logarithms of rates, shares of mean CEEQ
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.surrogate.contest.kept import Kept
from core.surrogate.fitting import RANKS
from core.surrogate.targets import DEFORMATION, MEAN_CEEQ, Form, Target, invert, targets_of
from core.surrogate.tucker import Factors, factorise

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
SETS = ("raw", "transformed")


def targets(kept: Kept, which: str) -> dict[str, Target]:
    """The parts of one of the two sets, of all runs, by name."""
    if which not in SETS:
        raise InputError("set", which, "is unknown", f"use one of {', '.join(SETS)}")
    made = {one[0].name: one[0] for one in targets_of(kept, kept.indices)}
    if which == "transformed":
        return made
    time = np.array(kept.declaration.time_h)
    del made[MEAN_CEEQ]
    tip, _, moved = kept.truth(np.arange(len(kept.indices)))
    for name in made:
        if name == DEFORMATION:
            made[name] = Target(name, "raw", time[1:], moved)
        elif name == "elongation":
            made[name] = Target(name, "raw", time[1:], tip[:, :, None])
        elif made[name].form != "raw":
            values = np.asarray(kept.arrays[name], dtype=float)
            made[name] = Target(name, "raw", time, values.reshape(*values.shape[:2], -1))
    return made


@dataclass(frozen=True, slots=True)
class Features:
    """The joint decomposition of the parts of some runs.

    parts    form, factors, own columns of the joined coefficients and scale s_p, by name
    mean     of the joined, scaled coefficients, (C,);  vectors: V, (C, F)
    held     share of the joined variance in the F features
    """

    parts: Mapping[str, tuple[Form, Factors, slice, float]]
    mean: Array
    vectors: Array
    held: float

    @classmethod
    def of(
        cls, parts: Mapping[str, Target], runs: Rows, count: int, seed: int
    ) -> tuple[Features, Array]:
        """Features of the runs (positions), `count` at most; and their values (n, F)."""
        made: dict[str, tuple[Form, Factors, slice, float]] = {}
        joined: list[Array] = []
        start = 0
        for name, target in parts.items():
            factors, c = reduced(replace(target, values=target.values[runs]), seed)
            scale = max(float(np.sqrt(np.sum(np.var(c, axis=0)))), np.finfo(float).tiny)
            made[name] = target.form, factors, slice(start, start + c.shape[1]), scale
            joined.append(c / scale)
            start += c.shape[1]
        every = np.hstack(joined)
        mean = every.mean(axis=0)
        _, s, vt = np.linalg.svd(every - mean, full_matrices=False)
        keep = min(count, len(runs) - 1, int(np.sum(s > 1e-12 * s[0])))
        vectors = np.ascontiguousarray(vt[:keep].T)
        f = (every - mean) @ vectors
        held = float(np.sum(s[:keep] ** 2) / np.sum(s**2))
        return cls(made, mean, vectors, held), f

    def encode(self, parts: Mapping[str, Target], runs: Rows) -> Array:
        """Features (n, F) of runs (positions) that need not be among those of the bases."""
        own = self.parts.items()
        joined = [factors.encode(parts[n].values[runs]) / s for n, (_, factors, _, s) in own]
        return np.asarray((np.hstack(joined) - self.mean) @ self.vectors)

    def values(self, f: Array, names: Sequence[str]) -> dict[str, Array]:
        """Targets g (n, T', R') of features (n, F)."""
        joined = self.mean + f @ self.vectors.T
        out = {}
        for name in names:
            _, factors, columns, scale = self.parts[name]
            rows = np.arange(len(factors.space))
            out[name] = factors.decode(scale * joined[:, columns], factors.time_h, rows)
        return out

    def physical(self, f: Array, instants: Array) -> tuple[Array, Array, Array]:
        """Tip elongation (n, T), CEEQ (n, T, R), deformation (n, T, 3 R) at the later instants."""
        scaled = MEAN_CEEQ in self.parts
        names = ["elongation", "ceeq", DEFORMATION, *([MEAN_CEEQ] if scaled else [])]
        got = self.values(f, names)
        mean = None
        if scaled:
            mean = invert(self.parts[MEAN_CEEQ][0], got[MEAN_CEEQ], instants)[:, :, 0]
        with np.errstate(over="ignore"):  # a wild prediction is wrong without end
            tip, ceeq, moved = (
                invert(self.parts[name][0], got[name][:, -len(instants) :], instants, mean)
                for name in names[:3]
            )
        return tip[:, :, 0], ceeq, moved

    def tip_forms(self) -> dict[str, tuple[float, Array]]:
        """The parts of the tip elongation at the last instant: g = a + f b, a and b (F,)."""
        out = {}
        for name in (n for n in ("elongation", MEAN_CEEQ) if n in self.parts):
            _, factors, columns, scale = self.parts[name]
            table = factors.modes(factors.time_h[-1:])[:, 0] @ factors.space[0].astype(float)
            b = scale * table[1:]
            offset = float(table[0] + self.mean[columns] @ b)
            out[name] = offset, np.asarray(b @ self.vectors[columns])
        return out

    @property
    def nbytes(self) -> int:
        """Size of all arrays."""
        own = sum(
            f.space.nbytes + f.time.nbytes + f.core.nbytes for _, f, _, _ in self.parts.values()
        )
        return int(own + self.vectors.nbytes + self.mean.nbytes)

    def nbytes_on(self, kept: int, nodes: int) -> int:
        """Size with the spatial modes on so many nodes instead of those `kept`."""
        more = 0
        for _, factors, _, _ in self.parts.values():
            rows = len(factors.space)
            if rows > 1:
                more += factors.space[0].nbytes * (rows // kept) * (nodes - kept)
        return self.nbytes + more


def reduced(target: Target, seed: int) -> tuple[Factors, Array]:
    """Tucker factors and coefficients (n, J), at the ranks that `train` allows."""
    rows = target.values.shape[2]
    kind = target.name if target.name in RANKS else ("scalar" if rows == 1 else "field")
    ranks = RANKS[kind]
    if target.form == "raw" or (kind != "scalar" and target.form == "per ceeq"):
        spread = max(float(np.std(target.values)), np.finfo(float).tiny)
        ranks = replace(ranks, tolerance=ranks.tolerance * spread)
    return factorise(target.values, target.time_h, ranks, seed)
