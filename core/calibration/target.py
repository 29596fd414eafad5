"""The joint target, blade by blade: readings packed as rows for the compiled messages.

A blade's rows are polynomials of the model's inputs, scaled to the boxes of the priors
(`core.calibration.responses`); each row has a reading and a noise, which is a shared parameter
sigma_obs of its quantity or, where the inspection says so, known. A normal prior of a local
parameter is one more row, linear in it; with a population its reading and noise are the shared mean
and sd.

A closed form's rows stay formulas (`core.surrogate.closed_form`), its messages are those of
`core.calibration.direct`. A 3-D scan becomes a few rows and a remainder
(`core.calibration.scans`). What the model gets wrong
(`core.discrepancy`) is carried by each row as a gain and an offset in shared parameters.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from core.calibration.responses import Rows, answer, inputs_of, scanned
from core.calibration.scans import Dense, Mixing, scan_rows
from core.discrepancy import NONE, Affine, affine
from core.errors import ModelError
from core.model import Model
from core.network import Parameter
from core.observation import Inspection
from core.readings import digest_of
from core.response import Response
from core.surrogate.closed_form import FormulaRows

Array = NDArray[np.float64]
FORGOTTEN = 100.0  # half-lives after which a reading counts no less: 1e-30 is nothing, 0 no number


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
    names = inputs_of(model, readings)
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
            scan = scan_rows(model, reading, name, partial(scanned, model, reading))
            response: Rows = scan.response
            values = scan.y
            dense.append(scan.dense)
            extra.append(scan.extra)
            relative += [0.0] * len(response)
            wrong += scan.discrepancy
            mixings[place] = scan.mixing
        else:
            response, values = answer(model, reading), reading.values
            reader = (reading.instrument, reading.campaign)
            one = affine(model, quantity, reading.time_h, None, reader)
            extra.append(np.array([one.sigma**2]))
            relative.append(math.hypot(quantity.numerical, one.left))
            wrong.append(one)
        parts.append(response if names is None else response.over(*names))
        y.append(values)
        sigma += [name] * len(response)
        of += [place] * len(response)
        discount += [2.0 ** min(age(reading), FORGOTTEN)] * len(response)
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
