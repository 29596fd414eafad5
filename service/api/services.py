"""What every route gets: store, science, settings; and the helpers that routes share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from fastapi import Depends, Path, Query, Request
from fastapi.responses import JSONResponse, Response

from service.api.problems import RequestError, fault
from service.api.tags import REVALIDATE, same_tag, tag
from service.api.visit import visit_of
from service.api.waiting import Changes
from service.handlers.reads import Basis
from service.moments import moment as moment  # (routes take it from here)
from service.names import ID_PATTERN
from service.ports import Appended, Science, Store
from service.release import release
from service.settings import Settings

RELEASE = release()


@dataclass(frozen=True, slots=True)
class Services:
    """The wired parts of one API process."""

    store: Store
    science: Science
    settings: Settings
    changes: Changes


async def services_of(request: Request) -> Services:
    """The wired parts; for a state-changing request with a store that writes its audit row."""
    found: Services = request.app.state.services
    visit = visit_of(request.scope)
    if visit is None or visit.act is None:
        return found
    return replace(found, store=found.store.acting_for(visit.act, visit.guard))


async def rotors_of(request: Request) -> tuple[str, ...] | None:
    """The only rotors that the caller's key knows; None: all."""
    visit = visit_of(request.scope)
    return None if visit is None or visit.key is None else visit.key.rotors


Wired = Annotated[Services, Depends(services_of)]
Seen = Annotated[tuple[str, ...] | None, Depends(rotors_of)]
Name = Annotated[str, Path(max_length=100, pattern=ID_PATTERN)]
Limit = Annotated[int | None, Query(ge=1, le=2**31)]
Number = Annotated[int | None, Query(ge=0, lt=2**62)]
Cursor = Annotated[str | None, Query(max_length=100, pattern=ID_PATTERN)]


def page_size(services: Services, limit: int | None) -> int:
    """The number of items of a page; above the maximum is refused, not cut."""
    most = services.settings.page_limit
    if limit is not None and limit > most:
        remedy = f"ask for 1 … {most}, and follow `next`"
        detail = f"limit = {limit} is above {most}. To mend it: {remedy}"
        faults = [fault("limit", limit, f"is above {most}", remedy)]
        raise RequestError(422, "invalid-input", detail, faults)
    return min(50, most) if limit is None else limit


def seq_of(cursor: str | None) -> int | None:
    """The number that the cursor of a page by numbers is; None: from the start."""
    if cursor is None:
        return None
    if cursor.isascii() and cursor.isdigit() and len(cursor) < 19:
        return int(cursor)
    remedy = "use `next` of the page before"
    detail = f"cursor = {cursor!r} is no cursor. To mend it: {remedy}"
    faults = [fault("cursor", cursor, "is no cursor", remedy)]
    raise RequestError(422, "invalid-input", detail, faults)


def page(items: Sequence[Any], size: int, key: str) -> dict[str, Any]:
    """A page of items and the cursor of the next one; `items` holds one more than the page."""
    shown = list(items[:size])
    return {"items": shown, "next": str(shown[-1][key]) if len(items) > size else None}


def accepted(answers: Sequence[Appended]) -> JSONResponse:
    """The answer to entries of the log; the same entries again get the same answer."""
    items = [
        {"id": a.event_id.rpartition("/")[2], "seq": a.seq, "status": "accepted"} for a in answers
    ]
    body = {"items": items, "head_seq": max(a.seq for a in answers)}
    replayed = all(not a.new for a in answers)
    return JSONResponse(body, 202, headers={"Idempotent-Replayed": "true"} if replayed else {})


def tag_of(request: Request, *parts: object) -> str:
    """The ETag of an answer that depends on `parts`, the question and this release alone."""
    return tag(RELEASE, request.url.path, request.url.query, *parts)


def tag_of_basis(request: Request, found: Basis) -> str:
    return tag_of(request, found.state.version, found.state.digest, found.card.digest)


def unchanged(request: Request, tag: str) -> Response | None:
    """304 where the caller has this answer already."""
    known = same_tag(request.headers.get("if-none-match", ""), tag)
    if known is None:
        return None
    return Response(status_code=304, headers={"ETag": known, "Cache-Control": REVALIDATE})


def tagged(body: Mapping[str, Any], tag: str, written: str | None = None) -> Response:
    """An answer with its ETag and, in a header as well, the health of the state it rests on.

    written   the answer as JSON, where it was written already
    """
    headers = {"ETag": tag, "Cache-Control": REVALIDATE}
    if body["health"] is not None:
        headers["Bladetwin-Health"] = body["health"]["status"]
    if written is not None:
        return Response(written, media_type="application/json", headers=headers)
    return JSONResponse(body, headers=headers)
