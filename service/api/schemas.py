"""What requests may hold. Unknown fields are refused, numbers are numbers and finite.

JSON's ``NaN`` and ``Infinity``, which some writers emit, are read and then refused by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Annotated, Any, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    FiniteFloat,
    StringConstraints,
    Tag,
    ValidationError,
    model_validator,
)
from pydantic.config import JsonValue
from pydantic_core import from_json

from core.errors import InputError
from core.observation import Inspection
from service.api.csv_rows import csv_rows
from service.api.problems import Fault, RequestError, fault, fault_of, faults_of_validation, invalid
from service.api.sensorthings import sensorthings_rows
from service.export.sensorthings import MEDIA
from service.handlers.inspections import Item
from service.hooks import Kind
from service.names import ID_PATTERN, TEXT_PATTERN

Id = Annotated[str, StringConstraints(max_length=100, pattern=ID_PATTERN)]
Text = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=TEXT_PATTERN)]


def _moment(text: str) -> str:
    if datetime.fromisoformat(text).tzinfo is None:
        raise ValueError("a moment needs its offset, e.g. 2031-05-04T10:00:00Z")
    return text


Moment = Annotated[str, StringConstraints(max_length=40), AfterValidator(_moment)]
Values = Annotated[
    Annotated[list[list[FiniteFloat]], Tag("vector")] | Annotated[list[FiniteFloat], Tag("scalar")],
    Discriminator(lambda v: "vector" if isinstance(v, list) and v and _is_list(v[0]) else "scalar"),
]


def _is_list(value: object) -> bool:
    return isinstance(value, list)


class Body(BaseModel):
    """A body or a part of one."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


READINGS: list[JsonValue] = [
    {
        "id": "i1",
        "blade": "B01",
        "quantity": "elongation",
        "time_h": 8000,
        "value": 0.11,
        "unit": "mm",
        "instrument": "gauge 3",
        "campaign": "outage 2031",
        "observed_at": "2031-05-04T10:00:00Z",
    },
    {
        "id": "i2",
        "blade": "B02",
        "quantity": "deformation",
        "time_h": 8000,
        "nodes": [12, 13],
        "values": [[0.01, -0.02, 0.11], [0.01, -0.02, 0.12]],
        "unit": "mm",
        "sigma": 0.02,
    },
]


class InspectionIn(Body):
    """One reading."""

    model_config = ConfigDict(json_schema_extra={"examples": READINGS})

    id: Id
    blade: Id
    quantity: Id
    time_h: FiniteFloat
    value: FiniteFloat | None = None
    values: Values | None = None
    nodes: list[Annotated[int, Field(ge=0, lt=2**31)]] | None = None
    unit: Text | None = None
    sigma: Annotated[FiniteFloat, Field(gt=0)] | None = None
    instrument: Text | None = None
    campaign: Text | None = None
    observed_at: Moment | None = None
    replaces: Id | None = None

    @model_validator(mode="after")
    def _one_of(self) -> Self:
        if (self.value is None) == (self.values is None):
            raise ValueError("give either `value`, or `values` with `nodes`")
        widths = {len(row) for row in self.values or [] if isinstance(row, list)}
        if len(widths) > 1:
            raise ValueError(f"rows of `values` have different lengths {sorted(widths)}")
        return self

    def reading(self) -> Inspection:
        values = [self.value] if self.values is None else self.values
        return Inspection(
            id=self.id,
            blade=self.blade,
            quantity=self.quantity,
            time_h=float(self.time_h),
            values=np.array(values, dtype=np.float64),
            nodes=None if self.nodes is None else np.array(self.nodes, dtype=np.int64),
            unit=self.unit,
            sigma=self.sigma,
            instrument=self.instrument,
            campaign=self.campaign,
            observed_at=self.observed_at,
            replaces=self.replaces,
        )


class ModelIn(Body):
    """A model to register."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"builtin": "rotor-blade"}]})

    builtin: Id


HOOKS: list[JsonValue] = [
    {"id": "ops", "url": "https://plant.example/twin", "events": ["blocked", "alarm"]}
]


class WebhookIn(Body):
    """Where to send what happens to rotors; `events` and `rotors` left out: all."""

    model_config = ConfigDict(json_schema_extra={"examples": HOOKS})

    id: Id
    url: Annotated[str, StringConstraints(min_length=1, max_length=2000)]
    events: list[Kind] | None = Field(None, min_length=1, max_length=10)
    rotors: list[Id] | None = Field(None, min_length=1, max_length=10_000)


class Nothing(Body):
    """A body without fields."""


def read_inspections(
    body: bytes,
    content_type: str,
    also: Callable[[Sequence[Item]], Sequence[InputError]] | None = None,
) -> list[Item]:
    """The readings of a request, by its media type. RequestError lists every fault.

    also  what else keeps readings out: asked of those that can be read where others cannot, so
          that whoever posts many is told all at once
    """
    kind = content_type.split(";")[0].strip().lower()
    if kind == "text/csv":
        rows = csv_rows(body)
    elif kind == MEDIA:
        rows = sensorthings_rows(body)
    elif kind in ("", "application/json"):
        rows = _json_rows(body)
    else:
        raise RequestError(
            415,
            "unsupported-media-type",
            f"{kind!r} is not read; post application/json, text/csv or {MEDIA}",
        )
    items: list[Item] = []
    faults: list[Fault] = []
    for where, row in rows:
        try:
            items.append(Item(where, InspectionIn.model_validate(row).reading()))
        except ValidationError as error:
            faults += faults_of_validation(error.errors(), where)
    if faults:
        raise invalid([*faults, *map(fault_of, also(items) if also and items else ())])
    return items


def _json_rows(body: bytes) -> list[tuple[str, Any]]:
    try:
        data = from_json(body, allow_inf_nan=True)
    except ValueError as error:
        raise RequestError(400, "invalid-json", f"the body is not JSON: {error}") from None
    if not (isinstance(data, dict) and "inspections" in data):
        return [("", data)]
    rows = data["inspections"]
    unknown = [name for name in data if name != "inspections"]
    if unknown:
        remedy = "a batch holds `inspections` and nothing else"
        raise invalid([fault(unknown[0], data[unknown[0]], "is not known", remedy)])
    if not isinstance(rows, list) or not rows:
        raise invalid(
            [fault("inspections", rows, "is not a list of readings", "give at least one")]
        )
    return [(f"inspections[{i}].", row) for i, row in enumerate(rows)]
