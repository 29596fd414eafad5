"""Readings: posted, retracted, listed, as files; and how well they were foreseen."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from service.client import answers
from service.client.steps import Call, Steps, ask, fetch, head_seq, path, told

CSV = {"content-type": "text/csv; charset=utf-8"}
JSON = {"content-type": "application/json"}
SENSORTHINGS = "application/vnd.bladetwin.sensorthings+json"


def post_inspections(rotor: str, inspections: Sequence[Mapping[str, Any]]) -> Steps[int]:
    """Post readings, all or nothing; the sequence number to wait for.

    Numbers of numpy and moments of datetime or pandas are taken, as in the rows of a frame. A NaN
    is sent as it is, so that the service refuses it by the name of its field.
    """
    body = {"inspections": [dict(one) for one in inspections]}
    content = json.dumps(body, default=_plain).encode()
    where = path("rotors", rotor, "inspections")
    return head_seq(ask("POST", where, content=content, headers=JSON))


def _plain(value: Any) -> Any:
    for name in ("tolist", "isoformat"):
        if hasattr(value, name):
            return getattr(value, name)()
    raise TypeError(f"{value!r} is no value of a reading: give numbers, texts and moments")


def post_csv(rotor: str, text: str | bytes | PathLike[str]) -> Steps[int]:
    """Post the readings of a CSV, or of the file at a path, all or nothing; the sequence number to
    wait for."""
    if isinstance(text, PathLike):
        text = Path(text).read_bytes()
    content = text.encode() if isinstance(text, str) else text
    where = path("rotors", rotor, "inspections")
    return head_seq(ask("POST", where, content=content, headers=CSV))


def post_sensorthings(rotor: str, body: str | bytes) -> Steps[int]:
    """Post SensorThings Observations, all or nothing; the sequence number to wait for.

    body   JSON: an Observation, data arrays, or what `readings_sensorthings` gave
    """
    content = body.encode() if isinstance(body, str) else body
    where = path("rotors", rotor, "inspections")
    return head_seq(ask("POST", where, content=content, headers={"content-type": SENSORTHINGS}))


def retract(rotor: str, inspection: str) -> Steps[int]:
    """As if the reading had never come; the sequence number to wait for."""
    return head_seq(ask("POST", path("rotors", rotor, "inspections", inspection, "retraction")))


def inspections(rotor: str, *, blade: str | None = None, newest: bool | None = None) -> Call:
    """Readings in the order of their arrival, or the newest first, page by page."""
    return Call("GET", path("rotors", rotor, "inspections"), told(blade=blade, newest=newest))


def inspection(rotor: str, inspection: str) -> Steps[answers.Inspection]:
    """One reading with all its values."""
    return ask("GET", path("rotors", rotor, "inspections", inspection))


def readings_csv(rotor: str, *, blade: str | None = None) -> Steps[bytes]:
    """The readings that count, as CSV in UTF-8: posted to a rotor without any it gives the same."""
    return fetch(path("rotors", rotor, "inspections"), told(format="csv", blade=blade))


def readings_parquet(rotor: str, *, blade: str | None = None) -> Steps[bytes]:
    """Every reading with its status, as a Parquet file."""
    return fetch(path("rotors", rotor, "inspections"), told(format="parquet", blade=blade))


def readings_sensorthings(rotor: str, *, blade: str | None = None) -> Steps[bytes]:
    """The readings that count, as SensorThings Datastreams with their Observations (JSON)."""
    return fetch(path("rotors", rotor, "inspections"), told(format="sensorthings", blade=blade))


def residuals(rotor: str, **filters: str) -> Steps[answers.Residuals]:
    """The first page of residuals, with tests; `filters`: blade, quantity, campaign, cursor."""
    return ask("GET", path("rotors", rotor, "residuals"), params=filters)
