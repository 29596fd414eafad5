"""Threads that ask what is due when it is due, whether or not earlier requests were answered."""

from __future__ import annotations

import http.client
import json
import queue
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from urllib.parse import urlsplit

from service.studies.load.demand import Kind, Request

TIMEOUT_S = 30.0
GOOD = {"post": (202,), "rotor": (200, 304), "prediction": (200, 304), "readings": (200, 304)}
EARLY = "not-yet"  # a rotor's first posterior is still being made


@dataclass(frozen=True, slots=True)
class Answered:
    """One request: when it was due, how long until its answer was read, and what it was.

    late_s   of that, until it could be sent at all, since every thread was waiting
    status   0: no answer
    problem  what a refusal says, else empty
    """

    due_s: float
    took_s: float
    late_s: float
    kind: Kind
    status: int
    problem: str = ""

    @property
    def good(self) -> bool:
        return self.status in GOOD[self.kind]


class Crowd:
    """`size` threads; `begun` is the moment (monotonic) from which requests are due."""

    def __init__(self, url: str, demand: Iterator[Request], size: int, begun: float) -> None:
        self.answered: queue.SimpleQueue[Answered] = queue.SimpleQueue()
        self._demand, self._lock, self._begun = demand, threading.Lock(), begun
        self._tags: dict[str, str] = {}
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=self._work, args=(url,), daemon=True) for _ in range(size)
        ]
        for thread in self._threads:
            thread.start()

    def _next(self) -> Request | None:
        with self._lock:
            return next(self._demand, None)

    def _work(self, url: str) -> None:
        place = urlsplit(url)
        with closing(
            http.client.HTTPConnection(place.hostname or "", place.port, timeout=TIMEOUT_S)
        ) as client:
            while (request := self._next()) is not None:
                if self._stop.wait(max(0.0, self._begun + request.at_s - time.monotonic())):
                    return
                sent = time.monotonic()
                status, problem = self._ask(client, request)
                due = self._begun + request.at_s
                took, late = time.monotonic() - due, sent - due
                told = Answered(request.at_s, took, late, request.kind, status, problem)
                self.answered.put(told)

    def _ask(self, client: http.client.HTTPConnection, request: Request) -> tuple[int, str]:
        """Status and what a refusal says. (The standard library's client takes the least.)"""
        tag = self._tags.get(request.path)
        try:
            if request.body is not None:
                body = json.dumps(request.body).encode()
                client.request("POST", request.path, body, {"Content-Type": "application/json"})
            else:
                client.request("GET", request.path, headers={"If-None-Match": tag} if tag else {})
            answer = client.getresponse()
            text = answer.read()
        except (OSError, http.client.HTTPException) as error:
            client.close()  # opened again by the next request
            return 0, type(error).__name__
        if (tag := answer.headers.get("etag")) is not None:
            self._tags[request.path] = tag
        if answer.status < 400:
            return answer.status, ""
        try:
            told = json.loads(text)
            problem = f"{told['type'].rpartition(':')[2]}: {told['detail']}"
        except (ValueError, KeyError):
            problem = text[:200].decode(errors="replace")
        return answer.status, problem

    def taken(self) -> list[Answered]:
        """What was answered since the last call."""
        found = []
        while True:
            try:
                found.append(self.answered.get_nowait())
            except queue.Empty:
                return found

    @property
    def busy(self) -> bool:
        return any(thread.is_alive() for thread in self._threads)

    def stop(self) -> None:
        """Ask nothing more; requests under way are finished."""
        self._stop.set()
        for thread in self._threads:
            thread.join()
