"""Server-sent events: a hint for each new version of a rotor, and for its blocking.

An event says "rotor X at version N"; the client then reads what it wants to know. Each has an id,
from which a lost connection goes on: `?after=` at first, and `Last-Event-ID` from then on, for a
browser that connects again sends the same address and the id that it came to. Where what came in
between is no longer kept, the first event is ``reset``.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import StreamingResponse
from starlette.concurrency import run_in_threadpool

from service.api.feed import Feed
from service.api.heads import is_head
from service.api.problems import RequestError, fault
from service.api.services import Name, Services, Wired
from service.handlers import events as use
from service.moments import moment
from service.ports import Note
from service.sse import HEARTBEAT, frame

router = APIRouter(prefix="/v1/rotors/{r}", tags=["events"])
RETRY_MS = 2000
After = Annotated[int | None, Query(ge=0, lt=2**62, description="id of the last event known")]
STREAM: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}}
}


@router.get("/events", summary="Hints of new versions, as server-sent events", responses=STREAM)
async def get_events(
    r: Name, request: Request, services: Wired, after: After = None
) -> StreamingResponse:
    seen = last_event_id(request)
    known = after if seen is None else seen
    first = await run_in_threadpool(use.news, services.store, r, known)
    feed: Feed = request.app.state.feed
    return StreamingResponse(
        iter(()) if is_head(request.scope) else stream(services, feed, r, first),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


def last_event_id(request: Request) -> int | None:
    """The id of the last event that a client saw before its connection was lost."""
    text = request.headers.get("last-event-id", "")
    if not text:
        return None
    if text.isascii() and text.isdigit() and len(text) < 19:
        return int(text)
    remedy = "send the `id` of the last event, or leave it out"
    raise RequestError(
        422,
        "invalid-input",
        f"Last-Event-ID = {text[:50]!r} is no id of an event. To mend it: {remedy}",
        [fault("Last-Event-ID", text, "is no id of an event", remedy)],
    )


async def stream(services: Services, feed: Feed, r: str, first: use.News) -> AsyncIterator[str]:
    """Frames until the client leaves or the server stops."""
    beat_s = services.settings.heartbeat_s
    async with feed.listening(r) as awake:
        awake.set()  # what was committed since `first` was read woke others only
        yield f"retry: {RETRY_MS}\n\n"
        news = first
        while not feed.closing:
            for text in told(news):
                yield text
            if len(news.notes) < use.PAGE:
                while not await _woken(awake, beat_s):
                    yield HEARTBEAT
            if feed.closing:
                return
            awake.clear()
            news = await run_in_threadpool(use.news, services.store, r, news.number)


async def _woken(awake: asyncio.Event, timeout_s: float) -> bool:
    try:
        await asyncio.wait_for(awake.wait(), timeout_s)
    except TimeoutError:
        return False
    return True


def told(news: use.News) -> list[str]:
    """The frames of some news."""
    if news.reset:
        at = {"version": news.rotor.version, "through_seq": news.rotor.applied_seq}
        return [frame("reset", {"rotor": news.rotor.id, **at}, news.number)]
    return [_frame(note) for note in news.notes]


def _frame(note: Note) -> str:
    data = {"rotor": note.rotor_id, **note.payload, "at": moment(note.at)}
    return frame(note.kind, data, note.id)
