"""A worker process whose twin hangs over some readings: hanging_worker.py OWNER ROLE.

Over one called ``sleeps`` it waits for ever, over ``holds`` it does so with the interpreter's lock,
and over ``seals`` it waits where it seals. A diagnosis waits after its first step over
``diagnosed``, and so do the residuals of ``foretold``; other diagnoses take a while for each step.
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
from service.ports import Json, ModelCard, RotorSpec
from service.settings import Settings
from service.worker.claiming import Role
from service.worker.loop import end_with_parent, run_worker

STEP_S = 0.6  # of a diagnosis


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

    def diagnose(self, card: ModelCard, rotor: RotorSpec, facts: Any, *given: Any) -> Json:
        readings, progress = given[0], given[-3]
        if "diagnosed" in {one.id for one in readings}:
            progress("a step", 0, 2)
            threading.Event().wait()
        return super().diagnose(card, rotor, facts, *given)

    def residuals(self, card: ModelCard, rotor: RotorSpec, facts: Any, *given: Any) -> Json:
        if "foretold" in {one.id for one in given[0]}:
            given[-1]("a step", 0, 2)
            threading.Event().wait()
        return super().residuals(card, rotor, facts, *given)


def main(owner: str, role: Role) -> None:
    end_with_parent()
    settings = Settings.load()
    science = Hanging(provisional=True, delay_s=STEP_S if role == "diagnose" else 0.0)
    run_worker(make_worker(make_store(settings), science, settings, owner, role))


if __name__ == "__main__":
    main(sys.argv[1], cast(Role, sys.argv[2]))
