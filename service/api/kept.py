"""Answers that are kept as bytes, as long as what they rest on stands in the database.

A prediction, a posterior or a life of the newest version is a function of the question and of that
version (`service.handlers.reads.Basis`); a rotor as it stands is one of its row and that version. A
route says so of its answer (`rests_on`, `shows`), and this layer keeps the bytes under the
question. The same question is answered with them after one look at the version or the row, in the
database, so that a new one is seen from the moment on at which it is committed, by whatever
process. What differs between callers (key, rate, request id) lies outside of this layer; what the
answer is encoded in is part of the question.

Where the version or the row is another one, the route's work is to be done again, but not the
understanding of the question, which is half of what a small answer costs: finding the route,
parsing and checking its parameters. So a route leaves with its answer what makes it (`Make`), and
who finds that the kept one does not hold any more calls that; the innermost layer (`Again`) sends
what it gave. Where it fails, the route is asked, and tells why.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.tags import COMPRESSED, REVALIDATE, same_tag
from service.handlers.reads import Basis, newest, standing
from service.handlers.rotors import RotorView
from service.ports import Store, Which

PLACE, AGAIN = "bladetwin.rests_on", "bladetwin.again"
Make = Callable[[Request], Response]
Question = tuple[str, bytes, bool]


@dataclass(frozen=True, slots=True)
class Ground:
    """What an answer follows from, beside its question: `look` at the rotor found `there`.

    again   makes the answer of a later state; None: its route does
    """

    rotor: str
    look: Callable[[Store, str], object]
    there: object
    again: Make | None = field(default=None, compare=False)

    def holds(self, store: Store) -> bool:
        return self.look(store, self.rotor) == self.there


@dataclass(frozen=True, slots=True)
class Kept:
    """An answer and what it rests on.

    tag    its plain ETag
    body   None: only that who has the tag has the answer is known
    scope  what the layers outside want to know of the route
    """

    ground: Ground
    tag: str
    headers: list[tuple[bytes, bytes]]
    body: bytes | None
    scope: dict[str, Any]


class Shelf:
    """Answers by question, least recently used ones dropped above `limit_mb`; for many threads."""

    ENTRY_BYTES = 3072
    LONGEST = 4096  # of a question's path and query; longer ones are not asked twice

    def __init__(self, limit_mb: float) -> None:
        self._limit, self._size = int(limit_mb * 2**20), 0
        self._kept: OrderedDict[Question, Kept] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, question: Question) -> Kept | None:
        with self._lock:
            if question in self._kept:
                self._kept.move_to_end(question)
            return self._kept.get(question)

    def put(self, question: Question, kept: Kept) -> None:
        if len(question[0]) + len(question[1]) > self.LONGEST:
            return
        with self._lock:
            if (old := self._kept.pop(question, None)) is not None:
                self._size -= self._bytes(question, old)
            self._kept[question] = kept
            self._size += self._bytes(question, kept)
            while self._size > self._limit:
                self._size -= self._bytes(*self._kept.popitem(last=False))

    def _bytes(self, question: Question, kept: Kept) -> int:
        heads = sum(len(name) + len(value) for name, value in kept.headers)
        asked = 2 * len(question[0]) + len(question[1])  # its path parameters repeat the path
        return self.ENTRY_BYTES + asked + heads + len(kept.body or b"")


def rests_on(request: Request, found: Basis, which: Which, again: Make | None = None) -> None:
    """Say of the answer under way that it follows from the question and this version alone."""
    if which.newest:
        state = found.state
        there = (state.version, state.digest)
        request.scope[PLACE] = Ground(state.rotor_id, newest, there, again)


def shows(request: Request, view: RotorView, again: Make | None = None) -> None:
    """Say of the answer under way that it follows from the rotor as it stands alone."""
    rotor, state = view.rotor, view.state
    request.scope[PLACE] = Ground(rotor.id, standing, (rotor, state and state.digest), again)


class Answers:
    """ASGI middleware: keeps answers that say what they rest on, and gives them again."""

    def __init__(self, app: ASGIApp, store: Store, limit_mb: float) -> None:
        self.app = app
        self.store = store
        self.shelf = Shelf(limit_mb)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "GET":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        squeezed = "gzip" in headers.get("accept-encoding", "")
        question = (scope["path"], scope.get("query_string", b""), squeezed)
        known = headers.get("if-none-match", "")
        kept = self.shelf.get(question)
        if kept is not None:
            has = same_tag(known, kept.tag)
            told = has is not None or kept.body is not None
            own = {**scope, **kept.scope}
            found = await run_in_threadpool(self._found, kept, Request(own), told)
            if found is True:
                await _again(scope, send, kept, has)
                return
            if found is not None:
                scope[AGAIN] = found, own
        await self._ask(question, scope, receive, send)

    def _found(self, kept: Kept, request: Request, told: bool) -> Response | Literal[True] | None:
        """True: the kept answer still holds; else a new one. None: the route is to be asked, which
        meets whatever failed here, and tells it.

        told   the kept answer is enough for who asks
        """
        ground = kept.ground
        try:
            if told and ground.holds(self.store):
                return True
            return None if ground.again is None else ground.again(request)
        except Exception:
            return None

    async def _ask(self, question: Question, scope: Scope, receive: Receive, send: Send) -> None:
        start: Message | None = None

        async def keeping(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start":
                fits = PLACE in scope and message["status"] in (200, 304)
                # a copy: the layers outside write their own headers into the message
                start = {**message, "headers": list(message["headers"])} if fits else None
            elif start is not None:
                whole = not message.get("more_body", False)
                if whole:
                    self._keep(question, scope, start, message.get("body", b""))
                start = None
            await send(message)

        await self.app(scope, receive, keeping)

    def _keep(self, question: Question, scope: Scope, start: Message, body: bytes) -> None:
        headers = Headers(raw=start["headers"])
        tag = headers.get("etag", "").replace(COMPRESSED + '"', '"')
        ground: Ground = scope[PLACE]
        told = {name: scope[name] for name in ("route", "path_params") if name in scope}
        if start["status"] == 200:
            kept = Kept(ground, tag, list(start["headers"]), body, told)
            self.shelf.put(question, kept)
        elif (old := self.shelf.get(question)) is None or old.ground != ground:
            self.shelf.put(question, Kept(ground, tag, [], None, told))


class Again:
    """ASGI middleware, the innermost: sends what was answered anew, in place of the route."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if AGAIN in scope:
            answer, own = scope.pop(AGAIN)
            scope.update(own)
            await answer(scope, receive, send)
        else:
            await self.app(scope, receive, send)


async def _again(scope: Scope, send: Send, kept: Kept, has: str | None) -> None:
    """The kept answer; `has`: the tag under which the caller has it."""
    scope.update(kept.scope)
    if has is None:
        start = {"type": "http.response.start", "status": 200, "headers": list(kept.headers)}
        await send(start)
        await send({"type": "http.response.body", "body": kept.body, "more_body": False})
        return
    headers = MutableHeaders(headers={"ETag": has, "Cache-Control": REVALIDATE})
    await send({"type": "http.response.start", "status": 304, "headers": headers.raw})
    await send({"type": "http.response.body", "body": b"", "more_body": False})
