"""A worker process whose twin hangs over some readings: hanging_worker.py OWNER ROLE.

Over one called ``sleeps`` it waits for ever, over ``holds`` it does so with the interpreter's lock,
and over ``seals`` it waits where it seals.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Sequence
from typing import Any, cast

from core.observation import Inspection
from service.bootstrap import make_store, make_worker
from service.fake import FakeScience, FakeState
from service.ports import ModelCard, RotorSpec
from service.settings import Settings
from service.worker.claiming import Role
from service.worker.loop import end_with_parent, run_worker


class Hanging(FakeScience):
    """The twin that hangs."""

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: Any,
        *,
        quick: bool,
    ) -> FakeState:
        names = {one.id for one in readings}
        if "sleeps" in names or ("seals" in names and not quick):
            threading.Event().wait()
        while "holds" in names:
            ctypes.PyDLL(None).pause()
        return super().update(card, rotor, readings, previous, quick=quick)


def main(owner: str, role: Role) -> None:
    end_with_parent()
    settings = Settings.load()
    science = Hanging(provisional=True)
    run_worker(make_worker(make_store(settings), science, settings, owner, role))


if __name__ == "__main__":
    main(sys.argv[1], cast(Role, sys.argv[2]))
