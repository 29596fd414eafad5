"""ETags: what an answer is known by, and 304 to whoever has it already.

A route that knows what its answer rests on makes the tag before the work (posterior, prediction).
Every other JSON answer to GET gets the digest of its bytes here. A compressed answer is another
representation and has a tag of its own, with ``-gz`` at its end (RFC 9110, 8.8.3.3).
"""

from __future__ import annotations

from hashlib import sha256

from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

COMPRESSED = "-gz"
REVALIDATE = "private, no-cache"
NOT_COMPRESSED = (
    *DEFAULT_EXCLUDED_CONTENT_TYPES,
    *("application/octet-stream", "application/x-npz", "application/x-netcdf"),
    "application/vnd.apache.parquet",
)
LARGE_BYTES = 4096
PASSING = frozenset({"/healthz", "/readyz"})  # true for a moment: nothing to come back for


def tag(*parts: object) -> str:
    """The ETag of an answer that depends on `parts` alone.

    >>> tag("a", 1) == tag("a", 1), tag("a", 1) == tag("a", 2)
    (True, False)
    """
    text = "\x1f".join(map(str, parts))
    return f'"{sha256(text.encode()).hexdigest()[:32]}"'


def named_tags(header: str, *, weak: bool) -> dict[str, str]:
    """The tags of an If-None-Match (`weak`) or If-Match header: plain form -> as it was given.

    >>> named_tags('W/"a", "b-gz"', weak=True), named_tags('W/"a", "b-gz"', weak=False)
    ({'"a"': 'W/"a"', '"b"': '"b-gz"'}, {'"b"': '"b-gz"'})
    """
    found = {}
    for given in (one.strip() for one in header.split(",")):
        if given.startswith("W/") and not weak:
            continue
        plain = given.removeprefix("W/")
        if plain.endswith(COMPRESSED + '"'):
            plain = plain[: -len(COMPRESSED) - 1] + '"'
        found[plain] = given
    return found


def same_tag(header: str, current: str) -> str | None:
    """The tag under which the caller has the present answer; None: it has another one or none."""
    given = named_tags(header, weak=True)
    known = current if "*" in given else given.get(current)
    return None if known is None else known.removeprefix("W/")


class EntityTags:
    """ASGI middleware: an ETag for each JSON answer to GET that has none and is not a stream."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "GET" or scope["path"] in PASSING:
            await self.app(scope, receive, send)
            return
        start: Message | None = None

        async def tagging(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start" and _untagged(message):
                start = message
                return
            if start is not None and message["type"] == "http.response.body":
                first, start = start, None
                if not message.get("more_body", False):
                    message = _answer(scope, first, message)
                await send(first)
            await send(message)

        await self.app(scope, receive, tagging)


def _untagged(start: Message) -> bool:
    headers = Headers(raw=start["headers"])
    kind = headers.get("content-type", "")
    return start["status"] == 200 and kind.startswith("application/json") and "etag" not in headers


def _answer(scope: Scope, start: Message, body: Message) -> Message:
    """Put the tag into the start of the answer, and leave the body out where it is known."""
    headers = MutableHeaders(raw=start["headers"])
    current = f'"{sha256(body["body"]).hexdigest()[:32]}"'
    known = same_tag(Headers(scope=scope).get("if-none-match", ""), current)
    headers["ETag"] = known or current
    headers.setdefault("Cache-Control", REVALIDATE)
    if known is None:
        return body
    start["status"] = 304
    del headers["content-type"], headers["content-length"]
    return {"type": "http.response.body", "body": b"", "more_body": False}


class Compression:
    """ASGI middleware: large answers go compressed to those who accept it, with their own tag."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = GZipMiddleware(
            app,
            minimum_size=LARGE_BYTES,
            compresslevel=5,
            exclude_content_types=NOT_COMPRESSED,
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def renaming(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=message["headers"])
                plain = headers.get("etag", "")
                if headers.get("content-encoding") == "gzip" and plain.endswith('"'):
                    headers["ETag"] = plain[:-1] + COMPRESSED + '"'
            await send(message)

        await self.app(scope, receive, renaming)
