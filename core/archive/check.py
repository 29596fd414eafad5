"""Whether runs fit a network, before any of their values is read.

The network says which inputs and quantities are wanted, in which units, and within which bounds.
What the file has beside that is left out, with a word; what it lacks is a fault. Units that differ
and measure the same are converted, with a warning that tells the factor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.archive.declaration import Input, Kind
from core.archive.effects import families, runs_alone
from core.archive.faults import Findings
from core.archive.source import UNKNOWN, Column, Given, Source
from core.archive.unfit import too_large, too_small
from core.errors import UnitError
from core.network import Network, Parameter, Quantity
from core.units import ratio, unit

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
KINDS: Mapping[str, Kind] = {"scalar": "scalar", "field": "field", "vector": "vector field"}
DEFORMATION, DISPLACEMENT = "deformation", "displacement"
BY_CEEQ = ("elongation", DEFORMATION)  # learnt as a share of mean CEEQ where the runs have it
IN_TIME = (
    *BY_CEEQ,
    "ceeq",
    "creep_damage",
)  # followed where inputs run (`core.surrogate.followed`)
LEAST_MOVED = 1e-9  # of an input's bounds


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is taken of a source: bounds and values (n, d) of inputs, and how quantities are turned.

    turned   quantity of the runs → (its kind, its unit, a, b): value = a · (value of the file) + b
    """

    inputs: tuple[Input, ...]
    values: Array
    turned: Mapping[str, tuple[Kind, str, float, float]]


def wanted(source: Source, network: Network, skip: Flags, found: Findings) -> Wanted:
    """What the network wants of the runs that are not skipped (n,); faults go to `found`."""
    inputs, columns = [], []
    amplitudes = {d.name for d in network.drifts} | {b.name for b in network.biases}
    for p in network.parameters:
        if p.name in source.inputs:
            item, values = _input(p, source.inputs[p.name], source.labels, skip, found)
            if item is not None:
                inputs.append(item)
                columns.append(values)
        elif p.name not in amplitudes:
            have = ", ".join(source.inputs) or "none"
            remedy = f"the runs have the inputs {have}; give it to them, or take it out"
            found.fault(f"parameter {p.name}", None, "is no input of the runs", remedy)
    known = {p.name for p in network.parameters}
    for name in sorted(source.inputs.keys() - known):
        values = source.inputs[name].values[~skip]
        if len(values) and np.ptp(values) <= LEAST_MOVED * abs(float(values[0])):
            problem = "never varies and is no parameter of the network: left out"
            found.warn(f"input {name}", float(values[0]), problem, "nothing, if that is meant")
        else:
            remedy = "declare it: local, shared or known, with its bounds as prior"
            found.fault(f"input {name}", None, "varies and is no parameter of the network", remedy)
    creeps = "ceeq" in source.quantities and source.quantities["ceeq"].kind == "field"
    _in_time(network, creeps, found)
    turned: dict[str, tuple[Kind, str, float, float]] = {}
    for q in network.quantities:
        _quantity(q, source, turned, found)
    if creeps and {q.name for q in network.quantities} & {*BY_CEEQ}:
        given = source.quantities["ceeq"]
        turned.setdefault("ceeq", (given.kind, given.unit, 1.0, 0.0))
    asked = {DISPLACEMENT if q.kind == "vector" else q.name for q in network.quantities}
    families(network, {i.name: i for i in inputs}, found)
    for name in sorted(source.quantities.keys() - turned.keys() - asked):
        remedy = "declare it, if it is to be read or predicted"
        found.warn(f"quantity {name}", None, "is not in the network: left out", remedy)
    return Wanted(
        tuple(inputs), np.array(columns).reshape(len(columns), len(source.labels)).T, turned
    )


def _in_time(network: Network, creeps: bool, found: Findings) -> None:
    """Inputs that run in time, or sleep, go through creep: that needs its clock, mean CEEQ, and
    quantities that go by it."""
    moved = [("effect", d.name) for d in network.drifts]
    moved += [("dormant parameter", p.name) for p in network.of_level("dormant")]
    clock = creeps and bool({q.name for q in network.quantities} & {*BY_CEEQ})
    if not clock:
        runs_alone(network, BY_CEEQ, found)
    if not moved:
        return
    remedy = "take it out, or declare it known with a nominal value"
    for what, name in moved if not creeps else ():
        problem = "goes through creep strain, and the runs have no field ceeq"
        found.fault(f"{what} {name}", None, problem, remedy)
    if not creeps:
        return
    because = ", ".join(f"{what} {name}" for what, name in moved)
    mended = "call it so if it is one of these, or declare the network without it or without those"
    for q in network.quantities:
        if q.name not in IN_TIME:
            problem = f"has no rule in time, as {', '.join(IN_TIME)} have, and what runs or sleeps "
            problem += f"({because}) needs one"
            found.fault(f"quantity {q.name}", None, problem, mended)
    if not clock:
        problem = f"hold neither {' nor '.join(BY_CEEQ)}, with which mean CEEQ is learnt, by which "
        problem += f"{because} runs"
        found.fault("quantities", None, problem, f"declare one of them, or take {because} out")


