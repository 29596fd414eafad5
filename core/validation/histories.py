"""How far the rule for inputs that change in time is from finite elements with the same history.

Histories are drawn in turn of four kinds, inside the box of the runs,

    drift      the coating wears, the gas heats up or cools down, or both, over the whole time
    step up    the gas is hotter, or the coating thinner, from an hour on
    step down  cooler, or recoated
    cycle      gas and coating go to and fro, two to four times

and of two materials: as the shipped surrogate has it, or with strong tertiary creep (c from 1.5 to
3), for which the surrogate of the wider runs answers, anchored at the shipped one, as it does once
such creep is in the model. Truth: `core.blade.simulate_history` on the mesh of the training runs.
Both surrogates know runs with constant inputs alone.

    off     prediction over truth − 1, elongation and mean CEEQ, from 8,000 h on
    rule    the same less what the surrogate is off for a blade whose inputs stay as they began:
            what the rule itself does wrong
    inside  share of the elongations within 2 sd as the prediction tells it
    flat    the control: inputs taken for constant at their mean
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.blade import BOUNDS, DORMANT, simulate_history
from core.blade.history import PIECES
from core.blade.kept import kept_runs
from core.builtin import plans, rotor_blade
from core.course import Course
from core.drift import Drift
from core.rng import stream
from core.surrogate.anchor import Anchor
from core.surrogate.driven import Driven

Array = NDArray[np.float64]
Given = Mapping[str, float | Sequence[tuple[float, float]]]
KINDS = ("drift", "step up", "step down", "cycle")
TIMES_H = np.array([8e3, 16e3, 24e3, 32e3, 40e3, 50e3])
END_H = 5e4
CYCLED = 12  # pieces of each way of a cycle in finite elements, of four to eight
TERTIARY = (1.5, 3.0)
EVERY = 4  # of so many histories of a kind one has tertiary creep
BOX = {
    "tbc_thickness": (0.75, 1.3),
    "t1t_rate": (0.83, 0.96),
    "creep_transient": (-2.5, 2.5),
    "creep_steady": (-2.5, 2.5),
}
GAS, COATING = (0.015, 0.035), (0.1, 0.4)  # sizes of changes: t1t_rate, and share of the coating
OUTER = {"tbc_thickness": (0.667, 1.333), "t1t_rate": (0.8, 1.0)}


def history(number: int, seed: int) -> tuple[str, Given]:
    """Kind and inputs of a history.

    >>> kind, inputs = history(1, 7)
    >>> kind, [hour for hour, _ in inputs["t1t_rate"]][:1] if kind != "drift" else []
    ('step up', [0.0])
    """
    kind, rng = KINDS[number % len(KINDS)], stream(seed, "histories", number)
    x = {name: round(float(rng.uniform(*ends)), 6) for name, ends in BOX.items()}
    gas, coating = (float(rng.uniform(*ends)) for ends in (GAS, COATING))
    which = ("gas", "coating", "both")[int(rng.integers(3))]
    hour = float(round(rng.uniform(6e3, 3e4), -2))
    shapes = {
        "drift": [(0.0, 0.0), (END_H, 1.0)],
        "step up": [(0.0, 0.0), (hour, 0.0), (hour, 1.0)],
        "step down": [(0.0, 0.0), (hour, 0.0), (hour, 1.0)],
        "cycle": _cycle(int(rng.integers(2, 5))),
    }
    hotter = {"step up": 1.0, "step down": -1.0}.get(kind, 1.0 if rng.random() < 0.7 else -1.0)
    inputs: dict[str, float | Sequence[tuple[float, float]]] = dict(x)
    if which != "coating":
        inputs["t1t_rate"] = _moved("t1t_rate", shapes[kind], x, lambda v, s: v + hotter * gas * s)
    if which != "gas":
        inputs["tbc_thickness"] = _moved(
            "tbc_thickness", shapes[kind], x, lambda v, s: v * (1.0 - hotter * coating * s)
        )
    if number // len(KINDS) % EVERY == EVERY - 1:
        inputs["tertiary"] = round(float(rng.uniform(*TERTIARY)), 6)
    return kind, inputs


def _cycle(times: int) -> list[tuple[float, float]]:
    """To 1 and back, so many times, with corners a little inside the ends of each half."""
    half = END_H / (2 * times)
    return [(k * half, float(k % 2)) for k in range(2 * times + 1)]


def _moved(
    name: str,
    shape: Sequence[tuple[float, float]],
    x: Mapping[str, float],
    by: Callable[[float, float], float],
) -> list[tuple[float, float]]:
    low, high = OUTER[name]
    return [(hour, round(min(max(by(x[name], s), low), high), 6)) for hour, s in shape]


def truth(number: int, seed: int, mesh: str) -> Array:
    """Elongation [mm] and mean CEEQ of a history by finite elements, (2, T)."""
    kind, inputs = history(number, seed)
    return _simulated(inputs, mesh, CYCLED if kind == "cycle" else PIECES)


def _simulated(inputs: Given, mesh: str, parts: int = PIECES) -> Array:
    bounds, hours = {**BOUNDS, **plans.WIDER}, np.array([0.0, *TIMES_H])
    run = simulate_history(inputs, mesh, time_h=hours, bounds=bounds, parts=parts)
    return np.array([run.elongation[1:], run.ceeq[1:].astype(float).mean(axis=1)])


def start(number: int, seed: int, mesh: str) -> Array:
    """The same of a blade whose inputs stay as they began."""
    _, inputs = history(number, seed)
    still = {name: float(Course.of(given).at(0.0)) for name, given in inputs.items()}
    return _simulated(still, mesh)


def predicted(inputs: Given) -> tuple[Array, Array]:
    """Elongation and mean CEEQ by surrogate and rule, (2, T), and the elongation's sd (T,)."""
    courses = {name: Course.of(given) for name, given in inputs.items()}
    begun = {name: float(course.at(0.0)) for name, course in courses.items()}
    drifts = tuple(
        Drift(f"run of {name}", name, Course.of([(h, v - begun[name]) for h, v in course.points]))
        for name, course in courses.items()
        if not course.constant
    )
    fixed, anchor, base = dict(begun), None, rotor_blade.load()
    if "tertiary" in inputs:
        asleep = {name: one.nominal for name, one in DORMANT.items()}
        fixed, anchor = asleep | begun, Anchor(base, asleep)
        base = rotor_blade.load_wide()
    free, *_ = BOUNDS  # one input is left to be given, for there has to be one
    x = fixed.pop(free)
    ranges = {name: (begun[name] - 1e-9, begun[name] + 1e-9) for name in BOUNDS}
    ranges |= {d.name: (0.0, 1.0) for d in drifts}
    model = Driven(base, drifts, ranges, fixed, anchor)
    asked = np.array([[x, *np.ones(len(drifts))]])
    mean, sd, ceeq = model.along(asked, "elongation", TIMES_H)
    return np.array([mean[0, :, 0], ceeq[0]]), sd[0, :, 0]


