"""Readings as they are posted: one, many, CSV or SensorThings; every fault of every one is told.

A row with a field that cannot be read is asked for its other faults as well: the field is left out,
or where it has to be there another value stands in for it, and what is then said of this field, or
follows from it, is dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import (
    ConfigDict,
    Discriminator,
    Field,
    FiniteFloat,
    Tag,
    ValidationError,
    model_validator,
)
from pydantic.config import JsonValue
from pydantic_core import PydanticCustomError, from_json

from core.errors import InputError
from core.observation import Inspection
from service.api.csv_rows import csv_rows
from service.api.problems import (
    MOST_FAULTS,
    MOST_READINGS,
    Fault,
    RequestError,
    fault,
    fault_of,
    faults_of_validation,
    invalid,
    too_many,
)
from service.api.repeated import refuse_repeated
from service.api.schemas import Body, Id, Moment, Text
from service.api.sensorthings import sensorthings_rows
from service.export.sensorthings import MEDIA
from service.handlers.inspections import Item

MOST_VALUES, MOST_PARTS = 100_000, 16  # nodes of a scan; components of a vector
Parts = Annotated[list[FiniteFloat], Field(max_length=MOST_PARTS)]
Values = Annotated[
    Annotated[list[Parts], Tag("vector"), Field(max_length=MOST_VALUES)]
    | Annotated[list[FiniteFloat], Tag("scalar"), Field(max_length=MOST_VALUES)],
    Discriminator(lambda v: "vector" if isinstance(v, list) and v and _is_list(v[0]) else "scalar"),
]


def _is_list(value: object) -> bool:
    return isinstance(value, list)


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
    nodes: Annotated[
        list[Annotated[int, Field(ge=0, lt=2**31)]] | None, Field(max_length=MOST_VALUES)
    ] = None
    unit: Text | None = None
    sigma: Annotated[FiniteFloat, Field(gt=0)] | None = None
    instrument: Text | None = None
    campaign: Text | None = None
    observed_at: Moment | None = None
    replaces: Id | None = None

    @model_validator(mode="after")
    def _one_of(self) -> Self:
        if self.value is None and self.values is None:
            raise PydanticCustomError("no_value", "is missing")
        if self.value is not None and self.values is not None:
            raise PydanticCustomError("two_values", "stands beside `values`")
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


VALUE = ("value", "values", "nodes")
MOST_FIELDS = 100  # of a reading: those that are not known are told one by one
UNREAD = "unread"
STAND_INS: dict[str, Any] = {
    "id": UNREAD, "blade": UNREAD, "quantity": UNREAD, "time_h": 0.0, "value": 0.0
}  # fmt: skip


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
    rows: list[tuple[str, Any]]
    faults: list[Fault] = []
    if kind == "text/csv":
        rows, faults = csv_rows(body)
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
    if len(rows) > MOST_READINGS:
        raise too_many(len(rows), MOST_READINGS)
    items: list[Item] = []
    unread: dict[str, frozenset[str]] = {}  # fields that were not read, by the place of their row
    for where, row in rows:
        if isinstance(row, dict) and len(row) > MOST_FIELDS:
            remedy = f"give the fields of a reading: {', '.join(InspectionIn.model_fields)}"
            told = f"{len(row)} fields"
            faults.append(fault(where.rstrip(".") or "body", told, "are too many", remedy))
            raise invalid(faults)
        try:
            items.append(Item(where, InspectionIn.model_validate(row).reading()))
        except ValidationError as error:
            if len(faults) + error.error_count() > MOST_FAULTS:
                faults += faults_of_validation(
                    error.errors()[: MOST_FAULTS + 1], InspectionIn, where
                )
                raise invalid(faults) from None
            faults += faults_of_validation(error.errors(), InspectionIn, where)
            fields = _fields(error)
            if (rest := _rest(row, fields)) is not None:
                items.append(Item(where, rest))
                unread[where] = fields
    if faults:
        more = also(items) if also and items else ()
        raise invalid([*faults, *(fault_of(one) for one in more if not _follows(one.what, unread))])
    return items


def _fields(error: ValidationError) -> frozenset[str]:
    """The row's fields that an error is of; those of its value stand or fall together."""
    found = {str(one["loc"][0]) if one["loc"] else VALUE[0] for one in error.errors()}
    return frozenset(found | (set(VALUE) if found & set(VALUE) else set()))


def _rest(row: Any, fields: frozenset[str]) -> Inspection | None:
    """What a row says without these fields; None where that is no reading either."""
    if not isinstance(row, dict):
        return None
    kept = {name: value for name, value in row.items() if name not in fields}
    instead = {name: value for name, value in STAND_INS.items() if name in fields}
    try:
        return InspectionIn.model_validate(kept | instead).reading()
    except ValidationError:
        return None


def _follows(what: str, unread: Mapping[str, frozenset[str]]) -> bool:
    """Whether a fault is of a field that was not read.

    >>> [_follows(f"inspections[0].{f}", {"inspections[0].": {"value"}}) for f in ("unit", "value")]
    [False, True]
    """
    return any(
        what.startswith(where) and what[len(where) :].split("[")[0] in fields
        for where, fields in unread.items()
    )


def _json_rows(body: bytes) -> list[tuple[str, Any]]:
    try:
        data = from_json(body, allow_inf_nan=True)
    except ValueError as error:
        raise RequestError(400, "invalid-json", f"the body is not JSON: {error}") from None
    refuse_repeated(body, data)
    if isinstance(data, list):
        remedy = 'give {"inspections": […]} for several, or one reading as an object'
        raise invalid([fault("body", f"a list of {len(data)}", "is not a batch", remedy)])
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
    if len(rows) > MOST_READINGS:
        raise too_many(len(rows), MOST_READINGS)
    return [(f"inspections[{i}].", row) for i, row in enumerate(rows)]
