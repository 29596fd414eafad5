"""An effect in the model: a cell of the grammar as a drift or a bias with a calibrated amplitude.

A dormant input that is constant and the same in all blades wakes: the parameter itself becomes
shared, with the prior that the network declares for it. Of everything else the amplitude is a
shared parameter with a normal prior of the expected size, cut at zero where physics gives it a
sign, and where the input would leave the simulation's runs while it is read (`room`): later it is
held at their end (`core.surrogate.reach`), and `held.leaving_runs` tells from when on. Shapes run
on until `grammar.UNTIL` times the hour at which they reach their size, and stay from then on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from core.course import Course
from core.diagnosis.grammar import Cell, Facts, there
from core.diagnosis.room import room
from core.diagnosis.signature import NOISES
from core.drift import Bias, Drift
from core.model import Model
from core.network import Network, Parameter
from core.observation import Inspection
from core.prior import Prior

WIDTH = 4.0  # amplitudes reach so many times the expected size
MOST_LOST, MOST_GAINED = 0.8, 4.0  # of a reading


def with_effects(
    model: Model,
    cells: Sequence[Cell],
    facts: Mapping[str, Facts],
    noise: Mapping[str, float],
    read_h: Mapping[str, float] | None = None,
) -> Model:
    """The model with these effects as calibrated parameters.

    read_h  hours of the blades at which each was read last; none: to the runs' last hour

    Raises InputError where the simulation's runs have no room for one.
    """
    network = model.network
    for cell in cells:
        network = _with(network, model, cell, facts, noise, read_h)
    return Model.of(network, model.surrogate)


def parameter_name(cell: Cell, network: Network) -> str:
    """The amplitude's name beside what is in the network: numbered where one is adopted already.

    >>> from core.diagnosis.families import FAMILIES
    >>> parameter_name(Cell(FAMILIES[0], "linear", "coating_lot", "C2"), Network("n", (), ()))
    'coating wear (coating lot C2)'
    """
    taken = {p.name for p in network.parameters}
    name = cell.name.replace("@", " at ").replace(".", " ")
    numbered = (name if k == 1 else f"{name} {k}" for k in count(1))
    return next(n for n in numbered if n not in taken)


def frees(cell: Cell, network: Network) -> bool:
    """Whether the effect is a dormant parameter of the network that wakes, for all blades."""
    family = cell.family
    return (family.target, cell.whom, cell.shape, family.how) == (
        "input",
        "all",
        "constant",
        "plus",
    ) and network.parameter(family.of).level == "dormant"


def amplitude(cell: Cell, network: Network) -> tuple[str, float]:
    """The amplitude's name once the effect is in this network, and its value where nothing is."""
    if frees(cell, network):
        return cell.family.of, network.parameter(cell.family.of).nominal or 0.0
    return parameter_name(cell, network), 0.0


def expected(cell: Cell, noise: Mapping[str, float]) -> float:
    """The size that is expected of it; of an offset without one, from the noise."""
    size = cell.family.size
    return size if size is not None else NOISES * noise[cell.family.of]


def _freed(network: Network, cell: Cell) -> Network:
    """The dormant parameter shared, with its own prior; from its nominal value on one side only."""
    own, sign = network.parameter(cell.family.of), cell.family.sign
    prior = own.prior
    if sign and own.nominal is not None and prior.low < own.nominal < prior.high:
        low, high = (own.nominal, prior.high) if sign > 0 else (prior.low, own.nominal)
        prior = replace(prior, low=low, high=high)
    woken = replace(own, level="shared", prior=prior)
    parameters = tuple(woken if p.name == own.name else p for p in network.parameters)
    return replace(network, parameters=parameters)


