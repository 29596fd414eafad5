"""A receiver of webhooks on the loopback that does as it is told."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

Answer = Callable[["Got"], int]


@dataclass(slots=True)
class Got:
    """A message as it came."""

    path: str
    headers: dict[str, str]
    body: bytes
    handler: BaseHTTPRequestHandler

    @property
    def id(self) -> str:
        return self.headers["webhook-id"]


@dataclass(slots=True)
class Receiver:
    """What came, in order; `answer` says with which status each is answered."""

    url: str
    got: list[Got] = field(default_factory=list)
    answer: Answer = lambda got: 204

    def ids(self) -> list[str]:
        return [one.id for one in self.got]


def then(*statuses: int) -> Answer:
    """These statuses, one after the other; afterwards 204."""
    left = list(statuses)
    return lambda got: left.pop(0) if left else 204


def too_late(got: Got) -> int:
    """204, once the sender has left."""
    got.handler.rfile.read(1)
    return 204


def drop_by_drop(got: Got) -> int:
    """An answer whose every byte comes in time and whose whole does not."""
    for byte in b"HTTP/1.1 204 No Content\r\nX: " + b"x" * 20_000:
        got.handler.wfile.write(bytes([byte]))
        got.handler.wfile.flush()
        time.sleep(0.05)
    return 0


@contextmanager
def receiving(context: Any = None) -> Iterator[Receiver]:
    """A receiver of its own port; with an `ssl.SSLContext` by TLS."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            headers = {name.lower(): value for name, value in self.headers.items()}
            got = Got(self.path, headers, body, self)
            receiver.got.append(got)
            try:
                status = receiver.answer(got)
                if status:
                    self.send_response(status)
                    if 300 <= status < 400:
                        self.send_header("location", f"{receiver.url}/elsewhere")
                    self.send_header("content-length", "0")
                    self.end_headers()
            except OSError:
                pass  # the sender left

        def log_message(self, *words: Any) -> None:
            pass

    class Server(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *words: Any) -> None:
            pass

    server = Server(("127.0.0.1", 0), Handler)
    scheme = "http"
    if context is not None:
        server.socket = context.wrap_socket(server.socket, server_side=True)
        scheme = "https"
    receiver = Receiver(f"{scheme}://localhost:{server.server_address[1]}/hook")
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield receiver
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
