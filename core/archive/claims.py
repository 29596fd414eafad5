"""Which worker computes which run of an archive that several work on.

Workers are processes on one or more machines that share a folder, local or over a network. A
claim on run 7 is a file ``claims/0007-1.json`` beside the runs. It comes into being by ``link``,
which succeeds for one of all who try, on NFS as well, and shows the file whole; there are no
locks. (Where an answer was lost on its way and the repeated call says "exists", the number of
links tells who was first.) The next who takes the run over makes ``0007-2.json`` in the same
manner: two who find the same dead claim make one successor, and nobody removes a file that
another may just have written. The files stay and tell who computed what.

    state     held → done | failed | released
    beat      a number that the owner raises every `every_s` seconds while it holds the claim
    owner     host, process, and what tells a process of this machine from its namesakes

A claim is dead when its owner is a process of this machine that has ended (told at once), or when
its beat stood still for six of its own periods *while this worker watched*, by this worker's own
clock: machines need not agree on the time. An owner that was only asleep finds the run computed
when it wakes up: runs are published by ``link`` too (`core.archive.store.Archive.add`), so that
the first one stays.
"""

from __future__ import annotations

import json
import os
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal
from uuid import uuid4

from core.archive.disk import link_file

State = Literal["held", "done", "failed", "released"]
Verdict = Literal["taken", "held", "failed"]
EVERY_S = 20.0
PERIODS = 6  # of silence, and a claim is dead
NAME = re.compile(r"(\d{4,})-(\d+)\.json")


@dataclass(frozen=True, slots=True)
class Found:
    """The newest claim on a run: its generation, and what its file says."""

    generation: int
    told: Mapping[str, Any]

    @property
    def state(self) -> str:
        return str(self.told.get("state", "held"))


class Claims:
    """The claims of one worker.

    folder    of the claims; made where it is not there yet
    every_s   seconds between two beats of this worker
    clock     seconds that only go forward
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        every_s: float = EVERY_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder, self._every, self._clock = Path(folder), every_s, clock
        self._folder.mkdir(parents=True, exist_ok=True)
        self._owner = owner()
        self._held: dict[int, tuple[Path, dict[str, Any]]] = {}
        self._watched: dict[int, tuple[object, float]] = {}
        self._lock = threading.Lock()
        # what had come to its end before this worker began may be begun again
        self._old = {
            (index, found.generation)
            for index, found in self.newest().items()
            if found.state != "held"
        }

    def newest(self) -> dict[int, Found]:
        """The newest claim on each run that has one."""
        found: dict[int, int] = {}
        for name in os.listdir(self._folder):
            if match := NAME.fullmatch(name):
                index, generation = int(match.group(1)), int(match.group(2))
                found[index] = max(found.get(index, 0), generation)
        return {k: Found(g, self._read(k, g)) for k, g in sorted(found.items())}

    def take(self, index: int, found: Found | None) -> Verdict:
        """Try to take run `index`, whose newest claim is `found` (none: it has none)."""
        if found is not None:
            if found.state == "failed" and (index, found.generation) not in self._old:
                return "failed"
            if not self._free(index, found):
                return "held"
        generation = 1 if found is None else found.generation + 1
        told = {"owner": self._owner, "every_s": self._every, "beat": 0, "state": "held"}
        told |= {"token": uuid4().hex}
        path = self._folder / f"{index:04d}-{generation}.json"
        if not exclusive(path, json.dumps(told)):
            return "held"
        with self._lock:
            self._held[index] = path, told
        return "taken"

    def end(self, index: int, state: State, **told: object) -> None:
        """Give up a claim: done, failed (with a reason) or released."""
        with self._lock:
            path, before = self._held.pop(index)
            _replace(path, before | {"state": state} | told)

    def beat(self) -> None:
        """Tell that the held claims are alive. A beat that cannot be written is left out."""
        with self._lock:
            for path, told in self._held.values():
                told["beat"] += 1
                try:
                    _replace(path, told)
                except OSError:
                    continue

    @contextmanager
    def beating(self) -> Iterator[None]:
        """Beat in a thread; at the end what is still held is released."""
        stop = threading.Event()

        def run() -> None:
            while not stop.wait(self._every):
                self.beat()

        thread = threading.Thread(target=run, daemon=True, name="claims")
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()
            for index in list(self._held):
                self.end(index, "released")

    def _free(self, index: int, found: Found) -> bool:
        """Whether the claim stands for nothing any more."""
        told = found.told
        if found.state == "released" or (index, found.generation) in self._old:
            return True
        if found.state == "held" and ended(told.get("owner", {})):
            return True
        # done, and yet no run to be seen: perhaps this machine's view of the folder lags behind
        sign, now = (
            (found.generation, told.get("token"), told.get("beat"), found.state),
            self._clock(),
        )
        if index not in self._watched or self._watched[index][0] != sign:
            self._watched[index] = sign, now
        every = told.get("every_s", self._every)
        return now - self._watched[index][1] > PERIODS * float(every)

    def _read(self, index: int, generation: int) -> Mapping[str, Any]:
        try:
            told = json.loads((self._folder / f"{index:04d}-{generation}.json").read_text())
        except (OSError, ValueError):
            return {}
        return told if isinstance(told, dict) else {}


def exclusive(path: Path, text: str) -> bool:
    """Make a file with this text if there is none; False if there is one already."""
    part = path.with_name(f".{path.name}.{uuid4().hex}")
    try:
        part.write_text(text)
        return link_file(part, path)
    finally:
        part.unlink(missing_ok=True)


def _replace(path: Path, told: Mapping[str, Any]) -> None:
    part = path.with_name(f".{path.name}.{uuid4().hex}")
    try:
        part.write_text(json.dumps(told))
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def owner() -> dict[str, Any]:
    """This process, as a claim names it."""
    process = os.getpid()
    return {
        "host": socket.gethostname(),
        "pid": process,
        "machine": machine(),
        "started": started(process),
    }


def ended(named: Mapping[str, Any]) -> bool:
    """Whether an owner is a process of this machine that is no more; False where unknown.

    >>> ended(owner()), ended(owner() | {"started": "1"}), ended(owner() | {"machine": "other"})
    (False, True, False)
    """
    here = machine()
    if not here or named.get("machine") != here or named.get("started") is None:
        return False
    return bool(started(int(named.get("pid", 0))) != named["started"])


@cache
def machine() -> str:
    """This boot of this machine and its room of process numbers; empty where not to be told."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot}:{os.stat('/proc/self/ns/pid').st_ino}"
    except OSError:
        return ""


def started(process: int) -> str | None:
    """When a process began, in the kernel's ticks; none: it has ended, or that is not told."""
    try:
        told = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if told[0] in "ZX" else told[19]
