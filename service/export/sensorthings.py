"""Readings and predictions as SensorThings entities (OGC 15-078r6 and 18-088, Sensing 1.1).

A document is what a SensorThings service answers to
``GET /Datastreams?$expand=Thing,Sensor,ObservedProperty,Observations``::

    {"value": [{"@iot.id": "B01/elongation/gauge 3", "Thing": …, "Observations": […]}, …]}

    Datastream        the readings of one quantity of one blade by one instrument; its id says so:
                      ``blade/quantity`` or ``blade/quantity/instrument``
    Thing             the blade           Sensor   the instrument; without an id: none was named
    ObservedProperty  the quantity        unitOfMeasurement   the quantity's
    Observation       a reading: its id, `result` (a number, or x, y, z for each node of a scan) and
                      in `parameters` what the standard has no field for

The standard knows calendar moments and no operating hours, so `parameters.time_h` has those. Where
a reading names no moment, `phenomenonTime` is the one at which it was received, as the standard
has it for devices without a clock, and ``parameters.observed_at: null`` says so; likewise
``parameters.unit: null`` of a reading that named no unit. So what is written can be read back as
the very same reading (`service.api.sensorthings`).

Nor is the calendar moment of a predicted hour known: there `phenomenonTime` and `resultTime` are
the moment at which the version was computed, and `result` is the mean.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from core.network import Network
from service.ports import BladeRecord

Json = dict[str, Any]
MEDIA = "application/vnd.bladetwin.sensorthings+json"
MEASUREMENT = "http://www.opengis.net/def/observationType/OGC-OM/2.0/OM_Measurement"
ANY_RESULT = "http://www.opengis.net/def/observationType/OGC-OM/2.0/OM_Observation"
UCUM = "https://ucum.org/ucum"
PREDICTION = "prediction"
SAID = ("sigma", "campaign", "nodes", "replaces")
HEAD, TAIL = '{"value": [', "]}\n"


def stream_id(blade: str, quantity: str, instrument: str | None) -> str:
    """The id of a Datastream; blades and quantities have no slash in their names.

    >>> stream_id("B01", "elongation", "gauge 3/b")
    'B01/elongation/gauge 3/b'
    """
    return "/".join([blade, quantity] + ([] if instrument is None else [instrument]))


def datastreams(
    rotor: str,
    network: Network,
    blade: BladeRecord,
    readings: Sequence[tuple[Mapping[str, Any], str]],
) -> list[Json]:
    """The Datastreams of a blade, each with its Observations in the order of arrival.

    readings   each with the moment at which it was received
    """
    found: dict[str, Json] = {}
    for body, received_at in readings:
        quantity, instrument = body["quantity"], body.get("instrument")
        name = stream_id(blade.id, quantity, instrument)
        if name not in found:
            found[name] = {"@iot.id": name} | _entities(rotor, network, blade, quantity, instrument)
            found[name]["Observations"] = []
        found[name]["Observations"].append(observation(body, received_at))
    return list(found.values())


def observation(body: Mapping[str, Any], received_at: str) -> Json:
    """One reading.

    >>> told = observation({"id": "i1", "time_h": 8e3, "values": [0.11], "unit": "mm"}, "2031-…Z")
    >>> told["result"], told["parameters"]
    (0.11, {'time_h': 8000.0, 'observed_at': None})
    """
    values, at = body["values"], body.get("observed_at")
    told: Json = {"time_h": body["time_h"]}
    told |= {name: body[name] for name in SAID if body.get(name) is not None}
    told |= {name: None for name in ("observed_at", "unit") if body.get(name) is None}
    return {
        "@iot.id": body["id"],
        "phenomenonTime": received_at if at is None else at,
        "resultTime": None,
        "result": values if isinstance(values[0], list) else values[0],
        "parameters": told,
    }


def _entities(
    rotor: str, network: Network, blade: BladeRecord, quantity: str, instrument: str | None
) -> Json:
    """What a Datastream says of itself, and the entities that it belongs to."""
    declared = network.quantity(quantity)
    facts = {n: getattr(blade, n) for n in ("slot", "lot", "coating_lot", "installed_at")}
    by = "" if instrument is None else f", by {instrument}"
    sensor: Json = {} if instrument is None else {"@iot.id": instrument}
    return {
        "name": f"{quantity} of blade {blade.id}{by}",
        "description": f"readings of {quantity} of blade {blade.id} of rotor {rotor}{by}",
        "observationType": ANY_RESULT if declared.kind == "vector" else MEASUREMENT,
        "unitOfMeasurement": _unit(declared.unit),
        "properties": {"rotor": rotor},
        "Thing": {
            "@iot.id": blade.id,
            "name": blade.id,
            "description": f"blade of rotor {rotor}",
            "properties": {name: value for name, value in facts.items() if value is not None},
        },
        "Sensor": sensor
        | {
            "name": "not named" if instrument is None else instrument,
            "description": "instrument of the readings",
            "encodingType": "text/html",
            "metadata": "",
        },
        "ObservedProperty": {
            "@iot.id": quantity,
            "name": quantity,
            "definition": f"urn:bladetwin:quantity:{quantity}",
            "description": f"{declared.kind} quantity of model {network.name}",
        },
    }


def _unit(symbol: str) -> Json:
    return {"name": symbol, "symbol": symbol, "definition": UCUM}


def predicted(told: Mapping[str, Any], computed_at: str) -> Json:
    """The answer of ``GET …/prediction`` as a document with one Datastream."""
    blade, quantity = told["blade"], told["quantity"]
    given = {name: told[name] for name in ("node", "probability", "instrument")}
    vector = isinstance(told["mean"][0], list)
    return {
        "value": [
            {
                "@iot.id": f"{PREDICTION}/{blade}/{quantity}",
                "name": f"prediction of {quantity} of blade {blade}",
                "description": "mean of the posterior prediction at operating hours; its bounds "
                "and standard deviations by source are in the parameters",
                "observationType": ANY_RESULT if vector else MEASUREMENT,
                "unitOfMeasurement": _unit(told["unit"]),
                "properties": {"kind": PREDICTION}
                | {name: told[name] for name in ("rotor", "held_from_h", "health", "rests_on")},
                "Thing": {"@iot.id": blade, "name": blade},
                "Sensor": {"name": "bladetwin"},
                "ObservedProperty": {"@iot.id": quantity, "name": quantity},
                "Observations": [
                    {
                        "phenomenonTime": computed_at,
                        "resultTime": computed_at,
                        "result": told["mean"][i],
                        "parameters": {"time_h": hour}
                        | {name: value for name, value in given.items() if value is not None}
                        | {"sd": {source: sd[i] for source, sd in told["sd"].items()}}
                        | {name: told[name][i] for name in ("lower", "upper")}
                        | {"quantiles": {p: q[i] for p, q in told["quantiles"].items()}},
                    }
                    for i, hour in enumerate(told["time_h"])
                ],
            }
        ]
    }


def text(entities: Iterable[Iterable[Json]]) -> Iterable[str]:
    """A document of groups of Datastreams, in pieces.

    >>> "".join(text([[{"a": 1}], [], [{"b": 2}]]))
    '{"value": [{"a": 1},\\n{"b": 2}]}\\n'
    """
    between = ""
    yield HEAD
    for group in entities:
        for entity in group:
            yield between + json.dumps(entity, ensure_ascii=False, allow_nan=False)
            between = ",\n"
    yield TAIL
