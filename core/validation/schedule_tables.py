"""Tables of the schedule study: coverage and sharpness beside the joint posterior, and ratios."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from core.validation.sbc import mean_and_error
from core.validation.schedule_study import JOINT, PROBABILITIES, Case, Found, Record


def pairs(
    records: Sequence[Record], over: Case, under: Case, name: str
) -> Iterator[tuple[int, Found, Found]]:
    """(rotor, found by `over`, found by `under`) for each blade, of the rotors that have both."""
    for r, record in enumerate(records):
        if over in record and under in record:
            below = record[under].found.get(name, {})
            for blade, found in record[over].found.get(name, {}).items():
                if blade in below:
                    yield r, found, below[blade]


def names(records: Sequence[Record], case: Case) -> list[str]:
    """Names in the order in which they first come."""
    return list(dict.fromkeys(n for r in records if case in r for n in r[case].found))


def _finite(error: float) -> float | None:
    """A standard error between rotors; one rotor has none."""
    return round(error, 4) if np.isfinite(error) else None


def coverage_table(records: Sequence[Record], case: Case) -> dict[str, dict[str, Any]]:
    """By name: truths inside central intervals, and sd and mean beside the joint posterior's.

    error_c   standard error of a share between rotors
    sd_ratio  median of sd / sd_joint;  off  median of |mean − mean_joint| / sd_joint
    """
    table = {}
    for name in names(records, case):
        both = list(pairs(records, case, replace(case, arm=JOINT), name))
        cluster = np.array([r for r, _, _ in both])
        row: dict[str, Any] = {"truths": len(both)}
        for i, p in enumerate(PROBABILITIES):
            share, error = mean_and_error(
                np.array([float(one.inside[i]) for _, one, _ in both]), cluster
            )
            c = round(100 * p)
            row |= {f"inside_{c}": round(share, 4), f"error_{c}": _finite(error)}
        row["sd_ratio"] = round(float(np.median([a.sd / b.sd for _, a, b in both])), 4)
        row["off"] = round(float(np.median([abs(a.mean - b.mean) / b.sd for _, a, b in both])), 4)
        table[name] = row
    return table


def against(records: Sequence[Record], over: Case, under: Case) -> dict[str, dict[str, Any]]:
    """By name: median of sd_over / sd_under, the share of cases in which `over` is sharper."""
    table = {}
    for name in names(records, over):
        both = list(pairs(records, over, under, name))
        if not both:
            continue
        ratio = np.array([a.sd / b.sd for _, a, b in both])
        share, error = mean_and_error((ratio < 1).astype(float), np.array([r for r, _, _ in both]))
        table[name] = {
            "cases": len(both),
            "sd_ratio": round(float(np.median(ratio)), 4),
            "least": round(float(ratio.min()), 4),
            "largest": round(float(ratio.max()), 4),
            "sharper": round(share, 4),
            "error": _finite(error),
        }
    return table


def summary(records: Sequence[Record], cases: Sequence[Case]) -> dict[str, Any]:
    """Every table that these cases allow, and how the sweeps ended."""
    met = [c for c in cases if any(c in record for record in records)]
    plain = [c for c in met if c.data == c.model == "none"]
    ended = {c: [record[c] for record in records if c in record] for c in met}
    return {
        "sweeps": {
            f"{c.arm}, model {c.model}, data {c.data}": {
                "rotors": len(own),
                "most": max(o.sweeps for o in own),
                "converged": sum(o.converged for o in own),
                "plain_ess": round(min(o.plain_ess for o in own), 2),
            }
            for c, own in ended.items()
            if c.arm != JOINT
        },
        "coverage": {c.arm: coverage_table(records, c) for c in plain},
        "offline against online": {
            f"model {c.model}, data {c.data}": against(records, c, replace(c, arm="online"))
            for c in met
            if c.arm == "offline" and replace(c, arm="online") in met
        },
        "discrepancy": {
            f"{c.arm}, model {c.model}, data {c.data}": against(
                records, c, replace(c, model="none")
            )
            for c in met
            if c.model != "none" and replace(c, model="none") in met
        },
    }