def _with(
    network: Network,
    model: Model,
    cell: Cell,
    facts: Mapping[str, Facts],
    noise: Mapping[str, float],
    read_h: Mapping[str, float] | None,
) -> Network:
    if frees(cell, network):
        return _freed(network, cell)
    family, name = cell.family, parameter_name(cell, model.network)
    sign = family.sign or 1
    course = _bounded(cell, sign)
    blades = concerned(cell, facts)
    since: tuple[tuple[str, float], ...] = ()
    if family.clock != "blade" and any(f.offset_h for f in facts.values()):
        since = tuple(sorted((b, f.offset_h) for b, f in facts.items()))
    size = expected(cell, noise)
    low, high = (0.0 if family.sign else -WIDTH * size), WIDTH * size
    if family.target == "reading":
        bias = Bias(
            name, family.of, course, family.how,
            instrument=cell.value if cell.whom == "instrument" else None,
            campaign=cell.value if cell.whom == "campaign" else None,
            blades=blades, since=since,
            lasting=family.kind != "sensor" and cell.whom not in ("instrument", "campaign"),
        )  # fmt: skip
        if family.how == "times":
            low, high = _gains(course, low, high)
        changes: dict[str, Any] = {"biases": (*network.biases, bias)}
    else:
        drift = Drift(name, family.of, course, family.how, blades, since, held=True)
        low, high = room(model, drift, low, high, size, read_h)
        changes = {"drifts": (*network.drifts, drift)}
    amplitude = Parameter(
        name, "shared", Prior("normal", low, high, 0.0, size), nominal=0.0, symbol="a"
    )
    return replace(network, parameters=(*network.parameters, amplitude), **changes)


def _gains(course: Course, low: float, high: float) -> tuple[float, float]:
    """The amplitudes that take `MOST_LOST` of a reading at most, or add `MOST_GAINED`."""
    least, most = float(course.values.min()), float(course.values.max())
    low = max(low, -MOST_LOST / most) if most > 0 else low
    return low, min(high, MOST_GAINED, -MOST_LOST / least if least < 0 else high)


def _bounded(cell: Cell, sign: int) -> Course:
    """sign · s(t); of all hours where it is constant."""
    if cell.shape == "constant":
        return Course.of(float(sign))
    if cell.shape == "step":
        hour = cell.step_h or 0.0
        return Course.of([(hour, 0.0), (hour, float(sign))])
    return Course.of([(h, sign * v) for h, v in cell.course.points])


def concerned(cell: Cell, facts: Mapping[str, Facts]) -> tuple[str, ...] | None:
    """Whom a cell concerns; none: all, whoever joins later among them."""
    if cell.whom == "blade":
        return (cell.value or "",)
    found = {
        "lot": [b for b, f in facts.items() if f.lot == cell.value],
        "coating_lot": [b for b, f in facts.items() if f.coating_lot == cell.value],
    }.get(cell.whom)
    if cell.family.clock == "event":
        found = [b for b in (facts if found is None else found) if there(cell, facts[b])]
    return None if found is None else tuple(sorted(found))


def amplitude_of(cell: Cell, *, woken: bool = False) -> str:
    """What an amplitude of 1 means, in words.

    woken  of a dormant input that is free itself (`frees`): what is lost of it is below zero
    """
    family = cell.family
    lost = family.sign < 0 and not woken
    what = {"plus": "lost from" if lost else "added to", "times": "lost of" if lost else "of"}
    when = f" by {cell.reference_h:,.0f} h" if cell.shape in ("early", "linear", "late") else ""
    return f"{what[family.how]} {family.of}{when}"


def typical_noise(
    model: Model, shared: Mapping[str, float], readings: Iterable[Inspection] = ()
) -> dict[str, float]:
    """Noise of each quantity: as found, else as its readings state it, or the middle of its prior.

    shared  means of the shared parameters
    """
    stated: dict[str, list[float]] = {}
    for r in readings:
        if r.sigma is not None:
            stated.setdefault(r.quantity, []).append(r.sigma)
    found = {}
    for q in model.network.quantities:
        told = stated.get(q.name)
        middle = float(np.median(told)) if told else float(q.sigma_obs.quantile(np.array(0.5)))
        own = [v for n, v in shared.items() if n.split("@")[0] == q.sigma_name]
        found[q.name] = float(np.mean(own)) if own else middle
    return found
