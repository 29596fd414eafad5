"""Blades whose draws do not carry their posterior: told, as shared nodes that do not are.

A blade's draws have weights w_ki at node k, exact whatever they were drawn from (`draws`), so that
averages over them are not biased; but where they were drawn beside the posterior a few carry all,
and quantiles and bands are those few. Of N draws at all nodes as many count as

    N_eff = (Σ_ki w_ki)² / Σ_ki w_ki²                      (Kong 1992)

and what is told is their share. As weights sum to about one at each node, one node at which a
single draw weighs as much as all should together shows as well as many that are thin.
The nodes' own weights are told apart (`state.health`). A set follows from its blade alone, so a
share holds as long as the set does: that of a blade that is kept is the one told before.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST = 0.02  # share of a blade's draws that is enough: 200 of ten thousand
SET = "blade/{}/log_w"


def share(log_w: Array) -> float:
    """The share of draws that count; log weights (K, m).

    >>> share(np.log([[0.25, 0.25, 0.25, 0.25], [1.0, 1e-9, 1e-9, 1e-9]]))
    0.4
    """
    peak = log_w.max()
    if not np.isfinite(peak):
        return 0.0
    w: Array = np.exp(log_w - peak)
    return round(float(w.sum() ** 2 / np.sum(w * w)) / w.size, 6)


def few_draws(
    blades: Iterable[str],
    fresh: Mapping[str, Array],
    before: Iterable[Mapping[str, Any]] = (),
    kept: Collection[str] = (),
) -> list[dict[str, Any]]:
    """Blades of whose draws too few count, and the share that does.

    fresh  arrays that an update made; kept: blades whose sets are those of the state before
    before  what that one told
    """
    found = {str(one["blade"]): float(one["share"]) for one in before if one["blade"] in kept}
    drawn = ((b, fresh.get(SET.format(b))) for b in blades)
    found |= {b: share(log_w) for b, log_w in drawn if log_w is not None}
    return [{"blade": b, "share": found[b]} for b in sorted(found) if not found[b] >= LEAST]


def in_words(one: Mapping[str, Any]) -> str:
    """What is told of such a blade."""
    return (
        f"of blade {one['blade']}'s draws {one['share']:.2%} count, less than {LEAST:.0%}: its own "
        "quantiles and bands are rough"
    )
