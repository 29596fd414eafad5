"""Datastreams of SensorThings: whose readings their Observations are, and faults of both.

A Datastream names blade, quantity and instrument by its id, ``blade/quantity`` or
``blade/quantity/instrument``, or by its Thing, ObservedProperty and Sensor; where it does both they
have to agree. Its unit of measurement is the readings' unit. One that holds predictions was not
read by anybody.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from service.api.problems import MOST_FAULTS, Fault, fault, invalid
from service.export.sensorthings import PREDICTION, stream_id

Json = dict[str, Any]
OWN = re.compile(r"(@iot\.selfLink|\w+@iot\.(navigationLink|nextLink|count))")
STREAM = (
    *("@iot.id", "name", "description", "observationType", "unitOfMeasurement", "observedArea"),
    *("phenomenonTime", "resultTime", "properties", "Thing", "Sensor", "ObservedProperty"),
)
NO_PLACE = {
    "FeatureOfInterest": "leave it out: the blade is observed, at `parameters.nodes`",
    "resultQuality": "give the noise's sd as `parameters.sigma`, or leave it out",
    "validTime": "leave it out, or retract the reading when it is no longer valid",
}
ENTITIES = (("Thing", 0, "blade"), ("ObservedProperty", 1, "quantity"), ("Sensor", 2, "instrument"))
IS_NO_OBJECT = ("is no object", "see GET …/inspections?format=sensorthings")


class Datastreams:
    """Reads Datastreams and what is around them, and collects faults."""

    def __init__(self) -> None:
        self.faults: list[Fault] = []

    def say(self, where: str, value: object, problem: str, remedy: str) -> None:
        """One fault more; more than `MOST_FAULTS` end the reading."""
        self.faults.append(fault(where, value, problem, remedy))
        if len(self.faults) > MOST_FAULTS:
            raise invalid(self.faults)

    def object_of(self, where: str, value: object) -> Json:
        """The value, if it is an object; else a fault, and an empty one."""
        if isinstance(value, dict):
            return value
        self.say(where, value, *IS_NO_OBJECT)
        return {}

    def list_of(self, where: str, value: object, of: str) -> Iterator[tuple[str, Any]]:
        """What a list holds, each with its place; a fault where it is none."""
        if not isinstance(value, list):
            self.say(where, value, f"is no list of {of}", "give a list")
            return
        yield from ((f"{where}[{i}]", one) for i, one in enumerate(value))

    def known(self, where: str, given: Mapping[str, Any], known: tuple[str, ...]) -> None:
        """A fault for each name that is not among these, and not the sender's own."""
        for name in given:
            if name in known or OWN.fullmatch(name):
                continue
            if name in NO_PLACE:
                self.say(where + name, given[name], "has no place in a reading", NO_PLACE[name])
            else:
                self.say(where + name, given[name], "is not known", f"use {', '.join(known)}")

    def inner(self, where: str, told: Json) -> Json | None:
        """Blade, quantity, instrument and unit by the Datastream beside the values."""
        if "Datastream" not in told:
            remedy = 'name it, e.g. {"@iot.id": "B01/elongation"}'
            self.say(f"{where}Datastream", None, "is missing", remedy)
            return None
        stream = self.object_of(f"{where}Datastream", told["Datastream"])
        self.known(f"{where}Datastream.", stream, STREAM)
        return self.stream(f"{where}Datastream.", stream) if stream else None

    def stream(self, where: str, stream: Json) -> Json | None:
        """Blade, quantity, instrument and unit of a Datastream; None: it has a fault."""
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
                one = self.object_of(f"{where}{entity}", one)
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
            symbol = self.object_of(f"{where}unitOfMeasurement", unit).get("symbol")
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
