"""How each statement of the paper is judged: from numbers to a verdict and a sentence.

A standard deviation counts as smaller or larger from `SAME` on. Between seeds those of blade 01
move by 2.4 % at most, so a ratio within 5 % of one is not settled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from core.validation.paper import WAYS, Case, Strategy
from service.report.words import joined, number

Json = Mapping[str, Any]
Verdict = Literal["agrees", "in part", "disagrees"]
SAME, BETTER = 0.03, 0.01
PSI = ("tbc_thickness", "t1t_rate", "creep_transient", "creep_steady")
WORDS = {
    "tbc_thickness": "TBC thickness",
    "t1t_rate": "T1T",
    "creep_transient": "α",
    "creep_steady": "γ",
}


def last(found: Json, strategy: Strategy, *, delta: bool) -> Json:
    """The stage of a case that has seen all outages."""
    stage: Json = found["cases"][Case(strategy, delta).name][-1]
    return stage


def ratios(over: Json, under: Json, names: Sequence[str] = PSI) -> dict[str, float]:
    """sd of parameters in one posterior over those in another, of names that both have."""
    return {n: over[n]["sd"] / under[n]["sd"] for n in names if n in over and n in under}


def _listed(found: Mapping[str, float]) -> str:
    return joined([f"{WORDS.get(n, n)} {r:.2f}" for n, r in found.items()])


def _share(value: float) -> str:
    return f"{100 * value:.1f} %"


def best_regressor(found: Json) -> tuple[Verdict, str]:
    rows = {row["name"]: row for row in found["surrogate"]["contest"]}
    first = min(rows.values(), key=lambda row: row["median_percent"])
    trees = rows["extra trees"]
    told = (
        f"Of {len(rows)} regressors on {found['surrogate']['runs']} runs the {first['name']} is "
        f"best: {number(first['median_percent'])} % off in the median, extra trees "
        f"{number(trees['median_percent'])} %."
    )
    return ("agrees" if first["name"] == "extra trees" else "disagrees"), told


def good_surrogate(found: Json) -> tuple[Verdict, str]:
    r2 = {q: found["surrogate"][q]["r2"] for q in ("ceeq", "elongation")}
    off = found["surrogate"]["ceeq"]["median_percent"]
    told = (
        f"At the critical node, over all blades of the plan (finite elements on a finer mesh, at "
        f"inputs of which no run was trained): R² {r2['ceeq']:.5f} for CEEQ, "
        f"{r2['elongation']:.5f} for elongation; CEEQ is {number(off)} % off in the median."
    )
    return ("agrees" if min(r2.values()) >= 0.97 else "disagrees"), told


def sharper_with_delta(found: Json) -> tuple[Verdict, str]:
    r = ratios(*(last(found, "offline", delta=d)["scanned"] for d in (True, False)))
    sharper, wider = ([n for n in r if s(r[n])] for s in (_less, _more))
    told = f"sd with δ over without, blade 01 after its scans: {_listed(r)}."
    if sharper and not wider:
        return "agrees", told
    return ("in part" if sharper else "disagrees"), told


def _less(ratio: float) -> bool:
    return ratio < 1 - SAME


def _more(ratio: float) -> bool:
    return ratio > 1 + SAME


def _rmse(stage: Json, *, used: bool) -> float:
    own = [s["rmse_truth_mm"] ** 2 for s in stage["scans"] if s["used"] is used]
    return float((sum(own) / len(own)) ** 0.5)


def scan_improved(found: Json) -> tuple[Verdict, str]:
    with_it, plain = (last(found, "offline", delta=d) for d in (True, False))
    told, better = [], []
    for what, used in (("the three scans", True), ("the held-out one", False)):
        a, b = _rmse(with_it, used=used), _rmse(plain, used=used)
        better.append(a < (1 - BETTER) * b)
        told.append(f"{what}: {number(1000 * b)} µm without δ, {number(1000 * a)} µm with it")
    verdict: Verdict = "agrees" if all(better) else "in part" if any(better) else "disagrees"
    wide, noise = (1000 * with_it["scans"][-1][k] for k in ("sd_blade_mm", "noise_mm"))
    return verdict, (
        f"Root mean square error against the noise-free truth, {'; '.join(told)}. The bounds are "
        f"± {number(wide, 2)} µm at the held-out one, a reading's noise {number(noise, 2)} µm."
    )


def within_bounds(found: Json) -> tuple[Verdict, str]:
    told, literal, promised = [], True, True
    for delta in (False, True):
        stage = last(found, "offline", delta=delta)
        own = [r for r in stage["elongation"] if r["used"]]
        near = sum(abs(r["reading"] - r["mean"]) <= r["sd"] for r in own)
        scans = [s for s in stage["scans"] if s["used"]]
        one, wide = (
            sum(s[k] for s in scans) / len(scans)
            for k in ("reading_inside_1sd", "reading_inside_95")
        )
        literal &= near == len(own) and one > 0.95
        promised &= wide > 0.9 and all(abs(r["reading"] - r["mean"]) <= 2.5 * r["sd"] for r in own)
        told.append(
            f"{'with' if delta else 'without'} δ {near} of {len(own)} elongations of blade 90 and "
            f"{_share(one)} of blade 01's deformations lie within ±1 sd, {_share(wide)} of these "
            "within 95 % bounds"
        )
    verdict: Verdict = "agrees" if literal else "in part" if promised else "disagrees"
    said = joined(told)
    return verdict, (
        f"{said[:1].upper()}{said[1:]}. Bounds of ±1 sd should hold 68 % of the readings; if they "
        "held all of them they would be too wide."
    )


def accuracy_with_delta(found: Json) -> tuple[Verdict, str]:
    own, all_blades = [], []
    for delta in (True, False):
        stage = last(found, "online", delta=delta)
        miss = [(r["truth"] - r["mean"]) ** 2 for r in stage["elongation"]]
        own.append((sum(miss) / len(miss)) ** 0.5)
        all_blades.append(stage["held"]["rmse_mm"])
    better = [a < (1 - BETTER) * b for a, b in (own, all_blades)]
    verdict: Verdict = "agrees" if all(better) else "in part" if any(better) else "disagrees"
    count = last(found, "online", delta=True)["held"]["readings"]
    return verdict, (
        "Elongation of blade 90, root mean square error against the truth: "
        f"{number(1000 * own[1])} µm without δ, {number(1000 * own[0])} µm with it. All {count} "
        f"held-out readings: {number(1000 * all_blades[1])} and {number(1000 * all_blades[0])} µm, "
        "noise included."
    )


def wider_with_delta(found: Json) -> tuple[Verdict, str]:
    sd = []
    for delta in (True, False):
        rows = last(found, "online", delta=delta)["elongation"]
        sd.append(sum(r["sd_blade"] for r in rows) / len(rows))
    told = (
        f"Blade 90's elongation, mean sd of the blade itself: {number(1000 * sd[1])} µm without δ, "
        f"{number(1000 * sd[0])} µm with it."
    )
    return ("agrees" if _more(sd[0] / sd[1]) else "disagrees"), told


def offline_sharper(found: Json) -> tuple[Verdict, str]:
    told, sharper, count = [], 0, 0
    for delta in (False, True):
        ends = [last(found, s, delta=delta) for s in WAYS]
        r = ratios(ends[0]["scanned"], ends[1]["scanned"])
        sharper, count = sharper + sum(map(_less, r.values())), count + len(r)
        same = ", the same bit for bit" if ends[0]["digest"] == ends[1]["digest"] else ""
        told.append(f"{'with' if delta else 'without'} δ {_listed(r)}{same}")
    said = f"sd offline over online after the last outage, blade 01: {'; '.join(told)}."
    for name, r in _schedule(found).items():
        said += f" By the paper's own schedule, {name}: {_listed(r)}."
    if sharper == count:
        return "agrees", said
    return ("in part" if sharper else "disagrees"), said


def _schedule(found: Json) -> dict[str, dict[str, float]]:
    """The same ratios by the paper's Algorithm 1, where that was run."""
    arms, out = found.get("schedule") or {}, {}
    for delta in (False, True):
        both = [arms.get(Case(s, delta).name) for s in WAYS]
        if both[0] and both[1]:
            name = f"{'with' if delta else 'without'} δ"
            out[name] = ratios(both[0]["scanned"], both[1]["scanned"])
    return out


