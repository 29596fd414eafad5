"""Idempotency-Key: a state-changing request that is sent again is answered again, not done again.

After draft-ietf-httpapi-idempotency-key-header. The key is taken in the database before the
request is looked at, so of two at once one is told to wait (409). The answer of a request that was
done is kept for BLADETWIN_IDEMPOTENCY_H hours; a request that was refused changed nothing and frees
its key, and so does one whose answer holds a secret (`Cache-Control: no-store`). The same key with
another request is 422. Keys of one client mean nothing for another. What is kept of a key is its
SHA-256: it is the caller's choice, and may be what it should not be.
"""

from __future__ import annotations

import logging
import re
from contextlib import suppress
from hashlib import sha256

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.access import FirstAnswer
from service.api.problems import fault, problem
from service.api.visit import visit_of
from service.errors import StoreAwayError
from service.ports import Store

log = logging.getLogger("bladetwin.api")

KEY = re.compile(r"[\x21-\x7e]{1,255}")
BOUNDARY = re.compile(r'multipart/[^;]+;.*?boundary="?([^";,\s]+)', re.IGNORECASE)
STALE_S = 120.0  # a request that has been answering for so long has died with its process
KEPT = frozenset({"content-type", "location", "retry-after"})


class Repeats:
    """ASGI middleware: first answers, by who asks and Idempotency-Key."""

    def __init__(self, app: ASGIApp, store: Store, keep_s: float) -> None:
        self.app = app
        self.store = store
        self.keep_s = keep_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        visit = visit_of(scope)
        key = Headers(scope=scope).get("idempotency-key") if scope["type"] == "http" else None
        if key is None or visit is None or visit.act is None:
            await self.app(scope, receive, send)
            return
        request = Request(scope, receive)
        if not KEY.fullmatch(key):
            await _unfit(request, key)(scope, receive, send)
            return
        owner, body = visit.act.poster, await request.body()
        kept = sha256(key.encode()).hexdigest()
        mark = await run_in_threadpool(fingerprint, request, body)
        there = await run_in_threadpool(self._begin, owner, kept, mark)
        if there is not None:
            await _again(request, key, mark, there)(scope, receive, send)
            return
        await self._first(scope, _replay(body, receive), send, (owner, kept, mark))

    def _begin(self, owner: str, key: str, mark: str) -> FirstAnswer | None:
        with self.store.write() as tx:
            return tx.answers.begin(owner, key, mark, self.keep_s, STALE_S)

    def _end(self, named: tuple[str, str, str], start: Message | None, body: bytes) -> None:
        with self.store.write() as tx:
            if start is None or not 200 <= start["status"] < 300 or _secret(start):
                tx.answers.forget(*named)
                return
            pairs = [(k.decode("latin-1"), v.decode("latin-1")) for k, v in start["headers"]]
            headers = [(name, value) for name, value in pairs if name.lower() in KEPT]
            tx.answers.finish(*named, start["status"], headers, body)

    async def _first(
        self, scope: Scope, receive: Receive, send: Send, named: tuple[str, str, str]
    ) -> None:
        """Do what is asked; keep the answer before it goes out."""
        messages: list[Message] = []

        async def kept(message: Message) -> None:
            messages.append(message)

        try:
            await self.app(scope, receive, kept)
        except BaseException:
            with suppress(StoreAwayError):
                await run_in_threadpool(self._end, named, None, b"")
            raise
        start = messages[0] if messages else None
        body = b"".join(message.get("body", b"") for message in messages[1:])
        try:
            await run_in_threadpool(self._end, named, start, body)
        except StoreAwayError as error:  # what was done is done, and its answer is the truth
            log.error("the answer to an Idempotency-Key was not kept: %s", error)
        for message in messages:
            await send(message)


def _secret(start: Message) -> bool:
    """Whether the answer says that nobody may keep it: its request is judged anew."""
    return "no-store" in Headers(raw=start["headers"]).get("cache-control", "")


def fingerprint(request: Request, body: bytes) -> str:
    """SHA-256 of what makes two requests the same.

    The boundary of a form, which clients choose anew each time, is none of it.
    """
    url, kind = request.url, request.headers.get("content-type", "")
    if (found := BOUNDARY.match(kind)) is not None:
        body = body.replace(b"--" + found[1].encode("latin-1"), b"--")
        kind = kind.partition(";")[0]
    head = [request.method, url.path, url.query, kind]
    return sha256("\x1f".join(head).encode() + b"\x1e" + body).hexdigest()


def _replay(body: bytes, receive: Receive) -> Receive:
    """A `receive` that gives a body that was read already."""
    given = False

    async def again() -> Message:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again


def _unfit(request: Request, key: str) -> JSONResponse:
    remedy = "give 1 … 255 visible ASCII characters, e.g. a UUID"
    faults = [fault("Idempotency-Key", key, "is no key", remedy)]
    detail = f"Idempotency-Key is no key. To mend it: {remedy}."
    return problem(request, 422, "invalid-input", detail, faults)


def _again(request: Request, key: str, mark: str, there: FirstAnswer) -> Response:
    if there.fingerprint != mark:
        remedy = "choose a new Idempotency-Key for another request"
        faults = [fault("Idempotency-Key", key, "belongs to another request", remedy)]
        detail = f"Idempotency-Key belongs to another request. To mend it: {remedy}."
        return problem(request, 422, "idempotency-key-reused", detail, faults)
    if there.status is None:
        remedy = "wait, and send the same request again"
        faults = [fault("Idempotency-Key", key, "is being answered", remedy)]
        detail = f"the first request with this key is being answered. To mend it: {remedy}."
        return problem(request, 409, "in-progress", detail, faults, {"Retry-After": "1"})
    headers = dict(there.headers) | {"Idempotent-Replayed": "true"}
    return Response(there.body, there.status, headers=headers)
