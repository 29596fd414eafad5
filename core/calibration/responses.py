"""The model's answers to a blade's readings: compiled rows, on the boxes of the priors.

A row is a polynomial of the model's inputs (`core.response`), scaled to the boxes of the priors:
known and dormant inputs keep the surrogate's. Rows are compiled for a quantity, an operating hour
and its nodes, and kept with the model: blades of one outage share them. Those of all hours of an
input that runs in time are compiled at once (`prepare`). A closed form's rows stay formulas.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from core.answers import Input, Stacked
from core.calibration.scans import split_modes
from core.errors import InputError
from core.model import Model
from core.network import Parameter
from core.observation import Inspection
from core.response import CALIBRATED, Response
from core.surrogate.closed_form import ClosedForm, FormulaRows
from core.surrogate.driven import Driven
from core.surrogate.kept import Kept, Wanted
from core.surrogate.targets import DEFORMATION

Array = NDArray[np.float64]
Rows = Response | FormulaRows
Key = tuple[object, ...]
DEGREE = CALIBRATED
MOST_ROWS = 8192  # compiled ones that a model keeps


def _box(model: Model, inputs: Iterable[Input]) -> tuple[Array, Array]:
    """Bounds of inputs, (d,) each: the priors', or the surrogate's where nothing is calibrated."""
    bounds = []
    for i in inputs:
        p = model.network.parameter(i.name)
        calibrated = p.level in ("local", "shared")
        bounds.append((p.prior.low, p.prior.high) if calibrated else (i.low, i.high))
    low, high = np.array(bounds).T
    return low, high


def _linear(parameter: Parameter, remedy: str) -> None:
    """Refuse an input with a prior in log x: it is integrated over in x."""
    if parameter.prior.log_scale:
        raise InputError(
            f"prior of {parameter.name}",
            "log_uniform",
            "cannot be calibrated as an input",
            f"{remedy} and declare that, uniform",
        )


def _boxed(model: Model, response: Response) -> Response:
    """Rows on the boxes of the priors (known and dormant inputs keep the surrogate's)."""
    low, high = response.low.copy(), response.high.copy()
    for j, name in enumerate(response.names):
        parameter = model.network.parameter(name)
        if parameter.level in ("local", "shared"):
            _linear(parameter, "train the surrogate on its logarithm")
            low[j], high[j] = parameter.prior.low, parameter.prior.high
    return response.reboxed(low, high)


def _rows(model: Model, key: tuple[object, ...], make: object) -> Response:
    """Responses are asked for again and again at the same outages: keep them with the model."""
    if key not in model._rows:
        if sum(map(len, model._rows.values())) > MOST_ROWS:
            model._rows.clear()
        model._rows[key] = _boxed(model, make())  # type: ignore[operator]
    return model._rows[key]


def prepare(model: Model, readings: Iterable[Inspection]) -> None:
    """Compile the rows of all readings of inputs that run in time at once: they share pieces."""
    asked: dict[int, tuple[Driven, Model, dict[Key, tuple[Wanted, float]]]] = {}
    mixings = dict[bytes, Wanted]()
    for reading in readings:
        own = model.for_blade(reading.blade)
        if not isinstance(own.surrogate, Driven) or reading.time_h <= 0:
            continue
        new = asked.setdefault(id(own), (own.surrogate, own, {}))[2]
        if (key := _key(own, reading)) in own._rows or key in new:
            continue
        if own.network.quantity(reading.quantity).kind != "vector":
            new[key] = Wanted.of(reading.quantity, _node_of(own, reading)), reading.time_h
            continue
        nodes = _nodes(reading).tobytes()
        if nodes not in mixings:
            mixings[nodes] = Wanted.of(DEFORMATION, mixing=split_modes(own, reading)[1])
        new[key] = mixings[nodes], reading.time_h
    for answers, own, new in asked.values():
        if len(new) > 1:
            hours: dict[Wanted, set[float]] = {}
            for wanted, hour in new.values():
                hours.setdefault(wanted, set()).add(hour)
            made = Kept(partial(answers.compiled, degree=DEGREE)).made(hours)
            for key, place in new.items():
                _rows(own, key, partial(made.__getitem__, place))


def _key(model: Model, reading: Inspection) -> Key:
    """What the rows of a reading are kept by."""
    if model.network.quantity(reading.quantity).kind == "vector":
        return (reading.quantity, reading.time_h, "scan", _nodes(reading).tobytes())
    nodes = _node_of(model, reading)
    return (reading.quantity, reading.time_h, None if nodes is None else tuple(nodes))


def _nodes(reading: Inspection) -> NDArray[np.int64]:
    assert reading.nodes is not None
    return reading.nodes


def _node_of(model: Model, reading: Inspection) -> list[int] | None:
    quantity = model.network.quantity(reading.quantity)
    if quantity.kind == "scalar":
        return None
    if reading.nodes is not None:
        return [int(n) for n in reading.nodes]
    return [quantity.node_among(model.part(reading.quantity).named)]


def inputs_of(
    model: Model, readings: Sequence[Inspection]
) -> tuple[tuple[str, ...], Array, Array] | None:
    """Inputs that a component's readings depend on, and their boxes; None where that is all."""
    if not isinstance(model.surrogate, Stacked):
        return None
    met = {i.name for r in readings for i in model.part(r.quantity).inputs}
    inputs = [i for i in model.surrogate.inputs if i.name in met]
    names = tuple(i.name for i in inputs)
    model.few_locals(names, f"component {readings[0].blade}")
    return names, *_box(model, inputs)


def answer(model: Model, reading: Inspection) -> Rows:
    """The row of a scalar reading or of one at a node."""
    part, times = model.part(reading.quantity), np.array([reading.time_h])
    if isinstance(part, ClosedForm):
        if model.network.quantity(reading.quantity).kind != "scalar":
            raise InputError(
                "quantity",
                reading.quantity,
                "has nodes, a closed form has none",
                "declare a scalar",
            )
        for i in part.inputs:
            parameter = model.network.parameter(i.name)
            if parameter.level == "local":  # a shared one enters exactly
                _linear(parameter, "write the formula in its logarithm")
        own = part.rows(reading.quantity, times)
        return own.over(own.names, *_box(model, part.inputs))
    nodes = _node_of(model, reading)
    return _rows(
        model,
        _key(model, reading),
        lambda: part.response(reading.quantity, times, nodes, degree=DEGREE),
    )


def scanned(model: Model, reading: Inspection, modes: Array) -> Response:
    """The rows of a scan's modes at its nodes, R (Q, B)."""
    part = model.part(reading.quantity)
    made = partial(part.mode_response, reading.time_h, modes, degree=DEGREE)
    return _rows(model, _key(model, reading), made)
