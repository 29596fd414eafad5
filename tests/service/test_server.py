"""Connections: what the service listens with, and heads that never end."""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import httpx
import pytest

from service.api.server import HEAD_BYTES, Protocol
from service.api.server import server as server_of
from service.bootstrap import make_app
from service.fake import FakeScience
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from tests.patience import PATIENCE_S
from tests.service.conftest import RunningServer

GET = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
POST = b"POST /v1/rotors/r1/inspections HTTP/1.1\r\nHost: localhost\r\n"
CHUNKS = POST + b"Content-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n"
ENDLESS = {
    "a header's value": GET + b"X-Long: ",
    "an address": b"GET /v1/rotors?cursor=",
    "a chunk's trailer": CHUNKS + b"2\r\n{}\r\n0\r\nX-Long: ",
    "a chunk's extension": CHUNKS + b"2;x=",
}


@contextmanager
def connected(running: RunningServer) -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", running.port), timeout=PATIENCE_S) as one:
        yield one


def answered(one: socket.socket) -> bytes:
    """All that comes until the connection ends."""
    found = b""
    try:
        while more := one.recv(65536):
            found += more
    except ConnectionResetError:
        pass
    return found


def told(answer: bytes, status: int, kind: str) -> None:
    """The answer is a problem, in the shape of all others."""
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.startswith(f"HTTP/1.1 {status} ".encode())
    assert b"content-type: application/problem+json" in head
    found = json.loads(body)
    assert found.keys() == {"type", "title", "status", "detail", "instance", "faults"}
    assert (found["type"], found["status"]) == (f"urn:bladetwin:problem:{kind}", status)


@pytest.mark.parametrize("beginning", ENDLESS.values(), ids=list(ENDLESS))
def test_a_head_that_never_ends_is_cut_off(
    api: httpx.Client, server: RunningServer, rotor: str, beginning: bytes
) -> None:
    with connected(server) as one:
        one.sendall(beginning)
        sent = 0
        try:
            while sent < 8 * 2**20:
                sent += one.send(b"x" * 4096)
        except (BrokenPipeError, ConnectionResetError):
            pass
        assert sent < 8 * 2**20, "the server listens for ever"
    assert api.get("/healthz").status_code == 200


def test_a_head_above_the_bound_is_told_so(api: httpx.Client, server: RunningServer) -> None:
    with connected(server) as one:
        one.sendall(GET + b"X-Long: " + b"x" * HEAD_BYTES)
        told(answered(one), 431, "head-too-large")


def test_bodies_and_many_requests_do_not_count_as_heads(
    api: httpx.Client, server: RunningServer, rotor: str
) -> None:
    long = {"X-Long": "x" * (HEAD_BYTES // 2)}
    for _ in range(8):
        assert api.get("/healthz", headers=long).status_code == 200, "on one connection"
    with connected(server) as one:
        one.sendall(CHUNKS)
        for _ in range(HEAD_BYTES // 4):  # framing alone is above the bound
            one.sendall(b"1\r\n \r\n")
        one.sendall(b"2\r\n{}\r\n0\r\n\r\n")
        assert one.recv(4096).startswith(b"HTTP/1.1 422 ")


@pytest.mark.parametrize(
    "wrong",
    [
        b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nContent-Length: x\r\n\r\n",
        POST + b"Content-Length: 3\r\nTransfer-Encoding: chunked\r\n\r\n",
        b"GET /healthz\x00 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET /healthz HTTP/1.1\r\n Host : localhost\r\n\r\n",
        b"\x16\x03\x01 no HTTP at all\r\n\r\n",
        b"BREW /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
    ],
)
def test_what_is_no_request_is_answered_with_400(
    api: httpx.Client, server: RunningServer, wrong: bytes
) -> None:
    """Two lengths among them: what a proxy and we read differently smuggles a request."""
    with connected(server) as one:
        one.sendall(wrong)
        told(answered(one), 400, "malformed-request")


def test_the_service_takes_the_fast_loop_and_the_bounded_parser(
    store: SqlStore, science: FakeScience, settings: Settings
) -> None:
    config = server_of(make_app(store, science, settings), settings).config
    config.load()
    assert config.http_protocol_class is Protocol
    made = config.get_loop_factory()
    assert made is not None
    assert made.__module__.partition(".")[0] == ("asyncio" if sys.platform == "win32" else "uvloop")
