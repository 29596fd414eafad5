"""Threads that ask what is due when it is due, whether or not earlier requests were answered."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

import httpx

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
        with httpx.Client(base_url=url, timeout=TIMEOUT_S) as client:
            while (request := self._next()) is not None:
                if self._stop.wait(max(0.0, self._begun + request.at_s - time.monotonic())):
                    return
                sent = time.monotonic()
                status, problem = self._ask(client, request)
                due = self._begun + request.at_s
                took, late = time.monotonic() - due, sent - due
                told = Answered(request.at_s, took, late, request.kind, status, problem)
                self.answered.put(told)

    def _ask(self, client: httpx.Client, request: Request) -> tuple[int, str]:
        try:
            if request.body is not None:
                answer = client.post(request.path, json=request.body)
            else:
                tag = self._tags.get(request.path)
                answer = client.get(request.path, headers={"If-None-Match": tag} if tag else {})
        except httpx.TransportError as error:
            return 0, type(error).__name__
        if (tag := answer.headers.get("etag")) is not None:
            self._tags[request.path] = tag
        if answer.status_code < 400:
            return answer.status_code, ""
        try:
            told = answer.json()
            problem = f"{told['type'].rpartition(':')[2]}: {told['detail']}"
        except (ValueError, KeyError):
            problem = answer.text[:200]
        return answer.status_code, problem

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
