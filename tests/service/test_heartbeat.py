"""One thread beats for all works of another, one after the other or one inside the other."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from service.worker.heartbeat import heartbeats, rest
from tests.patience import PATIENCE_S, until

LONG_S = 3 * PATIENCE_S


def beating() -> set[threading.Thread]:
    """The threads that beat for the caller's."""
    name = f"heartbeat of {threading.current_thread().name}"
    return {thread for thread in threading.enumerate() if thread.name == name}


def beats(beaten: threading.Event) -> Callable[[], bool]:
    def beat() -> bool:
        beaten.set()
        return True

    return beat


def in_thread(block: Callable[[], None]) -> None:
    """Run it in a thread that has met no work yet; what it raises is raised."""
    raised: list[BaseException] = []

    def run() -> None:
        try:
            block()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    if raised:
        raise raised[0]


def test_works_that_follow_one_another_share_a_thread() -> None:
    def works() -> None:
        found: set[threading.Thread] = set()
        for _ in range(20):
            with heartbeats(lambda: True, LONG_S):
                found |= beating()
        assert len(found) == 1

    in_thread(works)


def test_who_rests_ends_the_thread_though_it_does_not_sleep_yet() -> None:
    def works() -> None:
        for _ in range(50):
            with heartbeats(lambda: True, LONG_S):
                pass
            rest()
            assert not beating()

    in_thread(works)


def test_a_work_with_a_short_lease_is_beaten_for_though_one_with_a_long_lease_went_before() -> None:
    def works() -> None:
        beaten = threading.Event()
        with heartbeats(lambda: True, LONG_S):
            time.sleep(0.1)  # the thread sleeps by now
        with heartbeats(beats(beaten), 0.03):
            assert beaten.wait(PATIENCE_S / 4)

    in_thread(works)


def test_two_works_at_once_are_both_beaten_for() -> None:
    def works() -> None:
        one, other = threading.Event(), threading.Event()
        with (
            heartbeats(beats(one), 0.03),
            heartbeats(beats(other), 0.05),
        ):
            assert one.wait(PATIENCE_S)
            assert other.wait(PATIENCE_S)

    in_thread(works)


def test_who_ends_a_work_waits_for_its_beat_and_none_comes_after() -> None:
    begun, told = threading.Event(), list[str]()

    def beat() -> bool:
        begun.set()
        time.sleep(0.2)
        told.append("beaten")
        return True

    def works() -> None:
        with heartbeats(beat, 0.03):
            assert begun.wait(PATIENCE_S)
        count = len(told)
        assert count >= 1
        time.sleep(0.3)
        assert len(told) == count

    in_thread(works)


def test_the_thread_ends_where_nothing_is_under_way_and_another_one_begins() -> None:
    def works() -> None:
        for _ in range(2):
            beaten = threading.Event()
            with heartbeats(beats(beaten), 0.03):
                assert beaten.wait(PATIENCE_S)
            until("its end", lambda: not beating())

    in_thread(works)


def test_a_beat_that_fails_ends_its_own_work_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[threading.ExceptHookArgs] = []
    monkeypatch.setattr(threading, "excepthook", told.append)
    seen = threading.Event()

    def failing() -> bool:
        assert seen.wait(PATIENCE_S)
        raise RuntimeError("a beat")

    def works() -> None:
        with heartbeats(failing, 0.03):
            (heart,) = beating()
            seen.set()
            heart.join(PATIENCE_S)
            assert not heart.is_alive()
        assert [str(args.exc_value) for args in told] == ["a beat"]
        beaten = threading.Event()
        with heartbeats(beats(beaten), 0.03):
            assert beaten.wait(PATIENCE_S)

    in_thread(works)
