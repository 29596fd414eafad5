"""Readings as SensorThings entities: what a body holds, as the fields that JSON would have.

Read are, all of the same media type (`service.export.sensorthings.MEDIA`),

    a document      ``{"value": [Datastream with Observations, …]}``, as ``?format=sensorthings``
                    writes it
    an Observation  ``{"@iot.id", "result", "phenomenonTime"?, "parameters", "Datastream"}``
    data arrays     ``[{"Datastream", "components", "dataArray"}, …]``, the body of the standard's
                    CreateObservations; a component is a field of an Observation, ``id`` or
                    ``parameters/NAME``

What a Datastream says of its Observations: `service.api.datastreams`. `resultTime`, links, names
and descriptions are the sender's own and not kept; what the standard knows and a reading has no
place for is refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic_core import from_json

from service.api.datastreams import STREAM, Datastreams
from service.api.problems import (
    MOST_READINGS,
    RequestError,
    invalid,
    too_many,
)
from service.api.repeated import refuse_repeated
from service.export.sensorthings import SAID

Json = dict[str, Any]
Rows = list[tuple[str, Json]]
EXAMPLE = {
    "@iot.id": "i4",
    "phenomenonTime": "2031-05-04T10:00:00Z",
    "result": 0.11,
    "parameters": {"time_h": 8000},
    "Datastream": {"@iot.id": "B01/elongation/gauge 3"},
}
ARRAY_EXAMPLE = [
    {
        "Datastream": {"@iot.id": "B01/elongation/gauge 3"},
        "components": ["id", "phenomenonTime", "result", "parameters/time_h"],
        "dataArray": [["i5", "2031-05-04T10:00:00Z", 0.11, 8000]],
    }
]
OBSERVED = ("@iot.id", "phenomenonTime", "resultTime", "result", "parameters", "Datastream")
ARRAY = ("Datastream", "components", "dataArray", "dataArray@iot.count")
PARAMETERS = ("time_h", *SAID, "observed_at", "unit")


def sensorthings_rows(body: bytes) -> Rows:
    """The readings of a body and the place of each. RequestError lists every fault."""
    try:
        data = from_json(body, allow_inf_nan=True)
    except ValueError as error:
        raise RequestError(400, "invalid-json", f"the body is not JSON: {error}") from None
    refuse_repeated(body, data)
    reader = _Reader()
    if isinstance(data, list):
        reader.arrays(data)
    elif isinstance(data, dict) and "value" in data:
        reader.document(data)
    else:
        reader.single(data)
    if not reader.rows and not reader.faults:
        reader.say("body", None, "holds no Observation", "give at least one reading")
    if reader.faults:
        raise invalid(reader.faults)
    return reader.rows


class _Reader(Datastreams):
    """Collects readings and faults."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: Rows = []

    def document(self, data: Json) -> None:
        self.known("", data, ("value",))
        for where, one in self.list_of("value", data["value"], "Datastreams"):
            stream = self.object_of(where, one)
            if not stream:
                continue
            self.known(f"{where}.", stream, (*STREAM, "Observations"))
            head = self.stream(f"{where}.", stream)
            if "Observations" not in stream:
                self.say(f"{where}.Observations", None, "is missing", "give the Observations")
                continue
            listed = self.list_of(f"{where}.Observations", stream["Observations"], "Observations")
            for place, observed in listed:
                self._observation(f"{place}.", self.object_of(place, observed), head, OBSERVED[:-1])

    def single(self, data: object) -> None:
        told = self.object_of("body", data)
        if told:
            head = self.inner("", told)
            self._observation("", told, head, OBSERVED)

    def arrays(self, data: list[Any]) -> None:
        for place, one in self.list_of("", data, "data arrays"):
            group = self.object_of(place, one)
            if not group:
                continue
            where = f"{place}."
            self.known(where, group, ARRAY)
            head = self.inner(where, group)
            names = group.get("components")
            if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
                self.say(f"{where}components", names, "is no list of names", "name the columns")
                continue
            if len(set(names)) < len(names):
                self.say(f"{where}components", names, "names one twice", "give each column once")
                continue
            rows = group.get("dataArray")
            there = len(rows) if isinstance(rows, list) else 0
            count = group.get("dataArray@iot.count", there)
            if count != there:
                remedy = "send all of them, or leave the count out"
                self.say(f"{where}dataArray@iot.count", count, f"are not {there} rows", remedy)
            for row_place, row in self.list_of(f"{where}dataArray", rows, "rows"):
                if not isinstance(row, list) or len(row) != len(names):
                    problem = f"is no list of {len(names)} values"
                    self.say(row_place, row, problem, "give a value for each component")
                    continue
                told = _told(zip(names, row, strict=True))
                self._observation(f"{row_place}.", told, head, OBSERVED[:-1])

    def _observation(
        self, where: str, told: Json, head: Json | None, known: tuple[str, ...]
    ) -> None:
        before = len(self.faults)
        self.known(where, told, known)
        for name in ("@iot.id", "result"):
            if told.get(name) is None:
                self.say(f"{where}{name}", None, "is missing", "give it")
        given = self.object_of(f"{where}parameters", told.get("parameters", {}))
        self.known(f"{where}parameters.", given, PARAMETERS)
        if given.get("time_h") is None:
            remedy = "give the blade's operating hours: no calendar moment tells them"
            self.say(f"{where}parameters.time_h", None, "is missing", remedy)
        for name, place in (("observed_at", "phenomenonTime"), ("unit", "unitOfMeasurement")):
            if given.get(name) is not None:
                problem = "is null, for `not told`, or left out"
                self.say(f"{where}parameters.{name}", given[name], problem, f"use {place}")
        at = told.get("phenomenonTime")
        if isinstance(at, str) and "/" in at:
            remedy = "give the moment of the reading"
            self.say(f"{where}phenomenonTime", at, "is an interval", remedy)
        if head is None or len(self.faults) > before:
            return
        row = {"id": told["@iot.id"]} | head | given
        if "observed_at" not in given and at is not None:
            row["observed_at"] = at
        result = told["result"]
        row["values" if isinstance(result, list) else "value"] = result
        self.rows.append((where, row))
        if len(self.rows) > MOST_READINGS:
            raise too_many(len(self.rows), MOST_READINGS)


def _told(cells: Iterator[tuple[str, Any]]) -> Json:
    """An Observation of the cells of a row.

    >>> _told(iter([("id", "i1"), ("result", 0.1), ("parameters/time_h", 8e3)]))
    {'@iot.id': 'i1', 'result': 0.1, 'parameters': {'time_h': 8000.0}}
    """
    told: Json = {}
    given: Json = {}
    for name, value in cells:
        inner = name.removeprefix("parameters/")
        if inner == name:
            told["@iot.id" if name == "id" else name] = value
        elif value is not None or inner in ("observed_at", "unit"):
            given[inner] = value
    whole = told.get("parameters") or {}
    if given and isinstance(whole, dict):
        told["parameters"] = whole | given
    return told
