"""What an answer is sent in: head and body leave together, nothing stays behind."""

from __future__ import annotations

import asyncio
from typing import Any, cast

from service.api.server import AT_ONCE, Gathering


class Wire:
    """A transport that notes what it was told."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def write(self, data: bytes) -> None:
        self.told.append(data)

    def close(self) -> None:
        self.told.append("closed")

    def is_closing(self) -> bool:
        return "closed" in self.told


def wrapped() -> tuple[Wire, Gathering]:
    wire = Wire()
    return wire, Gathering(cast(asyncio.Transport, wire), asyncio.get_running_loop())


def test_what_is_written_in_one_turn_leaves_at_once() -> None:
    async def turns() -> list[Any]:
        wire, transport = wrapped()
        transport.write(b"head ")
        transport.write(b"body")
        assert wire.told == []
        await asyncio.sleep(0)
        transport.write(b"a later part")
        await asyncio.sleep(0)
        return wire.told

    assert asyncio.run(turns()) == [b"head body", b"a later part"]


def test_what_was_written_leaves_before_the_end() -> None:
    async def ending() -> list[Any]:
        wire, transport = wrapped()
        transport.write(b"last words")
        transport.close()
        assert transport.is_closing()
        await asyncio.sleep(0)
        return wire.told

    assert asyncio.run(ending()) == [b"last words", "closed"]


def test_what_is_large_is_not_held_back() -> None:
    """Parts that come without a turn between them: the transport has to be able to say stop."""

    async def streaming() -> list[int]:
        wire, transport = wrapped()
        for _ in range(10):
            transport.write(b"x" * (AT_ONCE // 2))
        before = [len(data) for data in wire.told]
        await asyncio.sleep(0)
        return [*before, *(len(data) for data in wire.told[len(before) :])]

    assert asyncio.run(streaming()) == [3 * AT_ONCE // 2] * 3 + [AT_ONCE // 2]
