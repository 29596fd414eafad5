"""A worker process with a slow twin, for tests that kill it: slow_worker.py OWNER ROLE DELAY_S."""

from __future__ import annotations

import sys
from typing import cast

from service.bootstrap import make_store, make_worker
from service.fake import FakeScience
from service.settings import Settings
from service.worker.claiming import Role
from service.worker.loop import end_with_parent, run_worker


def main(owner: str, role: Role, delay_s: float) -> None:
    end_with_parent()
    settings = Settings.load()
    science = FakeScience(delay_s=delay_s, provisional=True)
    run_worker(make_worker(make_store(settings), science, settings, owner, role))


if __name__ == "__main__":
    main(sys.argv[1], cast(Role, sys.argv[2]), float(sys.argv[3]))