def flat(inputs: Given) -> Given:
    """Constant at their means over the whole time."""
    out = dict[str, float]()
    for name, given in inputs.items():
        course = Course.of(given)
        cuts = [0.0, *sorted(h for h in course.cuts(50) if 0 < h < END_H), END_H]
        out[name] = float(sum(course.mean(a, b) * (b - a) for a, b in pairwise(cuts)) / END_H)
    return out


def run(
    count: int,
    *,
    seed: int,
    folder: str | Path,
    mesh: str = "default",
    processes: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[dict[str, Any]]:
    """A record for each history; finite-element runs are kept in `folder`."""
    ways: dict[str, Callable[[int, int, str], Array]] = {"history": truth, "start": start}
    calls = {f"{way}-{mesh}-{seed}-{n:03d}": (way, n) for n in range(count) for way in ways}
    todo = {name: (way, n, seed, mesh) for name, (way, n) in calls.items()}
    done = kept_runs(folder, todo, _run, processes, progress)
    out = []
    for n in range(count):
        kind, inputs = history(n, seed)
        fe, still = (done[f"{way}-{mesh}-{seed}-{n:03d}"] for way in ways)
        begun = {name: float(Course.of(given).at(0.0)) for name, given in inputs.items()}
        (mean, sd), (same, _), (level, _) = (predicted(g) for g in (inputs, begun, flat(inputs)))
        off = mean / fe - 1.0
        out.append(
            {
                "number": n,
                "kind": kind,
                "tertiary": "tertiary" in inputs,
                "inputs": inputs,
                "elongation_mm": fe[0].tolist(),
                "mean_ceeq": fe[1].tolist(),
                "off": off.tolist(),
                "rule": (off - (same / still - 1.0)).tolist(),
                "flat": (level / fe - 1.0).tolist(),
                "inside": (np.abs(mean[0] - fe[0]) < 2.0 * sd).tolist(),
            }
        )
    return out


def _run(way: str, number: int, seed: int, mesh: str) -> Array:
    return (truth if way == "history" else start)(number, seed, mesh)


def summary(records: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Median and 95th percentile of the sizes of errors [%], by kind and material, and of all."""
    groups: dict[str, list[Mapping[str, Any]]] = {"all": list(records)}
    for one in records:
        groups.setdefault(str(one["kind"]), []).append(one)
        groups.setdefault("tertiary" if one["tertiary"] else "shipped", []).append(one)
    found = {}
    for name, own in groups.items():
        told: dict[str, float] = {"histories": len(own)}
        for what in ("off", "rule", "flat"):
            sizes = 100.0 * np.abs(np.array([one[what] for one in own]))  # (n, 2, T)
            for q, quantity in enumerate(("elongation", "mean_ceeq")):
                told[f"{what}, {quantity}, median %"] = float(np.median(sizes[:, q]))
                told[f"{what}, {quantity}, 95th %"] = float(np.percentile(sizes[:, q], 95))
        told["inside"] = float(np.mean([one["inside"] for one in own]))
        found[name] = {k: round(v, 4) for k, v in told.items()}
    return found
