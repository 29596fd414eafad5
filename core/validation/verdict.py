"""Tables and verdict of a study, from the records of its rotors.

Held-out readings are judged by the intervals that `core.prediction` publishes and by their exact
PIT in the mixture of normals. That the sd by source adds up is seen by its parts: with x the truth,

    (m(x) − mean)² / sd_parameters²     the model's value, against the parameters' part
    (value − mean)² / (sd_parameters² + sd_surrogate²)     the blade without the instrument
    (reading − mean)² / sd_total²

have expectation one each, if each part is right by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.validation.records import Record
from core.validation.sbc import (
    CONTROLS,
    PROBABILITIES,
    Clusters,
    Ecdf,
    coverage,
    ecdf,
    mean_and_error,
)

Array = NDArray[np.float64]
PARTS = ("parameters", "value", "reading")
WITHIN = {"truths": {68: 0.05, 95: 0.03}, "held": {68: 0.03, 95: 0.02}}
"""How far a share may be from its nominal value, where it rests on `JUDGED` truths or more."""
JUDGED = 200
TELLING = ("narrow", "shifted")  # wrong samplers that few truths tell


def collected(records: Sequence[Record], kind: str, name: str, key: str) -> tuple[Array, Clusters]:
    """All values of one name, and the number of the cluster of each."""
    values: list[float] = []
    cluster: list[int] = []
    for record in records:
        found = record[kind].get(name, {}).get(key, [])
        values += [np.nan if v is None else v for v in found]
        cluster += [record["cluster"]] * len(found)
    return np.array(values), np.array(cluster, dtype=np.int64)


def names(records: Sequence[Record], kind: str) -> list[str]:
    """Names in the order in which they first come."""
    return list(dict.fromkeys(name for record in records for name in record[kind]))


def curves(records: Sequence[Record]) -> dict[str, dict[str, Ecdf]]:
    """By name: the distribution of PITs and its band, "pit" and for parameters each control."""
    found: dict[str, dict[str, Ecdf]] = {}
    for kind, keys in (("truths", ("pit", *CONTROLS)), ("held", ("pit",))):
        for name in names(records, kind):
            found[name] = {key: ecdf(*collected(records, kind, name, key)) for key in keys}
    return found


def summary(
    records: Sequence[Record], found: Mapping[str, Mapping[str, Ecdf]], *, parameters: bool = True
) -> dict[str, Any]:
    """Tables and verdict of a study, which passes only if it claims something.

    band_inside and covers of a row are None where nothing is claimed: truths are too few.

    parameters   False where truths do not come from the prior: nothing is claimed of parameters
    """
    table: dict[str, Any] = {}
    for kind in ("truths", "held"):
        for name in names(records, kind):
            one = found[name]["pit"]
            row: dict[str, Any] = {"truths": one.truths, "clusters": one.clusters}
            for c in PROBABILITIES:
                if kind == "held":
                    share, error = mean_and_error(*collected(records, kind, name, f"in {c}"))
                else:
                    share, error = coverage(*collected(records, kind, name, "cdf"), c)
                row[f"inside_{round(100 * c)}"] = round(share, 4)
                row[f"error_{round(100 * c)}"] = round(error, 4)
            wide = WITHIN[kind]
            near = all(abs(row[f"inside_{c}"] - c / 100) <= w for c, w in wide.items())
            design = one.design if np.isfinite(one.design) else 1.0
            row["covers"] = near if one.truths / max(design, 1.0) >= JUDGED else None
            # where wrong samplers are inside as well the band says nothing
            blind = kind == "truths" and all(found[name][key].inside for key in TELLING)
            row["band_inside"] = one.inside if one.claims and not blind else None
            if np.isfinite(one.design):
                row["design_effect"] = round(one.design, 2)
            if kind == "held":
                for part in PARTS:
                    values, cluster = collected(records, kind, name, part)
                    if not np.isnan(values).any():
                        mean, error = mean_and_error(values, cluster)
                        row[f"square_{part}"] = [round(mean, 4), round(error, 4)]
            else:
                row["controls_inside"] = {key: found[name][key].inside for key in CONTROLS}
            table[name] = row
    failed = {r["rotor"]: r["error"] for r in records if "error" in r}
    claimed = [n for n in table if parameters or n in names(records, "held")]
    caught = {
        key: [n for n in names(records, "truths") if not found[n][key].inside] for key in CONTROLS
    }
    verdict = {
        "failed": failed,
        "outside_band": [n for n in claimed if table[n]["band_inside"] is False],
        "not_covering": [n for n in claimed if table[n]["covers"] is False],
    }
    claims = any(table[n][key] is not None for n in claimed for key in ("band_inside", "covers"))
    passed = claims and not any(verdict.values()) and (not parameters or all(caught.values()))
    return {
        "rotors": len(records),
        "least_ess_ratio": min((r["ess_ratio"] for r in records if "error" not in r), default=0.0),
        "rotor_seconds": round(sum(r["seconds"] for r in records), 1),
        "passed": passed,
        **verdict,
        "controls_caught": caught if parameters else None,
        "table": table,
    }
