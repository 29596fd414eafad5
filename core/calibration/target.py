"""The joint target, blade by blade: readings packed as rows for the compiled messages.

A blade's rows are polynomials of the model's inputs (`core.response`), scaled to the boxes of the
priors; each row has a reading and a noise, which is a shared parameter sigma_obs of its quantity
or, where the inspection says so, known. A normal prior of a local parameter is one more row,
linear in it; with a population its reading and noise are the shared mean and sd.

A closed form's rows stay formulas (`core.surrogate.closed_form`), its messages are those of
`core.calibration.direct`. A 3-D scan becomes a few rows and a remainder
(`core.calibration.scans`). What the model gets wrong
(`core.discrepancy`) is carried by each row as a gain and an offset in shared parameters.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from core.answers import Input, Stacked
from core.calibration.scans import Dense, Mixing, scan_rows
from core.discrepancy import NONE, Affine, affine
from core.errors import InputError, ModelError
from core.model import Model
from core.network import Parameter
from core.observation import Inspection
from core.readings import digest_of
from core.response import CALIBRATED, Response
from core.surrogate.closed_form import ClosedForm, FormulaRows
from core.surrogate.driven import Driven

Array = NDArray[np.float64]
Rows = Response | FormulaRows
DEGREE = CALIBRATED
MOST_ROWS = 8192  # compiled ones that a model keeps


@dataclass(frozen=True, slots=True)
class BladeRows:
    """A blade's readings, packed.

    response  R rows over all inputs, on the priors' boxes; of a closed form: the formulas
    y         readings, (R,)
    sigma     per row: the name of a shared sigma_obs, or a known value
    extra     per row: variance beside the noise and the surrogate's, (R,) [unit²]
    relative  per row: error in proportion to the model's answer, (R,) [1]
    dense     remainders of scans
    discrepancy  of each row
    digest    of the readings
    populations  (row, name of the shared mean, low, high) of each local parameter with a population
    discount  per row: what its variance is multiplied by, (R,); 1 without forgetting
    effective number of readings that forgetting leaves
    readings  in the order of their rows; of: which of them each row is of, −1 for a prior's
    mixings   of a scan's rows, by the scan's place in `readings`
    """

    response: Rows
    y: Array
    sigma: tuple[str | float, ...]
    extra: Array
    relative: Array
    dense: tuple[Dense, ...]
    discrepancy: tuple[Affine, ...]
    digest: str
    populations: tuple[tuple[int, str, float, float], ...]
    discount: Array
    effective: float
    readings: tuple[Inspection, ...] = ()
    of: tuple[int, ...] = ()
    mixings: Mapping[int, Mixing] = field(default_factory=dict)

    @property
    def polynomials(self) -> Response:
        """The rows where they are polynomials; ModelError for those of a closed form."""
        if isinstance(self.response, Response):
            return self.response
        raise ModelError(
            f"{self.response.model.name} answers by closed formulas, and this needs polynomials "
            "over the whole box: use core.calibration.online"
        )

    @property
    def told(self) -> Counter[str]:
        """How many numbers tell each noise."""
        told = Counter(s for s in self.sigma if isinstance(s, str))
        for d in self.dense:
            if isinstance(d.sigma, str):
                told[d.sigma] += round(d.dof)
        return told

    @property
    def shared(self) -> frozenset[str]:
        """Names of the noises and of the discrepancies' parameters that these rows see."""
        noises = {s for s in (*self.sigma, *(d.sigma for d in self.dense)) if isinstance(s, str)}
        return frozenset(noises.union(*(one.names for one in self.discrepancy)))


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
    asked: dict[tuple[int, str, tuple[int, ...] | None], tuple[Model, set[float]]] = {}
    for reading in readings:
        own = model.for_blade(reading.blade)
        quantity = model.network.quantity(reading.quantity)
        if isinstance(own.surrogate, Driven) and quantity.kind != "vector" and reading.time_h > 0:
            nodes = _node_of(own, reading)
            key = (id(own), reading.quantity, None if nodes is None else tuple(nodes))
            asked.setdefault(key, (own, set()))[1].add(reading.time_h)
    for (_, what, at), (own, hours) in asked.items():
        missing = sorted(h for h in hours if (what, h, at) not in own._rows)
        if len(missing) > 1:
            made = own.part(what).response(what, np.array(missing), at, degree=DEGREE)
            for k, hour in enumerate(missing):
                one = made.rows(np.array([k]))
                _rows(own, (what, hour, at), lambda one=one: one)


def _node_of(model: Model, reading: Inspection) -> list[int] | None:
    quantity = model.network.quantity(reading.quantity)
    if quantity.kind == "scalar":
        return None
    if reading.nodes is not None:
        return [int(n) for n in reading.nodes]
    return [quantity.node_among(model.part(reading.quantity).named)]


