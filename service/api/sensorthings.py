"""Readings as SensorThings entities: what a body holds, as the fields that JSON would have.

Read are, all of the same media type (`service.export.sensorthings.MEDIA`),

    a document      ``{"value": [Datastream with Observations, …]}``, as ``?format=sensorthings``
                    writes it
    an Observation  ``{"@iot.id", "result", "phenomenonTime"?, "parameters", "Datastream"}``
    data arrays     ``[{"Datastream", "components", "dataArray"}, …]``, the body of the standard's
                    CreateObservations; a component is a field of an Observation, ``id`` or
                    ``parameters/NAME``

A Datastream names blade, quantity and instrument by its id, or by its Thing, ObservedProperty and
Sensor; where it does both they have to agree. `resultTime`, links, names and descriptions are the
sender's own and not kept; what the standard knows and a reading has no place for is refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic_core import from_json

from service.api.problems import (
    MOST_FAULTS,
    MOST_READINGS,
    Fault,
    RequestError,
    fault,
    invalid,
    too_many,
)
from service.export.sensorthings import PREDICTION, SAID, stream_id

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
OWN = re.compile(r"(@iot\.selfLink|\w+@iot\.(navigationLink|nextLink|count))")
OBSERVED = ("@iot.id", "phenomenonTime", "resultTime", "result", "parameters", "Datastream")
STREAM = (
    *("@iot.id", "name", "description", "observationType", "unitOfMeasurement", "observedArea"),
    *("phenomenonTime", "resultTime", "properties", "Thing", "Sensor", "ObservedProperty"),
)
ARRAY = ("Datastream", "components", "dataArray", "dataArray@iot.count")
PARAMETERS = ("time_h", *SAID, "observed_at", "unit")
NO_PLACE = {
    "FeatureOfInterest": "leave it out: the blade is observed, at `parameters.nodes`",
    "resultQuality": "give the noise's sd as `parameters.sigma`, or leave it out",
    "validTime": "leave it out, or retract the reading when it is no longer valid",
}
ENTITIES = (("Thing", 0, "blade"), ("ObservedProperty", 1, "quantity"), ("Sensor", 2, "instrument"))
IS_NO_OBJECT = ("is no object", "see GET …/inspections?format=sensorthings")


def sensorthings_rows(body: bytes) -> Rows:
    """The readings of a body and the place of each. RequestError lists every fault."""
    try:
        data = from_json(body, allow_inf_nan=True)
    except ValueError as error:
        raise RequestError(400, "invalid-json", f"the body is not JSON: {error}") from None
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


class _Reader:
    """Collects readings and faults."""

    def __init__(self) -> None:
        self.rows: Rows = []
        self.faults: list[Fault] = []

    def say(self, where: str, value: object, problem: str, remedy: str) -> None:
        self.faults.append(fault(where, value, problem, remedy))
        if len(self.faults) > MOST_FAULTS:
            raise invalid(self.faults)

    def _object(self, where: str, value: object) -> Json:
        if isinstance(value, dict):
            return value
        self.say(where, value, *IS_NO_OBJECT)
        return {}

    def _list(self, where: str, value: object, of: str) -> Iterator[tuple[str, Any]]:
        if not isinstance(value, list):
            self.say(where, value, f"is no list of {of}", "give a list")
            return
        yield from ((f"{where}[{i}]", one) for i, one in enumerate(value))

    def _known(self, where: str, given: Mapping[str, Any], known: tuple[str, ...]) -> None:
        for name in given:
            if name in known or OWN.fullmatch(name):
                continue
            if name in NO_PLACE:
                self.say(where + name, given[name], "has no place in a reading", NO_PLACE[name])
            else:
                self.say(where + name, given[name], "is not known", f"use {', '.join(known)}")

    def document(self, data: Json) -> None:
        self._known("", data, ("value",))
        for where, one in self._list("value", data["value"], "Datastreams"):
            stream = self._object(where, one)
            if not stream:
                continue
            self._known(f"{where}.", stream, (*STREAM, "Observations"))
            head = self._stream(f"{where}.", stream)
            if "Observations" not in stream:
                self.say(f"{where}.Observations", None, "is missing", "give the Observations")
                continue
            listed = self._list(f"{where}.Observations", stream["Observations"], "Observations")
            for place, observed in listed:
                self._observation(f"{place}.", self._object(place, observed), head, OBSERVED[:-1])

    def single(self, data: object) -> None:
        told = self._object("body", data)
        if told:
            head = self._inner("", told)
            self._observation("", told, head, OBSERVED)

    def arrays(self, data: list[Any]) -> None:
        for place, one in self._list("", data, "data arrays"):
            group = self._object(place, one)
            if not group:
                continue
            where = f"{place}."
            self._known(where, group, ARRAY)
            head = self._inner(where, group)
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
            for row_place, row in self._list(f"{where}dataArray", rows, "rows"):
                if not isinstance(row, list) or len(row) != len(names):
                    problem = f"is no list of {len(names)} values"
                    self.say(row_place, row, problem, "give a value for each component")
                    continue
                told = _told(zip(names, row, strict=True))
                self._observation(f"{row_place}.", told, head, OBSERVED[:-1])

    def _inner(self, where: str, told: Json) -> Json | None:
        """Blade, quantity, instrument and unit by the Datastream beside the values."""
        if "Datastream" not in told:
            remedy = 'name it, e.g. {"@iot.id": "B01/elongation"}'
            self.say(f"{where}Datastream", None, "is missing", remedy)
            return None
        stream = self._object(f"{where}Datastream", told["Datastream"])
        self._known(f"{where}Datastream.", stream, STREAM)
        return self._stream(f"{where}Datastream.", stream) if stream else None

    def _stream(self, where: str, stream: Json) -> Json | None:
        before = len(self.faults)
        kind = stream.get("properties")
        if isinstance(kind, dict) and kind.get("kind") == PREDICTION:
            remedy = "post what was measured"
            self.say(f"{where}properties.kind", PREDICTION, "was not read by anybody", remedy)
        named = self._named(f"{where}@iot.id", stream["@iot.id"]) if "@iot.id" in stream else None
        found: list[Any] = []
        for entity, at, what in ENTITIES:
            one = stream.get(entity)
            told = None
            if one is not None:
                one = self._object(f"{where}{entity}", one)
                told = one.get("@iot.id", one.get("name") if named is None else None)
                if told is not None and not isinstance(told, str):
                    self.say(f"{where}{entity}", told, "is no name", f"name the {what}")
                    continue
            if named is None and told is None and at < 2:
                remedy = f"name the {what}, or give the Datastream its @iot.id: blade/quantity"
                self.say(f"{where}{entity}", None, "is missing", remedy)
            if named is not None and told is not None and told != named[at]:
                problem = f"is not {named[at]!r}, as the Datastream's @iot.id says"
                self.say(f"{where}{entity}", told, problem, "let both say the same")
            found.append(told if named is None else named[at])
        head: Json = {}
        if len(found) == len(ENTITIES):
            head = {w: v for (_, _, w), v in zip(ENTITIES, found, strict=True) if v is not None}
        unit = stream.get("unitOfMeasurement")
        if unit is not None:
            symbol = self._object(f"{where}unitOfMeasurement", unit).get("symbol")
            head |= {} if symbol is None else {"unit": symbol}
        return head if len(self.faults) == before else None

    def _named(self, where: str, name: object) -> tuple[str, str, str | None] | None:
        parts = name.split("/", 2) if isinstance(name, str) else []
        if len(parts) < 2 or not all(parts):
            remedy = "write blade/quantity or blade/quantity/instrument"
            self.say(where, name, "is no Datastream of a rotor", remedy)
            return None
        blade, quantity, instrument = (*parts, None)[:3]
        assert stream_id(str(blade), str(quantity), instrument) == name
        return str(blade), str(quantity), instrument

    def _observation(
        self, where: str, told: Json, head: Json | None, known: tuple[str, ...]
    ) -> None:
        before = len(self.faults)
        self._known(where, told, known)
        for name in ("@iot.id", "result"):
            if told.get(name) is None:
                self.say(f"{where}{name}", None, "is missing", "give it")
        given = self._object(f"{where}parameters", told.get("parameters", {}))
        self._known(f"{where}parameters.", given, PARAMETERS)
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
