"""What the API processes of one service count, each by itself, and tell as one.

Prometheus asks the service, and any of its processes may answer; counts that were another's each
time would look like restarts. So each process has a place with a file without a name, which it
shares with the others by descriptor; it writes there what it has counted, once a second, and who is
asked for metrics adds up all places. A process that is started again in the place of a dead one
goes on from what that had written; what the dead one had counted since is lost. A file has two
halves, of which its first byte names the one that holds: a process that dies while it writes leaves
the other as it was, so that no sum falls.
"""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import struct
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO

from service.api.feed import Feed
from service.api.metrics import Requests
from service.ports import Json

WRITE_S = 1.0
HALF = 4 * 2**20  # bytes; a sparse file takes what is written
_LENGTH = struct.Struct("<Q")


def files(number: int) -> list[IO[bytes]]:
    """A file without a name for each place, for processes that inherit its descriptor."""
    return [tempfile.TemporaryFile(prefix="bladetwin-") for _ in range(number)]


class Together:
    """The counts of all places, as the process in one of them sees and writes them.

    counts   the descriptor of each place's file
    place    the own one
    """

    def __init__(self, counts: Sequence[int], place: int) -> None:
        self._counts = tuple(counts)
        self._place = place
        self._lock = threading.Lock()  # the locks of a file are a process's, not a thread's

    def resume(self, requests: Requests) -> None:
        """Go on from what was counted before in this place."""
        if (told := self._read(self._place)) is not None:
            requests.add(told["requests"])

    def write(self, requests: Requests, feed: Feed) -> None:
        """Tell the others what stands in this process."""
        told = {"requests": requests.told(), "streams": feed.listeners}
        text = json.dumps(told).encode()
        file = self._counts[self._place]
        with self._held(file, fcntl.LOCK_EX):
            half = 1 - _half(file)
            os.pwrite(file, _LENGTH.pack(len(text)) + text, 1 + half * HALF)
            os.pwrite(file, bytes([half]), 0)

    async def keep_writing(self, requests: Requests, feed: Feed) -> None:
        """Tell the others once a second, until cancelled; a last time then."""
        try:
            while True:
                self.write(requests, feed)
                await asyncio.sleep(WRITE_S)
        finally:
            self.write(requests, feed)

    def whole(self, requests: Requests, streams: int) -> tuple[Requests, int]:
        """The counts of all places: the own ones as they are now, the others' as written last."""
        total = Requests()
        total.add(requests.told())
        for place in range(len(self._counts)):
            told = None if place == self._place else self._read(place)
            if told is not None:
                total.add(told["requests"])
                streams += told["streams"]
        return total, streams

    def _read(self, place: int) -> Json | None:
        file = self._counts[place]
        with self._held(file, fcntl.LOCK_SH):
            start = 1 + _half(file) * HALF
            (size,) = _LENGTH.unpack(os.pread(file, _LENGTH.size, start) or bytes(_LENGTH.size))
            text = os.pread(file, size, start + _LENGTH.size)
        return json.loads(text) if text else None

    @contextmanager
    def _held(self, file: int, how: int) -> Iterator[None]:
        with self._lock:
            fcntl.lockf(file, how)
            try:
                yield
            finally:
                fcntl.lockf(file, fcntl.LOCK_UN)


def _half(file: int) -> int:
    return (os.pread(file, 1, 0) or b"\0")[0]