def _gaussian_prior_rows(model: Model, like: Rows) -> list[tuple[Rows, Parameter, float | str]]:
    """A row (response, parameter, sd) for each local parameter with a normal prior."""
    found: list[tuple[Rows, Parameter, float | str]] = []
    for name in like.names:
        parameter = model.network.parameter(name)
        drawn = parameter.population is not None or parameter.prior.kind == "normal"
        if parameter.level == "local" and drawn:
            sd = f"sd.{name}" if parameter.population is not None else parameter.prior.sd
            found.append((like.of_input(name), parameter, sd))
    return found


def _inputs(
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


def _answer(model: Model, reading: Inspection) -> Rows:
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
    key = (reading.quantity, reading.time_h, None if nodes is None else tuple(nodes))
    return _rows(model, key, lambda: part.response(reading.quantity, times, nodes, degree=DEGREE))


def _scanned(model: Model, reading: Inspection, modes: Array) -> Response:
    """The rows of a scan's modes at its nodes, R (Q, B)."""
    assert reading.nodes is not None
    key = (reading.quantity, reading.time_h, "scan", reading.nodes.tobytes())
    part = model.part(reading.quantity)
    return _rows(model, key, lambda: part.mode_response(reading.time_h, modes, degree=DEGREE))


def _stacked(parts: Sequence[Rows]) -> Rows:
    """All rows of a blade as one; ModelError where formulas and polynomials would mix."""
    formulas = [p for p in parts if isinstance(p, FormulaRows)]
    if not formulas:
        return Response.stack([p for p in parts if isinstance(p, Response)])
    if len(formulas) < len(parts):
        raise ModelError(
            f"readings of one blade are answered by {formulas[0].model.name}, a closed form, and "
            "by a surrogate: give each model's readings to a blade of its own"
        )
    return FormulaRows.stack(formulas)


def assemble(model: Model, readings: Sequence[Inspection]) -> BladeRows | None:
    """The rows of one blade; None where it has no reading."""
    if not readings:
        return None
    model = model.for_blade(readings[0].blade)
    names = _inputs(model, readings)
    parts: list[Rows] = []
    y: list[Array] = []
    sigma: list[str | float] = []
    dense: list[Dense] = []
    extra: list[Array] = []
    relative: list[float] = []
    wrong: list[Affine] = []
    discount: list[float] = []
    latest = max(r.time_h for r in readings)

    def age(reading: Inspection) -> float:
        """In half-lives, from the component's latest reading."""
        half_life = model.network.forgetting_h
        return 0.0 if half_life is None else (latest - reading.time_h) / half_life

    in_order = tuple(sorted(readings, key=lambda i: (i.time_h, i.id)))
    of: list[int] = []
    mixings: dict[int, Mixing] = {}
    for place, reading in enumerate(in_order):
        quantity = model.network.quantity(reading.quantity)
        name = reading.sigma if reading.sigma is not None else quantity.sigma_of(reading.instrument)
        if quantity.kind == "vector":
            scan = scan_rows(model, reading, name, partial(_scanned, model, reading))
            response: Rows = scan.response
            values = scan.y
            dense.append(scan.dense)
            extra.append(scan.extra)
            relative += [0.0] * len(response)
            wrong += scan.discrepancy
            mixings[place] = scan.mixing
        else:
            response, values = _answer(model, reading), reading.values
            reader = (reading.instrument, reading.campaign)
            one = affine(model, quantity, reading.time_h, None, reader)
            extra.append(np.array([one.sigma**2]))
            relative.append(math.hypot(quantity.numerical, one.left))
            wrong.append(one)
        parts.append(response if names is None else response.over(*names))
        y.append(values)
        sigma += [name] * len(response)
        of += [place] * len(response)
        discount += [2.0 ** age(reading)] * len(response)
    populations = []
    for row, parameter, sd in _gaussian_prior_rows(model, parts[0]):
        prior = parameter.prior
        if parameter.population is not None:
            populations.append((len(sigma), f"mean.{parameter.name}", prior.low, prior.high))
        parts.append(row)
        y.append(np.array([prior.mean]))
        sigma.append(sd)
        extra.append(np.zeros(1))
        relative.append(0.0)
        wrong.append(NONE)
        discount.append(1.0)
    weight = np.array(discount)
    return BladeRows(
        _stacked(parts).scattered(np.sqrt(weight)),
        np.concatenate(y),
        tuple(sigma),
        np.concatenate(extra),
        np.array(relative),
        tuple(dense),
        tuple(wrong),
        digest_of(readings),
        tuple(populations),
        weight,
        sum(0.5 ** age(reading) for reading in readings),
        in_order,
        (*of, *([-1] * (len(sigma) - len(of)))),
        mixings,
    )
