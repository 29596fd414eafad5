"""Tables and verdict of a study of lives (`core.validation.lives`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.validation.records import Record
from core.validation.sbc import Clusters, Ecdf, ecdf, mean_and_error

Array = NDArray[np.float64]
PULL = 0.05  # a blade is pulled where its chance by the next outage is as large
EDGES = (0.0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0)  # of chances that are told
WITHIN = 0.02  # of the share of blades that pass by the next outage
CLAIMS, CONTROLS = ("pit", "any"), ("narrow", "worst")
BESIDE = ("independent",)
EACH = CLAIMS + CONTROLS + BESIDE
WHO = ("twin", "band", "trend")


def collected(found: Sequence[Record], key: str, factor: float | None) -> tuple[Array, Clusters]:
    """All values of a name, at one limit or at all, and the cluster of each."""
    values, cluster = list[float](), list[int]()
    for record in found:
        for limit in record.get("limits", ()):
            if factor in (None, limit["factor"]):
                own = np.atleast_1d(limit[key]).tolist()
                values += own
                cluster += [record["cluster"]] * len(own)
    return np.array(values, float), np.array(cluster, dtype=np.int64)


def factors(found: Sequence[Record]) -> list[float]:
    return sorted({limit["factor"] for r in found for limit in r.get("limits", ())})


def curves(found: Sequence[Record]) -> dict[str, dict[str, Ecdf]]:
    """By limit ("1.25 x"): the distribution of each kind of chance at the truths, and its band."""
    return {
        f"{factor:g} x": {key: ecdf(*collected(found, key, factor)) for key in EACH}
        for factor in factors(found)
    }


def reliability(found: Sequence[Record], who: str) -> list[dict[str, float]]:
    """Of blades that were told chances alike: how many, their mean chance, the share that passed by
    the next outage, and the standard error of the difference between rotors."""
    told, cluster = collected(found, who, None)
    passes, _ = collected(found, "passes", None)
    place = np.clip(np.searchsorted(EDGES, told, side="right") - 1, 0, len(EDGES) - 2)
    out = []
    for k in range(len(EDGES) - 1):
        own = place == k
        if own.any():
            out.append(
                {
                    "from": EDGES[k],
                    "to": EDGES[k + 1],
                    "blades": int(own.sum()),
                    "told": round(float(told[own].mean()), 4),
                    "passed": round(float(passes[own].mean()), 4),
                    "error": round(mean_and_error((passes - told)[own], cluster[own])[1], 4),
                }
            )
    return out


def decisions(found: Sequence[Record], who: str) -> dict[str, float]:
    """What comes of pulling each blade whose chance by the next outage is `PULL` or more.

    passing, sound    blades that pass by it, and that do not
    missed, in_vain   of these how many are left, and are pulled
    brier             mean square of chance less outcome; its least is nought
    log_loss          mean of −log of the chance of what came; of chances within 1e-5 … 1 − 1e-5
    off               mean chance less share that pass, and its standard error between rotors
    """
    told, cluster = collected(found, who, None)
    passes, _ = collected(found, "passes", None)
    pulled, bad = told >= PULL, passes > 0
    off, error = mean_and_error(told - passes, cluster)
    kept = np.clip(told, 1e-5, 1.0 - 1e-5)
    return {
        "passing": int(bad.sum()),
        "missed": int((bad & ~pulled).sum()),
        "sound": int((~bad).sum()),
        "in_vain": int((~bad & pulled).sum()),
        "brier": round(float(np.mean((told - passes) ** 2)), 5),
        "log_loss": round(float(-np.mean(np.log(np.where(bad, kept, 1.0 - kept)))), 4),
        "off": round(off, 4),
        "error": round(error, 4),
    }


def summary(
    found: Sequence[Record], of: dict[str, dict[str, Ecdf]] | None = None
) -> dict[str, Any]:
    """Tables and verdict. It passes only if no rotor failed, all distributions of what is claimed
    and can be judged are inside their bands, the share of blades that pass by the next outage is
    what was told (within `WITHIN`), and each control is outside at one limit at least."""
    of = curves(found) if of is None else of
    table: dict[str, Any] = {}
    for name, own in of.items():
        table[name] = {
            key: {
                "truths": one.truths,
                "clusters": one.clusters,
                "inside": one.inside if one.claims else None,
            }
            for key, one in own.items()
        }
    at_next = {who: decisions(found, who) for who in WHO} if table else {}
    outside = [f"{key}, {n}" for key in CLAIMS for n in table if table[n][key]["inside"] is False]
    caught = {key: [n for n in table if table[n][key]["inside"] is False] for key in CONTROLS}
    failed = {str(r["rotor"]): r["error"] for r in found if "error" in r}
    near = bool(table) and abs(at_next["twin"]["off"]) <= WITHIN
    judged = all(table[n][key]["inside"] is not None for n in table for key in CLAIMS)
    return {
        "rotors": len(found),
        "rotor_seconds": round(sum(r["seconds"] for r in found), 1),
        "passed": near and judged and not failed and not outside and all(caught.values()),
        "failed": failed,
        "outside_band": outside,
        "controls_caught": caught,
        "table": table,
        "next_outage": at_next,
        "reliability": {who: reliability(found, who) for who in WHO if table},
    }