def _input(
    p: Parameter, column: Column, labels: tuple[str, ...], skip: Flags, found: Findings
) -> tuple[Input | None, Array]:
    """The input in the parameter's unit, with the bounds of its design."""
    what, values = f"input {p.name}", column.values
    low, high = column.low, column.high
    turn = _turn(what, column.unit, p.unit, found)
    if turn is None:
        return None, values
    a, b = turn
    with np.errstate(over="ignore"):  # what is infinite then is told below
        values = a * values + b
    low, high = (None if end is None else a * end + b for end in (low, high))
    for k in np.flatnonzero(~np.isfinite(values) & ~skip):
        found.fault(f"run {labels[k]}: {p.name}", float("nan"), "is no number", "give the input")
    seen = values[np.isfinite(values) & ~skip]
    odd = too_large(what, seen) or too_small(what, float(np.abs(seen).max(initial=0.0)))
    if odd is not None:
        found.add(odd)
        return None, values
    if not len(seen):
        return None, values
    least, most = float(seen.min()), float(seen.max())
    low = min(least, p.prior.low) if low is None else low
    high = max(most, p.prior.high) if high is None else high
    width = high - low
    if not width > 0:
        found.fault(f"bounds of {p.name}", f"{low:g} … {high:g}", "are no interval", "low < high")
        return None, values
    slack = 1e-9 * width
    if p.prior.low < low - slack or p.prior.high > high + slack:
        problem = f"is wider than the bounds of the runs, {low:g} … {high:g} {p.unit}"
        shown = f"{p.prior.low:g} … {p.prior.high:g}"
        found.fault(f"prior of {p.name}", shown, problem, "narrow it, or add runs")
    outside = (values < low - slack) | (values > high + slack)
    for k in np.flatnonzero(outside & ~skip):
        problem = f"lies outside its bounds, {low:g} … {high:g} {p.unit}"
        remedy = "correct the input, leave the run out, or widen the bounds"
        found.fault(f"run {labels[k]}: {p.name}", float(values[k]), problem, remedy)
    if most - least <= LEAST_MOVED * width:
        problem = f"is the same in all {len(seen)} runs: nothing is learnt of it"
        remedy = "vary it in the runs, or take it out of network and runs"
        found.fault(what, least, problem, remedy)
    elif p.prior.low > most or p.prior.high < least:
        problem = f"lies beside all that the runs cover, {least:.3g} … {most:.3g} {p.unit}: it is "
        problem += "a range in which no run lies"
        shown = f"{p.prior.low:g} … {p.prior.high:g}"
        found.fault(f"prior of {p.name}", shown, problem, "check the units, or add runs there")
    else:
        _cover(p, (low, high), (least, most), len(seen), found)
    return Input(p.name, float(low), float(high)), values


def _cover(
    p: Parameter,
    bounds: tuple[float, float],
    seen: tuple[float, float],
    count: int,
    found: Findings,
) -> None:
    """Warn where the runs stop short of the bounds by more than designs do."""
    width = bounds[1] - bounds[0]
    gap = max(seen[0] - bounds[0], bounds[1] - seen[1]) / width
    own = p.prior.high - p.prior.low  # runs may be far wider than it, and lie beside half of it
    gap = max(gap, (seen[0] - p.prior.low) / own, (p.prior.high - seen[1]) / own)
    if gap > max(0.1, 1.5 / count):
        problem = f"is what the runs cover of {bounds[0]:g} … {bounds[1]:g}: it extrapolates beyond"
        remedy = "add runs at the edges, or narrow the prior"
        found.warn(f"input {p.name}", f"{seen[0]:g} … {seen[1]:g}", problem, remedy)


def _turn(what: str, given: str, needed: str, found: Findings) -> tuple[float, float] | None:
    """(a, b) from the file's unit to the network's; a fault where they measure other things."""
    if given in (needed, UNKNOWN):
        return 1.0, 0.0
    try:
        unit(needed)
    except UnitError as error:
        problem = f"{error.problem}, so the runs' {given!r} cannot be compared with it"
        found.add(UnitError(f"unit of {what} in the network", needed, problem, error.remedy))
        return None
    try:
        a, b = ratio(given, needed)
    except UnitError as error:
        found.add(UnitError(f"units of {what}", given, error.problem, error.remedy))
        return None
    if (a, b) != (1.0, 0.0):
        by = f"multiplied by {a:g}" + (f", plus {b:g}" if b else "")
        problem = f"is not the network's {needed!r}: {by}"
        found.warn(f"units of {what}", given, problem, "nothing, if both units are right")
    return a, b


def _quantity(
    q: Quantity,
    source: Source,
    turned: dict[str, tuple[Kind, str, float, float]],
    found: Findings,
) -> None:
    what, name = f"quantity {q.name}", q.name
    if q.kind == "vector":
        if q.name != DEFORMATION:
            problem = "is a vector: of vectors only deformation is calibrated"
            found.fault(what, q.kind, problem, "give the runs displacement, read deformation")
            return
        name = DISPLACEMENT
    given: Given | None = source.quantities.get(name)
    if given is None:
        have = ", ".join(source.quantities)
        found.fault(what, None, "is not in the runs", f"they hold {have}; name it as they do")
        return
    if given.kind != KINDS[q.kind]:
        problem = f"is a {given.kind} in the runs, and a {q.kind} in the network"
        found.fault(what, given.kind, problem, "declare it as it is")
        return
    if q.kind == "field" and q.node is not None and q.node not in source.mesh.named:
        remedy = "name it in the file's named_nodes, or leave the quantity's node out"
        found.fault(f"node of {q.name}", q.node, "is no named node of the runs", remedy)
    elif q.kind != "scalar" and q.default_node not in source.mesh.named:
        problem = f"is not named: {q.default_node} is not among the file's named_nodes. Readings "
        problem += "and questions without the number of a node, the list of blades too, are refused"
        remedy = "name a node in named_nodes, and give the quantity its `node`"
        found.warn(f"node of {q.name}", q.node, problem, remedy)
    turn = _turn(what, given.unit, q.unit, found)
    if turn is not None:
        turned[name] = (given.kind, q.unit, *turn)
