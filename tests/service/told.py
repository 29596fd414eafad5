"""Results of diagnoses as the service stores them, without a calibration behind them."""

from __future__ import annotations

import math
from typing import Any

Json = dict[str, Any]
HOURS = [2500.0 * k for k in range(21)]
PLACE = {"sd": 0.1, "spread": 0.0, "of": 1, "at_low": 0, "at_high": 0}


def rested() -> Json:
    return {
        "rotor": "r1",
        "through_seq": 12,
        "events_digest": "e" * 32,
        "model": "rotor-blade",
        "model_version": "v1",
        "model_digest": "d" * 64,
        "particles": 2000,
        "seed": 7,
    }


def told(verdict: str, blade: str = "B1", campaign: str = "spring", **changes: Any) -> Json:
    """A result: three blades read four times; with `effect` a campaign 0.02 mm off."""
    name = f"campaign offset (campaign {campaign})"
    named = verdict in ("effect", "not separable")
    return {
        "verdict": verdict,
        "names": [name, *(["root settling"] if verdict == "not separable" else [])] * named,
        "several": [],
        "reasons": ["because it is so"],
        "p": 0.31 if verdict == "adequate" else 0.0025,
        "dealt": 400,
        "p_after": 0.4 if named else None,
        "effects": [effect(name, campaign)] * named,
        "claimed": verdict == "effect",
        "gained_nat": 12.5 * named,
        "evidence": {name: 0.97, "root settling": 0.02} if named else {},
        "calibrated": [{"names": [name], "gained_nat": 12.5}] * named,
        "no_room": [{"names": ["coating wear"], "why": "the runs have no room"}] * named,
        "tried": [{"what": "campaign offset, campaign", "log_bf": 11.0},
                  {"what": "by age", "log_bf": 4.0}, {"what": "fouling, all", "log_bf": -1.0}],
        "holds": [{"effect": name, "by": "early and late", "amplitudes": [1.0, 1.2], "sd": 0.2,
                   "agrees": True, "stands": True, "gained_nat": None}] * named,
        "concerns": [{"effect": name, "blades": 12, "all": 0.9312, "share": 0.3, "some_nat": -1.5,
                      "those": [], "stands": True}] * named,
        "placebos": [{"effect": name, "by": "other readings", "count": 187, "won": 3,
                      "gained_nat": 12.4, "best_nat": 13.1, "stands": True}] * named,
        "parameters": {"before": {"t1t_rate": {"mean": 0.9, "sd": 0.01}},
                       "after": {"t1t_rate": {"mean": 0.91, "sd": 0.01}}},
        "readings": {"delivered": 12, "used": 12},
        "models": {"before": "d" * 64, "after": "f" * 64},
        "before_after": compared() if verdict == "effect" else None,
        "pictures": pictures(blade, campaign, named=named),
        "separating": separating(campaign) if verdict == "not separable" else None,
        "alternatives": alternatives(name) if named else None,
        "noticed": noticed() if verdict == "adequate" else None,
        "rests_on": rested(),
    } | changes  # fmt: skip


def effect(name: str, campaign: str) -> Json:
    return {
        "name": name,
        "words": f"{name}, constant: an instrument was set to zero anew",
        "family": "campaign offset",
        "kind": "sensor",
        "on": "reading",
        "target": "elongation",
        "how": "plus",
        "shape": "constant",
        "whom": "campaign",
        "value": campaign,
        "clock": "rotor",
        "step_h": None,
        "amplitude": {"mean": 0.0199, "sd": 0.0021, "of": "added to elongation"},
    }


def noticed() -> Json:
    """Of wear by its courses, of a campaign, and of a step that no size would have shown."""
    wear = {
        "family": "coating wear",
        "whom": "coating_lot",
        "kind": "physics",
        "on": "input",
        "target": "tbc_thickness",
        "how": "times",
        "of": "lost of tbc_thickness by 50,000 h",
        "unit": "1",
        "least": 0.061,
        "easiest": "C2, early",
        "most": 0.12,
        "hardest": "C1, late",
    }
    step = {
        "family": "firing temperature step",
        "whom": "all",
        "kind": "operation",
        "on": "input",
        "target": "t1t_rate",
        "how": "plus",
        "of": "added to t1t_rate",
        "unit": "1",
        "least": 0.0125,
        "easiest": "at 8,000 h",
        "most": None,
        "hardest": "at 30,000 h",
    }
    offset = {
        "family": "campaign offset",
        "whom": "campaign",
        "kind": "sensor",
        "on": "reading",
        "target": "elongation",
        "how": "plus",
        "of": "added to elongation",
        "unit": "mm",
        "least": 0.0123,
        "easiest": "",
        "most": 0.0123,
        "hardest": "",
    }
    return {"probability": 0.9, "alarm": 0.05, "families": [wear, step, offset]}  # fmt: skip


def compared() -> Json:
    scores = {"count": 2, "bias": -0.01, "within_68": 0.5, "within_95": 0.5}
    before = scores | {"rmse": 0.02, "log_score": 1.0, "width": 0.03, "z": [2.5, -0.2]}
    after = scores | {"rmse": 0.005, "log_score": 2.5, "width": 0.02, "z": [0.5, -0.4]}
    return {
        "quantity": "elongation",
        "held_out": ["1-3", "2-3"],
        "before": before,
        "after": after | {"bias": -0.001, "within_68": 1.0, "within_95": 1.0},
        "forecast": {
            "time_h": 50_000.0,
            "before": {"mean": 0.41, "sd": 0.02},
            "after": {"mean": 0.36, "sd": 0.015},
        },
    }


