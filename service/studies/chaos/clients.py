"""Clients that post side by side and send the same again until they are answered.

What a client may rely on: after 202 the reading is in the log for ever, under the sequence number
of the answer; after no answer, or after 503, it may send the same again. Any other answer to this
traffic is a breach, and so is another number for a reading that has one.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import httpx

from service.studies.chaos.traffic import Batch, Traffic

PAUSE_S = 0.2
PATIENCE_S = 180.0


@dataclass
class Ledger:
    """What was acknowledged: (rotor, entry's id) → sequence number; and everything odd."""

    acknowledged: dict[tuple[str, str], int] = field(default_factory=dict)
    answers: Counter[str] = field(default_factory=Counter)
    breaches: list[str] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def note(self, rotor: str, entry: str, seq: int) -> None:
        with self.lock:
            first = self.acknowledged.setdefault((rotor, entry), seq)
        if first != seq:
            self.breach(f"{rotor}/{entry} was answered with number {first}, later with {seq}")

    def count(self, what: str) -> None:
        with self.lock:
            self.answers[what] += 1

    def breach(self, what: str) -> None:
        with self.lock:
            self.breaches.append(what)

    @property
    def readings(self) -> int:
        return sum("/" not in entry for _, entry in list(self.acknowledged))


class Poster:
    """One client with a connection of its own."""

    def __init__(self, url: str, ledger: Ledger, give_up: threading.Event) -> None:
        self.http = httpx.Client(base_url=url, timeout=45.0)
        self.ledger = ledger
        self.give_up = give_up

    def insist(self, path: str, **request: Any) -> dict[str, Any] | None:
        """Send until it is acknowledged; None: refused, or nobody answers any more."""
        end = time.monotonic() + PATIENCE_S
        while not self.give_up.is_set() and time.monotonic() < end:
            try:
                answer = self.http.post(path, **request)
            except httpx.TransportError as error:
                self.ledger.count(type(error).__name__)
                time.sleep(PAUSE_S)
                continue
            self.ledger.count(str(answer.status_code))
            if answer.status_code in (201, 202):
                told: dict[str, Any] = answer.json()
                return told
            if answer.status_code != 503:
                self.ledger.breach(f"{path}: {answer.status_code} {answer.text[:300]}")
                return None
            time.sleep(PAUSE_S)
        self.ledger.breach(f"{path}: no answer")
        return None

    def post(self, batch: Batch) -> None:
        path = f"/v1/rotors/{batch.rotor}/inspections"
        headers = {"content-type": batch.media}
        for _ in range(1 + batch.twice):
            told = self.insist(path, content=batch.content, headers=headers)
            for item in [] if told is None else told["items"]:
                self.ledger.note(batch.rotor, item["id"], item["seq"])
        for name in batch.retract:
            told = self.insist(f"{path}/{name}/retraction")
            if told is not None:
                self.ledger.note(batch.rotor, f"retraction/{name}", told["head_seq"])


def create(url: str, traffic: Traffic, ledger: Ledger, particles: int, seed: int) -> None:
    """Create the rotors."""
    poster = Poster(url, ledger, threading.Event())
    for rotor in traffic.rotors:
        body = {"id": rotor, "model": "rotor-blade", "particles": particles, "seed": seed}
        poster.insist("/v1/rotors", json=body | {"blades": [{"id": b} for b in traffic.blades]})
    poster.http.close()


class Crowd:
    """`size` clients that share the batches out among themselves, whoever is free the next one;
    each rests for `pause_s` after a batch."""

    def __init__(
        self, url: str, batches: list[Batch], size: int, ledger: Ledger, pause_s: float = 0.0
    ) -> None:
        self._left: queue.SimpleQueue[Batch] = queue.SimpleQueue()
        for batch in batches:
            self._left.put(batch)
        self._give_up = threading.Event()
        self._pause_s = pause_s
        self._threads = [
            threading.Thread(target=self._work, args=(url, ledger), daemon=True)
            for _ in range(size)
        ]

    def _work(self, url: str, ledger: Ledger) -> None:
        poster = Poster(url, ledger, self._give_up)
        try:
            while not self._give_up.is_set():
                poster.post(self._left.get_nowait())
                self._give_up.wait(self._pause_s)
        except queue.Empty:
            return
        except Exception as error:
            ledger.breach(f"a client failed: {error!r}")
        finally:
            poster.http.close()

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    @property
    def busy(self) -> bool:
        return any(thread.is_alive() for thread in self._threads)

    def stop(self) -> None:
        """Give up what is left; a request under way is finished."""
        self._give_up.set()
        for thread in self._threads:
            thread.join()
