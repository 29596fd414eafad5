"""The quick science of the studies, and the processes that run it.

It is the exact twin of `service.fake`, made slow by a few milliseconds so that a process is often
killed in the middle of its work. Its provisional states name the state that they were computed
from; sealed ones cannot, for they are a function of the readings alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from core.observation import Inspection
from service.fake import FakeScience, FakeState
from service.ports import ModelCard, RotorSpec
from service.studies.chaos.processes import Kind

DELAY_S = 0.01


class Descent(FakeScience):
    """The exact twin whose provisional states tell their parent."""

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: Any,
        *,
        quick: bool,
    ) -> FakeState:
        state = super().update(card, rotor, readings, previous, quick=quick)
        if state.meta["sealed"]:
            return state
        before = None if previous is None else previous.digest
        return replace(state, meta={**state.meta, "parent": before})


def main(kind: Kind, owner: str, delay_s: float = DELAY_S) -> None:
    """An API, or a worker with the twin, until it is stopped; settings from the environment."""
    from service.bootstrap import make_store, make_worker
    from service.processes import serve
    from service.settings import Settings
    from service.telemetry import configure_logs
    from service.worker.loop import run_worker

    settings = Settings.load()
    if kind == "api":
        serve(settings)
        return
    configure_logs(settings.log_level)
    science = Descent(delay_s=delay_s, provisional=True)
    run_worker(make_worker(make_store(settings), science, settings, owner, kind))