def some_sharper_without(found: Json) -> tuple[Verdict, str]:
    r = ratios(*(last(found, "online", delta=d)["scanned"] for d in (False, True)))
    told = f"sd without δ over with it, blade 01 online: {_listed(r)}."
    return ("agrees" if any(map(_less, r.values())) else "disagrees"), told


def too_narrow_online(found: Json) -> tuple[Verdict, str]:
    rows = [
        next(s for s in stage["scans"] if not s["used"])
        for stage in found["cases"][Case("online", True).name]
    ]
    shares = [row["reading_inside_95"] for row in rows]
    own = [row["truth_inside_95"] for row in rows]
    told = (
        "The next scan, foreseen with δ after one, two and three outages: 95 % bounds of a reading "
        f"hold {joined([_share(v) for v in shares])} of its values, those of the blade itself "
        f"{joined([_share(v) for v in own])} of the noise-free ones. The values of one blade err "
        "together: this is one blade, not thousands."
    )
    return ("agrees" if min(shares) < 0.9 else "disagrees"), told


def not_identifiable(found: Json) -> tuple[Verdict, str]:
    ridge = last(found, "offline", delta=True)["ridge"]
    told = (
        f"θ1 and θ2 of the elongation, blade 01: correlated by {number(ridge['correlation'])}; one "
        f"combination keeps {_share(ridge['least_told'])} of its prior's sd, the other "
        f"{_share(ridge['best_told'])}. As T1T is nearly known, y (θ1 − θ2 T1T) is one parameter "
        "in two."
    )
    return ("agrees" if ridge["least_told"] > 0.9 else "disagrees"), told


def online_cheaper(found: Json) -> tuple[Verdict, str]:
    spent = {
        s: sum(stage["cpu_s"] for d in (False, True) for stage in found["cases"][Case(s, d).name])
        for s in WAYS
    }
    told = (
        f"Processor time with and without δ together: {number(spent['offline'])} s offline, "
        f"{number(spent['online'])} s online for the posteriors of all three outages. The paper: "
        "48 and 27 minutes with 10,000 particles."
    )
    return ("agrees" if spent["online"] < spent["offline"] else "disagrees"), told
