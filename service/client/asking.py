"""Addresses and queries that several requests of the client have in common."""

from __future__ import annotations

from collections.abc import Sequence

from service.client.steps import path, told


def below(rotor: str, blade: str | None, what: str) -> str:
    """The address of something of a rotor, or of one of its blades."""
    parts = ("rotors", rotor) + (() if blade is None else ("blades", blade))
    return path(*parts, what)


def listed(times: Sequence[float] | None) -> str | None:
    """Hours as one query parameter, exactly."""
    return None if times is None else ",".join(repr(float(t)) for t in times)


def of_prediction(
    quantity: str | None,
    times: Sequence[float] | None,
    node: int | str | None,
    probability: float,
    instrument: str | None,
    version: int | None,
    at: str | None,
) -> dict[str, str]:
    """The query of a prediction."""
    return told(
        quantity=quantity,
        times=listed(times),
        node=node,
        probability=probability,
        instrument=instrument,
        version=version,
        at=at,
    )
