"""The main job closes its loop: what does the model lack, and what does adding it change?

The rotor's readings carry effects that nobody declared (`core.builtin.worn_plan`). Once they are
all in, the service is asked for a diagnosis; an effect that it claims is adopted, the log is
replayed into the larger model, and both models' forecasts of the fourth outage, whose readings were
never posted, are held against them. What it does not claim is not adopted, and said.
"""

from __future__ import annotations

import time
from dataclasses import replace

from core.builtin.inspection_plan import Plan
from core.builtin.worn_plan import CAMPAIGN, LOST, LOST_BY_H, OFFSET
from service.client import Client
from service.demo.result import Json, Result, collect
from service.diagnose_command import awaited, shown

PLANTED = {
    "coating wear (coating lot C2)": (LOST, f"of the coating by {LOST_BY_H:,.0f} h"),
    f"campaign offset (campaign {CAMPAIGN})": (OFFSET, "mm"),
}


def closed(
    client: Client, plan: Plan, before: Result, name: str, patience_s: float, quiet: bool = False
) -> Result:
    """The result after what was claimed is adopted; as before where nothing is."""
    begun = time.monotonic()
    with shown(quiet=quiet) as show:
        told = awaited(client, {**client.diagnose(name)}, show, 1.0)
    loop: Json = {
        "planted": {what: {"amplitude": a, "of": of} for what, (a, of) in PLANTED.items()},
        "diagnosis": told,
        "adopted": False,
        "before": summary(before),
        "held_out": {"before": before.held_out},
        "after": None,
        "seconds": {"diagnosis": time.monotonic() - begun},
    }
    if told["status"] != "done" or not told["result"]["claimed"]:
        return replace(before, loop=loop)
    asked = time.monotonic()
    client.adopt(name, told["id"])
    rotor = client.wait_sealed(name, patience_s)
    after = collect(client, plan, {**rotor}, name, quiet=quiet)
    loop |= {"adopted": True, "after": summary(after)}
    loop["held_out"]["after"] = after.held_out
    loop["seconds"]["adoption"] = time.monotonic() - asked
    return replace(after, loop=loop, seconds=before.seconds)


def summary(one: Result) -> Json:
    """Of the readings that were never posted: errors [mm] and shares within the bands."""
    rmse, bias = one.forecast_error
    worn = [b for b in one.held_out if "B035" <= b <= "B058"]
    miss = [one.held_out[b][2] - one.held_out[b][1] for b in worn]
    return {
        "rmse_mm": rmse,
        "bias_mm": bias,
        "coverage_95": one.coverage,
        "width_mm": sum(h[4] - h[3] for h in one.held_out.values()) / len(one.held_out),
        "worn_lot_bias_mm": sum(miss) / len(miss),
        "local_coverage_95": {n: one.local_coverage(n) for n in next(iter(one.local.values()), {})},
        "t1t_rate": one.shared["t1t_rate"],
    }


def lines(loop: Json) -> list[str]:
    """The loop in words."""
    told = loop["diagnosis"]
    if told["status"] != "done":
        return [f"the diagnosis ended as {told['status']}: {told.get('error')}"]
    found = told["result"]
    out = [f"what the model lacks: {found['verdict']} (p = {found['p']:.2g})"]
    out += [f"  {why}" for why in found["reasons"]]
    for one in found["effects"]:
        size, true = one["amplitude"], loop["planted"].get(one["name"])
        beside = "" if true is None else f" (planted: {true['amplitude']:g} {true['of']})"
        out.append(f"  {one['name']}: {size['mean']:.3g} ± {size['sd']:.2g} {size['of']}{beside}")
    before, after = loop["before"], loop["after"]
    if after is None:
        return [*out, "  nothing was adopted"]
    out.append("fourth outage, never posted:      before     after")
    for name, label in (
        ("rmse_mm", "error [mm]"),
        ("bias_mm", "bias [mm]"),
        ("worn_lot_bias_mm", "bias of the worn lot [mm]"),
        ("coverage_95", "inside the 95 % band"),
        ("width_mm", "width of the band [mm]"),
    ):
        out.append(f"  {label:<28} {before[name]:>9.3g} {after[name]:>9.3g}")
    return out
