"""A worker process with a slow twin, for tests that kill it: slow_worker.py OWNER ROLE DELAY_S.

With a fourth word, the path of a file, a diagnosis or a training goes no further than its first
step until there is that file.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from service.bootstrap import make_store, make_worker
from service.fake import FakeScience
from service.ports import Json, ModelCard
from service.settings import Settings
from service.worker.claiming import Role
from service.worker.loop import end_with_parent, run_worker


@dataclass(frozen=True, slots=True)
class Held(FakeScience):
    """The twin that waits for a file."""

    gate: str = ""

    def held(self, progress: Callable[..., None]) -> Callable[..., None]:
        def step(what: str, done: int, total: int) -> None:
            progress(what, done, total)
            while done and not Path(self.gate).exists():
                time.sleep(0.02)

        return step

    def diagnose(self, *given: Any) -> Json:
        *others, progress, kept, heed = given
        return FakeScience.diagnose(self, *others, self.held(progress), kept, heed)

    def train(self, *given: Any) -> tuple[ModelCard, bytes]:
        *others, progress = given
        return FakeScience.train(self, *others, self.held(progress))


def main(owner: str, role: Role, delay_s: float, gate: str = "") -> None:
    end_with_parent()
    settings, slow = Settings.load(), {"delay_s": delay_s, "provisional": True}
    science = Held(**slow, gate=gate) if gate else FakeScience(**slow)  # type: ignore[arg-type]
    run_worker(make_worker(make_store(settings), science, settings, owner, role))


if __name__ == "__main__":
    main(sys.argv[1], cast(Role, sys.argv[2]), float(sys.argv[3]), *sys.argv[4:])
