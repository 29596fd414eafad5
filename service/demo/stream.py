"""How the inspections arrive: outage by outage, scattered, some of them much too late.

Within an outage the order is shuffled; of the readings of the first two outages one in seven
comes only with the next outage, so that the twin has to take it as if it had been in time. A
destroyed blade is retired and its successor installed once its outage is through.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from core.builtin.inspection_plan import DESTROYED, Plan
from core.rng import stream

LATE = 1 / 7
Json = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Step:
    """One request: readings to post, or a blade to retire and its successor.

    through   the outage ends here
    """

    inspections: tuple[Json, ...] = ()
    retire: str | None = None
    install: str | None = None
    through: bool = False


def steps(plan: Plan, seed: int) -> Iterator[Step]:
    """Every request of the main job, in order; the same for the same seed."""
    rng = stream(seed, "arrival")
    held: list[Json] = []
    for outage in range(3):
        due = [i for i in plan.inspections if i["campaign"] == f"outage-{outage + 1}"]
        late = [outage < 2 and rng.random() < LATE for _ in due]
        batch = held + [i for i, is_late in zip(due, late, strict=True) if not is_late]
        held = [i for i, is_late in zip(due, late, strict=True) if is_late]
        order = rng.permutation(len(batch))
        at = 0
        while at < len(batch):
            size = int(rng.integers(1, 9))
            yield Step(tuple(batch[i] for i in order[at : at + size]))
            at += size
        for blade, when in DESTROYED.items():
            if when == outage:
                yield Step(retire=blade, install=f"{blade}-2", through=True)
