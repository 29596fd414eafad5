"""Which problem answers which error: status, kind, faults and headers of each.

A handler is a few lines, and `HANDLERS` is the table of them. `service.api.gate` and `LastResort`
answer outside the routes, where FastAPI asks no handler, by the same functions.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from core.errors import CalibrationError, InputError, ModelError
from service.api.problems import (
    MOST_FAULTS,
    Fault,
    RequestError,
    bounded,
    fault,
    fault_of,
    faults_of_validation,
    problem,
)
from service.errors import (
    AdoptionError,
    ConflictError,
    DamagedError,
    DamagedLogError,
    DamagedRotorError,
    FaultsError,
    GoneError,
    NotFoundError,
    NotInstalledError,
    NotYetError,
    PreconditionError,
    StoreAwayError,
    WebhooksOffError,
)

log = logging.getLogger("bladetwin.api")
SENTENCES = 5  # faults that the detail tells; `faults` has them all


async def _refused(request: Request, error: Any) -> JSONResponse:
    return problem(request, error.status, error.kind, error.detail, error.faults)


async def _faulty(request: Request, error: Any) -> JSONResponse:
    faults = [fault_of(one) for one in error.faults[: MOST_FAULTS + 1]]
    return problem(request, 422, "invalid-input", _sentence(faults), bounded(faults))


async def _unusable(request: Request, error: Any) -> JSONResponse:
    return problem(request, 422, "invalid-input", str(error), [fault_of(error)])


async def _malformed(request: Request, error: Any) -> JSONResponse:
    asked = getattr(request.scope.get("route"), "body_field", None)
    kind = None if asked is None else asked.field_info.annotation
    faults = faults_of_validation(error.errors()[: MOST_FAULTS + 1], kind)
    broken = any(one["type"] == "json_invalid" for one in error.errors())
    status, kind = (400, "invalid-json") if broken else (422, "invalid-input")
    return problem(request, status, kind, _sentence(faults), bounded(faults))


async def _missing(request: Request, error: Any) -> JSONResponse:
    return missing(request, error)


def missing(request: Request, error: NotFoundError) -> JSONResponse:
    """The answer for what does not exist."""
    faults = [fault(error.what, error.name, "does not exist", error.remedy)]
    return problem(request, 404, "not-found", str(error), faults)


async def _conflict(request: Request, error: Any) -> JSONResponse:
    names = error.name.split(", ")
    faults = [
        fault(f"{error.what}.id", name, error.problem, error.remedy)
        for name in names[: MOST_FAULTS + 1]
    ]
    detail = str(error)
    if len(names) > SENTENCES:
        shown = f"{', '.join(names[:SENTENCES])} and {len(names) - SENTENCES} more"
        detail = str(ConflictError(error.what, shown, error.remedy, error.problem))
    return problem(request, 409, "conflict", detail, bounded(faults))


async def _not_adoptable(request: Request, error: Any) -> JSONResponse:
    faults = [fault("diagnosis", error.diagnosis, error.problem, error.remedy)]
    return problem(request, 409, "not-adoptable", str(error), faults)


async def _not_yet(request: Request, error: Any) -> JSONResponse:
    faults = [fault("version", None, "is not computed yet", error.remedy)]
    return problem(request, 409, "not-yet", str(error), faults, {"Retry-After": "1"})


async def _gone(request: Request, error: Any) -> JSONResponse:
    faults = [fault(error.field, error.value, "is no longer kept", error.remedy)]
    for version, seq in error.kept:
        near = f"is one of the nearest kept, through entry {seq}"
        faults.append(fault("version", version, near, f"ask for version={version}"))
    return problem(request, 410, "gone", str(error), faults)


async def _hooks_off(request: Request, error: Any) -> JSONResponse:
    faults = [fault(error.setting, "", "is not set", error.remedy)]
    return problem(request, 409, "webhooks-off", str(error), faults)


async def _moved_on(request: Request, error: Any) -> JSONResponse:
    given = request.headers.get("if-match", "")
    faults = [fault("If-Match", given, "is not its present ETag", error.remedy)]
    return problem(request, 412, "precondition-failed", str(error), faults)


async def _damaged(request: Request, error: Any) -> JSONResponse:
    log.error("%s", error)
    where = f"rotor {error.rotor}, version {error.version}"
    faults = [fault(error.part, where, error.problem, error.remedy)]
    return problem(request, 503, "damaged", str(error), faults)


async def _damaged_log(request: Request, error: Any) -> JSONResponse:
    """An entry that is not what was written, or none that this release knows."""
    log.error("%s", error)
    entry = error.entry if isinstance(error, DamagedLogError) else error.event
    remedy = "restore the database, or import the rotor from an exported file"
    faults = [fault("entry", entry, "is not what was written, or is not known", remedy)]
    return problem(request, 503, "damaged", str(error), faults)


async def _damaged_rotor(request: Request, error: Any) -> JSONResponse:
    log.error("%s", error)
    problems = error.problems[:MOST_FAULTS]
    faults = [fault("rotor", error.rotor, one, error.remedy) for one in problems]
    return problem(request, 503, "damaged", str(error), faults)


async def _unfit(request: Request, error: Any) -> JSONResponse:
    log.error("%s", error)
    return problem(request, 503, "model-unfit", str(error))


async def _not_installed(request: Request, error: Any) -> JSONResponse:
    given = request.query_params.get("format", "")
    faults = [fault("format", given, f"needs {error.package}", error.remedy)]
    return problem(request, 501, "not-installed", str(error), faults)


async def _routed(request: Request, error: Any) -> JSONResponse:
    kinds = {400: "invalid-json", 404: "not-found", 405: "method-not-allowed"}
    kind = kinds.get(error.status_code, "refused")
    detail = f"{request.method} {request.url.path}: {error.detail}. See /openapi.json"
    return problem(request, error.status_code, kind, detail, (), error.headers)


async def _away(request: Request, error: Any) -> JSONResponse:
    return away(request, error)


def away(request: Request, error: StoreAwayError) -> JSONResponse:
    """The answer while the database does not answer."""
    log.error("%s: %s", error, error.__cause__)
    return problem(request, 503, "database-away", str(error), (), {"Retry-After": "1"})


HANDLERS = {
    RequestError: _refused,
    FaultsError: _faulty,
    InputError: _unusable,
    RequestValidationError: _malformed,
    NotFoundError: _missing,
    ConflictError: _conflict,
    AdoptionError: _not_adoptable,
    NotYetError: _not_yet,
    GoneError: _gone,
    PreconditionError: _moved_on,
    WebhooksOffError: _hooks_off,
    DamagedError: _damaged,
    DamagedLogError: _damaged_log,
    DamagedRotorError: _damaged_rotor,
    CalibrationError: _damaged_log,
    ModelError: _unfit,
    NotInstalledError: _not_installed,
    HTTPException: _routed,
    StoreAwayError: _away,
}


def install(app: FastAPI) -> None:
    """Every error of every route answers as a problem."""
    for kind, handler in HANDLERS.items():
        app.add_exception_handler(kind, handler)


class LastResort:
    """ASGI middleware: an error that nobody foresaw is logged and answered as a problem."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        started = False

        async def watched(message: Message) -> None:
            nonlocal started
            started = True
            await send(message)

        try:
            await self.app(scope, receive, watched)
        except Exception as error:
            if scope["type"] != "http" or started:
                raise
            request = Request(scope)
            if isinstance(error, ClientDisconnect):
                log.info("%s %s: the client hung up in its body", request.method, request.url.path)
                detail = "the connection ended before the body did; nothing was done."
                await problem(request, 400, "incomplete", detail)(scope, receive, send)
                return
            if isinstance(error, StoreAwayError):
                await away(request, error)(scope, receive, send)
                return
            log.exception("%s %s failed", request.method, request.url.path)
            detail = "the service failed on this request; the log of the server says why."
            await problem(request, 500, "internal-error", detail)(scope, receive, send)


def _sentence(faults: Sequence[Fault]) -> str:
    first = "; ".join(
        f"{one['field']} = {one['value']!r}: {one['problem']}. To mend it: {one['remedy']}"
        for one in faults[:SENTENCES]
    )
    more = len(faults) - SENTENCES
    return first if more <= 0 else f"{first}; and {more} more"