def alternatives(name: str) -> Json:
    """The offset, and two courses of wear beside it."""
    offset = {"name": name, "shape": "constant", "step_h": None}
    wear = [
        {"name": "coating wear", "shape": shape, "step_h": None} for shape in ("linear", "late")
    ]
    shares = zip(wear, (0.7, 0.3), (0.36, 0.42), strict=True)
    return {
        "quantity": "elongation",
        "time_h": 50_000.0,
        "blades": ["B2", "B3"],
        "before": {"mean": 0.41, "sd": 0.02},
        "together": {"mean": 0.378, "sd": 0.034},
        "each": [
            {"effects": [offset, one], "share": share, "mean": mean, "sd": 0.02}
            for one, share, mean in shares
        ],
    }


def separating(campaign: str) -> Json:
    rivals = [[f"campaign offset (campaign {campaign})"], ["root settling"]]
    one = {
        "blade": "B1",
        "quantity": "elongation",
        "time_h": 32_000.0,
        "ahead_h": 0.0,
        "instrument": "another",
        "sigma": 0.004,
        "gain_nat": 0.5,
        "share": 0.9,
        "settled": 0.7,
    }
    expects = [{"mean": 0.3, "sd": 0.01}, {"mean": 0.36, "sd": 0.012}]
    more = {"unit": "mm", "blades_alike": 3, "expected": expects}
    later = one | {"ahead_h": 4000.0, "instrument": None, "gain_nat": 0.01}
    tells = {"gain_nat": 0.65, "share": 0.97, "settled": 0.94}
    everybody = {
        "quantity": "elongation",
        "ahead_h": 0.0,
        "blades": 3,
        "instrument": "another",
        "sigma": None,
    } | tells
    return {
        "rivals": [{"names": n, "weight": w} for n, w in zip(rivals, (0.6, 0.4), strict=True)],
        "entropy_nat": 0.673,
        "single": [one | more, later | more],
        "set": [one, later | {"gain_nat": 0.6}],
        "campaigns": [
            everybody | {"quantity": "deformation", "nodes": 96, "instrument": None},
            everybody | {"nodes": None, "gain_nat": 0.04, "share": 0.6, "settled": 0.1},
        ],
    }


def pictures(blade: str, campaign: str, *, named: bool) -> Json:
    blades = [blade, "B2", "B3"]
    readings = [
        {
            "id": f"{i}-{k}",
            "blade": b,
            "quantity": "elongation",
            "unit": "mm",
            "time_h": 8000.0 * (k + 1),
            "rotor_h": 8000.0 * (k + 1),
            "instrument": f"g{k % 2}",
            "campaign": campaign if k == 1 else f"visit {k}",
            "value": 0.08 * (k + 1) + 0.01 * i,
            "before": {"mean": 0.08 * (k + 1), "sd": 0.01, "z": 3.5 if k == 1 else -1.2},
            "after": {"mean": 0.08 * (k + 1), "sd": 0.01, "z": 0.3 * (i - 1)},
        }
        for i, b in enumerate(blades)
        for k in range(4)
    ]
    x = [-0.05 + 0.001 * k for k in range(101)]
    amplitude = {
        "name": f"campaign offset (campaign {campaign})",
        "unit": "mm",
        "prior": {"low": -0.08, "high": 0.08, "mean": 0.0, "sd": 0.02},
        "quantiles": [0.0158, 0.0199, 0.0241],
        "at_bound": None,
        "x": x,
        "prior_density": [math.exp(-0.5 * (v / 0.02) ** 2) / 0.05 for v in x],
        "density": [math.exp(-0.5 * ((v - 0.0199) / 0.0021) ** 2) / 0.00526 for v in x],
    }
    parameter = {
        "name": "tbc_thickness", "level": "local", "unit": "1", "low": 0.667, "high": 1.333,
        "effect": False,
        "before": PLACE | {"mean": 0.68, "of": 3, "at_low": 2},
        "after": PLACE | {"mean": 0.99, "of": 3},
    }  # fmt: skip
    return {
        "schema": 1,
        "readings": readings,
        "readings_not_shown": 0,
        "courses": {
            "quantity": "elongation",
            "unit": "mm",
            "time_h": HOURS,
            "blades": blades,
            "before": course(1e-5),
            "after": course(0.8e-5),
        },
        "amplitudes": [amplitude] * named,
        "parameters": [parameter],
    }


def course(rate: float) -> Json:
    """Three blades that elongate along lines: `rate` mm/h, and 5 % more from blade to blade."""
    lines = [[rate * (1 + 0.05 * i) * h for h in HOURS] for i in range(3)]
    return {
        "mean": lines,
        "sd": [[0.05 * v for v in line] for line in lines],
        "low": [[0.9 * v for v in line] for line in lines],
        "median": lines,
        "high": [[1.1 * v for v in line] for line in lines],
    }
