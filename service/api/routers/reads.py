"""Posterior, prediction and lives, with an ETag of everything that they rest on."""

from __future__ import annotations

import json
import re
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from pydantic import FiniteFloat

from service.api.files import CSV, SENSORTHINGS, file
from service.api.kept import rests_on
from service.api.problems import fault, invalid
from service.api.routers.draws import get_draws, get_rotor_draws
from service.api.services import Name, Wired, moment, tag_of_basis, tagged, unchanged
from service.api.which import Asked
from service.export import sensorthings
from service.export.tables import prediction_csv
from service.handlers import reads as use
from service.handlers.life import along_question, life, rotor_life
from service.handlers.questions import question
from service.names import is_number
from service.ports import Which

router = APIRouter(prefix="/v1/rotors/{r}", tags=["reads"])
DRAWS = 1000  # in a file; `…/draws?format=netcdf` gives as many as are asked for
LONGEST_TIMES = 16_384  # characters of `times`
Form = Annotated[
    Literal["json", "netcdf"], Query(description=f"netcdf: {DRAWS} draws in ArviZ's schema")
]
Passed = Annotated[FiniteFloat, Query(description="in the quantity's unit")]
Quantity = Annotated[
    str | None, Query(max_length=100, description="default: the model's first one")
]
Hours = Annotated[
    str | None,
    Query(max_length=LONGEST_TIMES, description="hours, with commas between; default: the model's"),
]
Ahead = Annotated[
    str | None,
    Query(max_length=LONGEST_TIMES, description="hours from now on, with commas between"),
]
Axis = Annotated[
    Literal["x", "y", "z"] | None, Query(description="of a vector; default: z, the radius")
]


@router.get("/posterior", summary="The shared parameters of the rotor")
def get_posterior(
    r: Name, request: Request, services: Wired, which: Asked, format: Form = "json"
) -> Response:
    if format == "netcdf":
        return get_rotor_draws(r, request, services, which, DRAWS, format)
    return _posterior(request, services, r, None, which)


@router.get("/blades/{b}/posterior", summary="The parameters of one blade")
def get_blade_posterior(
    r: Name, b: Name, request: Request, services: Wired, which: Asked, format: Form = "json"
) -> Response:
    if format == "netcdf":
        return get_draws(r, b, request, services, which, DRAWS, format)
    return _posterior(request, services, r, b, which)


def _posterior(request: Request, services: Wired, r: str, b: str | None, which: Which) -> Response:
    def answer(request: Request) -> Response:
        found = use.basis(services.store, services.science, r, which, b)
        rests_on(request, found, which, answer)
        tag = tag_of_basis(request, found)
        if (same := unchanged(request, tag)) is not None:
            return same
        body = {"rotor": r} | ({} if b is None else {"blade": b})
        body |= use.posterior(services.store, services.science, found)
        return tagged(body | {"rests_on": found.to_json()}, tag)

    return answer(request)


@router.get("/blades/{b}/prediction", summary="Bands of a quantity over time, by source")
def get_prediction(
    r: Name,
    b: Name,
    request: Request,
    services: Wired,
    which: Asked,
    quantity: Quantity = None,
    times: Annotated[
        str | None, Query(max_length=LONGEST_TIMES, description="hours, with commas between")
    ] = None,
    node: Annotated[str | None, Query(max_length=100)] = None,
    probability: float = 0.95,
    instrument: Annotated[
        str | None,
        Query(
            min_length=1,
            max_length=200,
            description="whose noise a reading has, where noises are by it",
        ),
    ] = None,
    format: Annotated[
        Literal["json", "csv", "sensorthings"],
        Query(description="csv: a row for each hour; sensorthings: an Observation for each"),
    ] = "json",
) -> Response:
    def answer(request: Request) -> Response:
        found = use.basis(services.store, services.science, r, which, b)
        asked = question(found.card, quantity, read_times(times), node, probability, instrument)
        rests_on(request, found, which, answer)
        tag = tag_of_basis(request, found)
        if (same := unchanged(request, tag)) is not None:
            return same
        told = use.predict(services.store, services.science, found, asked)
        body = {"rotor": r} | told | {"rests_on": found.to_json()}
        saved = (r, b, asked.quantity, f"v{found.state.version}")
        if format == "csv":
            return file(prediction_csv(body), CSV, saved, "csv", tag, found)
        if format == "sensorthings":
            made = sensorthings.predicted(body, moment(found.state.created_at))
            written = json.dumps(made, ensure_ascii=False).encode()
            return file(written, SENSORTHINGS, saved, "json", tag, found)
        return tagged(body, tag)

    return answer(request)


@router.get("/blades/{b}/life", summary="When a quantity passes a limit: a distribution of hours")
def get_life(
    r: Name,
    b: Name,
    request: Request,
    services: Wired,
    which: Asked,
    limit: Passed,
    quantity: Quantity = None,
    times: Hours = None,
    node: Annotated[str | None, Query(max_length=100)] = None,
    component: Axis = None,
) -> Response:
    def answer(request: Request) -> Response:
        found = use.basis(services.store, services.science, r, which, b)
        asked, part = along_question(found.card, quantity, read_times(times), node, component)
        rests_on(request, found, which, answer)
        tag = tag_of_basis(request, found)
        if (same := unchanged(request, tag)) is not None:
            return same
        told = life(services.store, services.science, found, asked, part, limit)
        return tagged({"rotor": r} | told | {"rests_on": found.to_json()}, tag)

    return answer(request)


@router.get("/life", summary="Which blades pass a limit, how surely, and how likely any does")
def get_rotor_life(
    r: Name,
    request: Request,
    services: Wired,
    which: Asked,
    limit: Passed,
    quantity: Quantity = None,
    times: Hours = None,
    ahead: Ahead = None,
    node: Annotated[str | None, Query(max_length=100)] = None,
    component: Axis = None,
) -> Response:
    if times is not None and ahead is not None:
        one = fault("ahead", ahead, "is given beside times", "give one of the two")
        raise invalid([one])
    hours = read_times(times) if ahead is None else read_times(ahead, "ahead")

    def answer(request: Request) -> Response:
        found = use.basis(services.store, services.science, r, which)
        asked, part = along_question(found.card, quantity, hours, node, component)
        rests_on(request, found, which, answer)
        tag = tag_of_basis(request, found)
        if (same := unchanged(request, tag)) is not None:
            return same
        by = ahead is not None
        told = rotor_life(services.store, services.science, found, asked, part, limit, by)
        return tagged({"rotor": r} | told | {"rests_on": found.to_json()}, tag)

    return answer(request)


def read_times(text: str | None, name: str = "times") -> list[float] | None:
    """Hours with commas between.

    >>> read_times("0, 8000,2.5e4")
    [0.0, 8000.0, 25000.0]

    RequestError for what is no number, and for 24,000, which would be hours 24 and 0.
    """
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    for part in parts:
        if not is_number(part) or re.match(r"0\d", part):
            what = "is what a comma for thousands leaves" if is_number(part) else "is not a number"
            remedy = f"give hours with commas between, e.g. {name}=8000,24000"
            raise invalid([fault(name, part, what, remedy)])
    return [float(part) for part in parts]
