"""Measures of predictions at runs that were left out.

Of features f (n, F), centred on the training runs, and predictions p of them, over the leading
`LEADING` features (the number of the published method):

    by variance    rmse^2 = sum_ij (p_ij - f_ij)^2 / sum_ij f_ij^2             R^2 = 1 - rmse^2
    each alike     rmse^2 = mean_j [ sum_i (p_ij - f_ij)^2 / sum_i f_ij^2 ]    R^2 = 1 - rmse^2

The published method does not say how its features are scaled; in both readings the mean of the
training runs has 1. Of the fields: relative error of the tip elongation and of CEEQ at each run's
worst node (the largest one at the end) at all instants from 1000 h on, as median and 95th
percentile; root-mean-square error of the deformation over runs, instants and the sampled nodes'
x, y, z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from core.surrogate.contest.features import Features
from core.surrogate.contest.kept import Kept

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
LEADING = 20
FROM_H = 1000.0
RULE = (
    "the smallest geometric mean of three cross-validated errors: tip elongation and CEEQ at the "
    "worst node (95th percentiles), deformation (rms)"
)


@dataclass(frozen=True, slots=True)
class Errors:
    """Of runs that were left out (n of them), T' instants from 1000 h on.

    runs       positions in what is kept, (n,)
    true, off  features and errors of their predictions, (n, 20 at most)
    tip, ceeq  relative errors, (n, T');  field: mean square of the deformation's error, (n,) [mm²]
    end        tip elongation at the last instant, true and predicted, (n, 2) [mm]
    """

    runs: Rows
    true: Array
    off: Array
    tip: Array
    ceeq: Array
    field: Array
    end: Array

    @classmethod
    def of(cls, kept: Kept, made: Features, runs: Rows, true: Array, predicted: Array) -> Errors:
        """Errors of predicted features (n, F) of the runs (positions); `true` is their encoding."""
        late = kept.instants >= FROM_H
        tip, ceeq, moved = kept.truth(runs)
        tip_p, ceeq_p, moved_p = made.physical(predicted, kept.instants)
        own, worst = np.arange(len(runs)), kept.worst[runs]
        hot, hot_p = ceeq[own, :, worst][:, late], ceeq_p[own, :, worst][:, late]
        error = (moved_p - moved)[:, :, : 3 * kept.sampled]
        lead = slice(0, LEADING)
        return cls(
            runs,
            true[:, lead],
            (predicted - true)[:, lead],
            np.abs(tip_p - tip)[:, late] / tip[:, late],
            np.abs(hot_p - hot) / hot,
            np.mean(error**2, axis=(1, 2)),
            np.column_stack([tip[:, -1], tip_p[:, -1]]),
        )

    @classmethod
    def joined(cls, parts: Sequence[Errors]) -> Errors:
        """Of several folds together; folds of fewer features decide how many are compared."""
        least = min(one.true.shape[1] for one in parts)
        wide = {"true", "off"}
        return cls(
            *(
                np.concatenate([getattr(p, f.name)[:, :least] if f.name in wide
                                else getattr(p, f.name) for p in parts])
                for f in fields(cls)
            )
        )  # fmt: skip

    def told(self) -> dict[str, float]:
        """All measures, by name, the unit last."""
        square, whole = np.sum(self.off**2, axis=0), np.sum(self.true**2, axis=0)
        lost = {"by_variance": np.sum(square) / np.sum(whole), "each": np.mean(square / whole)}
        found = {
            **{f"rmse_{how}": np.sqrt(share) for how, share in lost.items()},
            **{f"r2_{how}": 1.0 - share for how, share in lost.items()},
            "field_rmse_mm": np.sqrt(np.mean(self.field)),
        }
        for name, error in (("tip", self.tip), ("ceeq", self.ceeq)):
            median, p95 = 100.0 * np.quantile(error, [0.5, 0.95])
            found |= {f"{name}_median_percent": median, f"{name}_p95_percent": p95}
        return {name: float(f"{value:.5g}") for name, value in found.items()}


def rank_of(told: dict[str, float]) -> float:
    """What `RULE` puts in order: the smaller the better."""
    parts = [told[name] for name in ("tip_p95_percent", "ceeq_p95_percent", "field_rmse_mm")]
    return float(np.exp(np.mean(np.log(parts))))
