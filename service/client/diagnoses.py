"""Diagnoses, their reports, and what is adopted of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from service.client import answers
from service.client.steps import Call, Json, Steps, ask, checked, one, part, path, told


def diagnose(
    rotor: str,
    *,
    families: Sequence[Mapping[str, Any]] = (),
    compare: bool = True,
    horizon_h: float | None = None,
) -> Steps[answers.Diagnosis]:
    """Begin to look for effects that the model lacks; the diagnosis as it stands.

    families    beside the built-in ones (`core.diagnosis.Family.to_json`)
    compare     whether both models are held against readings that neither used
    horizon_h   hour of the forecasts that are compared [h]; None: 50,000
    """
    body: Json = {"compare": compare}
    body |= {"families": [dict(family) for family in families]} if families else {}
    body |= {} if horizon_h is None else {"horizon_h": horizon_h}
    return part(ask("POST", path("rotors", rotor, "diagnoses"), json=body), "diagnosis")


def diagnoses(rotor: str) -> Call:
    """Every diagnosis of a rotor, the newest first, page by page."""
    return Call("GET", path("rotors", rotor, "diagnoses"))


def diagnosis(rotor: str, diagnosis: str) -> Steps[answers.Diagnosis]:
    """How far a diagnosis is, and what it found."""
    return ask("GET", path("rotors", rotor, "diagnoses", diagnosis))


def cancel_diagnosis(rotor: str, diagnosis: str) -> Steps[answers.Diagnosis]:
    """End a diagnosis that is queued or running; one that has ended stays as it is."""
    return ask("DELETE", path("rotors", rotor, "diagnoses", diagnosis))


def report(rotor: str, diagnosis: str, *, limit: float | None = None) -> Steps[str]:
    """A finished diagnosis as one HTML file to hand on.

    limit  of the quantity that is forecast [its unit]: shows by how much remaining life moves
    """
    where = path("rotors", rotor, "diagnoses", diagnosis, "report")
    return one(lambda response: checked(response).text, Call("GET", where, told(limit=limit)))


def adopt(
    rotor: str, diagnosis: str, *, alternative: int | None = None, because: str | None = None
) -> Steps[answers.Adopted]:
    """The effects of a diagnosis enter the rotor's model; `head_seq` is what to wait for.

    alternative   the number of one of the diagnosis' alternatives, in place of what it claims
    because       from where it is known that it is this one; the log keeps it
    """
    body = {"alternative": alternative, "because": because}
    chosen = {name: value for name, value in body.items() if value is not None}
    where = path("rotors", rotor, "diagnoses", diagnosis, "adoption")
    return ask("POST", where, json=chosen) if chosen else ask("POST", where)


def back_out(rotor: str, diagnosis: str) -> Steps[answers.BackedOut]:
    """The network before the adoption comes back; `head_seq` is what to wait for."""
    return ask("DELETE", path("rotors", rotor, "diagnoses", diagnosis, "adoption"))


def adoptions(rotor: str) -> Call:
    """What was adopted and backed out, in order, page by page."""
    return Call("GET", path("rotors", rotor, "adoptions"))
