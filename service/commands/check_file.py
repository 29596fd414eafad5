"""``bladetwin inspect ROTOR --file FILE``: what would become of a file of readings that is posted.

The file is read as the service reads it, and its readings are held against the rotor's model, its
blades and the readings that are there already. Nothing is posted. What the service would take, and
leaves two readings where one is meant, is noted (`service.commands.doubled`).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from core.errors import InputError
from core.network import Network
from core.observation import Inspection
from service.api.problems import RequestError, fault, fault_of
from service.api.reading_bodies import InspectionIn, read_inspections
from service.client import Client
from service.commands.doubled import corrections, repetitions, there_is
from service.export.sensorthings import MEDIA
from service.handlers.inspections import Item, faults_of
from service.progress import bar

Told = dict[str, Any]
SHOWN = 20


@dataclass(frozen=True, slots=True)
class Reach:
    """What of a model bounds a reading."""

    horizon_h: float
    node_count: int
    nodes: Mapping[str, int]


def checked(twin: Client, rotor: str, file: Path, *, quiet: bool) -> Told:
    """``{"rotor", "file", "readings", "new", "same", "faults", "notes"}``; InputError: it cannot be
    read."""
    try:
        body = file.read_bytes()
    except OSError as error:
        raise InputError(
            "--file", str(file), f"cannot be read: {error.strerror}", "name another"
        ) from None
    now = twin.rotor(rotor)
    model = twin.model(now["model"], now["model_version"])
    told: Told = {"rotor": rotor, "file": str(file), "readings": 0, "new": 0, "same": 0}
    told["notes"] = []
    reach = Reach(model["horizon_h"], model["node_count"], model["nodes"])
    network, blades = Network.from_json(model["network"]), {one["id"] for one in now["blades"]}

    def also(items: Sequence[Item]) -> list[InputError]:
        return faults_of(items, network, reach, blades, rotor)

    try:
        items = read_inspections(body, media_type(file, body), also)
    except RequestError as error:
        unread = [fault("file", file.name, error.detail, "correct it, or save it as CSV in UTF-8")]
        return told | {"faults": error.faults or unread}
    faults = [fault_of(one) for one in also(items)]
    seen: dict[str, tuple[str, str]] = {}  # of each id its digest, and the place where it stands
    fresh: list[Item] = []
    with bar("looking at the rotor", len(items), quiet=quiet) as shown:
        for done, item in enumerate(items, start=1):
            own, name = item.reading.digest(), item.reading.id
            there, place = seen.get(name) or (_digest(there_is(twin, rotor, name)), "")
            seen.setdefault(name, (own, item.where))
            told["same" if there == own else "new"] += there in (None, own)
            if there is None:
                fresh.append(item)
            elif there != own and place:
                problem = f"is the id of {place.rstrip('.')}, too, with another content"
                remedy = "give each reading an id of its own"
                faults.append(fault(f"{item.where}id", name, problem, remedy))
            elif there != own:
                problem = "is an id that exists with another content"
                remedy = "choose a new id, and name this one in `replaces` to correct it"
                faults.append(fault(f"{item.where}id", name, problem, remedy))
            shown(done)
    notes = [
        *corrections(twin, rotor, fresh, seen.keys()),
        *repetitions(twin, rotor, fresh, blades),
    ]
    return told | {"readings": len(items), "faults": faults, "notes": notes}


def _digest(found: Mapping[str, Any] | None) -> str | None:
    if found is None:
        return None
    known = InspectionIn.model_fields.keys() - {"value"}
    return Inspection.from_json({k: v for k, v in found.items() if k in known}).digest()


def media_type(file: Path, body: bytes) -> str:
    """By its ending, and JSON by what it holds.

    >>> media_type(Path("x.json"), b'[{"components": []}]') == MEDIA
    True
    >>> media_type(Path("x.json"), b'{"inspections": []}'), media_type(Path("x.txt"), b"id,blade")
    ('application/json', 'text/csv')
    """
    if file.suffix.lower() != ".json":
        return "text/csv"
    try:
        data = json.loads(body)
    except ValueError:
        return "application/json"
    entity = isinstance(data, list) or (
        isinstance(data, dict)
        and ("result" in data or "Datastream" in data or isinstance(data.get("value"), list))
    )
    return MEDIA if entity else "application/json"


def _line(one: Mapping[str, Any]) -> int:
    """The line of the file that a fault is in; 0: it is of the whole file."""
    found = re.match(r"line (\d+)", str(one["field"]))
    return int(found[1]) if found else 0


def lines_of(told: Told) -> Iterator[str]:
    """The check for people."""
    faults = sorted(told["faults"], key=_line)
    count = f"{len(faults)} fault{'s' * (len(faults) != 1)}"
    if faults and not told["readings"]:
        yield f"{told['file']}: {count}, and its readings cannot be counted before they are mended"
    else:
        yield (
            f"{told['file']}: {told['readings']} reading{'s' * (told['readings'] != 1)}, "
            f"{told['new']} of them new to rotor {told['rotor']}, {told['same']} there already"
            + (f"; {count}" if faults else "")
        )
    for one in faults[:SHOWN]:
        yield f"  {one['field']} = {one['value']!r} {one['problem']}. To mend it: {one['remedy']}."
    if len(faults) > SHOWN:
        yield f"  and {len(faults) - SHOWN} more"
    for one in told["notes"][:SHOWN]:
        yield f"  note: {one['field']} = {one['value']!r} {one['problem']}; {one['remedy']}"
    if len(told["notes"]) > SHOWN:
        yield f"  and {len(told['notes']) - SHOWN} more notes"
    yield "nothing of it can be posted: a file is all or nothing" if faults else "it can be posted"
