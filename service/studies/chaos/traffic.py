"""What the clients post: a function of the seed alone.

Of all readings three in a hundred correct an earlier one of their rotor and one in a hundred is
retracted right after it was acknowledged. They come in batches of one to eight, as JSON or, where
nothing is corrected, now and then as CSV. One batch in five is posted again after its answer, as a
client does that did not see it.
"""

from __future__ import annotations

import json
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

CORRECTED, RETRACTED, TWICE, AS_CSV = 0.03, 0.01, 0.2, 0.1
LARGEST_BATCH = 8
COLUMNS = ("id", "blade", "quantity", "time_h", "value")


@dataclass(frozen=True, slots=True)
class Batch:
    """One request of readings. `retract`: ids that are retracted once it is acknowledged."""

    rotor: str
    ids: tuple[str, ...]
    content: bytes
    media: str
    retract: tuple[str, ...]
    twice: bool


@dataclass(frozen=True, slots=True)
class Traffic:
    """Rotors with their blades, and what is posted to them, in one of its possible orders."""

    rotors: tuple[str, ...]
    blades: tuple[str, ...]
    batches: tuple[Batch, ...]

    @property
    def readings(self) -> int:
        return sum(len(batch.ids) for batch in self.batches)


def make(rotors: int, readings: int, blades: int, seed: int) -> Traffic:
    """The traffic of a seed: `readings` in all, shared out among the rotors at random."""
    chosen = random.Random(seed)
    names = tuple(f"rotor-{i:02d}" for i in range(rotors))
    parts = tuple(f"B{i:02d}" for i in range(blades))
    known: dict[str, list[str]] = {name: [] for name in names}
    batches: list[Batch] = []
    left, number = readings, 0
    while left > 0:
        rotor, size = chosen.choice(names), min(left, chosen.randint(1, LARGEST_BATCH))
        rows = []
        for _ in range(size):
            rows.append(_reading(chosen, f"i{number:06d}", parts, known[rotor]))
            known[rotor].append(rows[-1]["id"])
            number += 1
        left -= size
        batches.append(_batch(chosen, rotor, rows))
    return Traffic(names, parts, tuple(batches))


def _reading(
    chosen: random.Random, name: str, blades: Sequence[str], known: Sequence[str]
) -> dict[str, Any]:
    reading = {
        "id": name,
        "blade": chosen.choice(blades),
        "quantity": "elongation",
        "time_h": float(chosen.randrange(500, 50_000)),
        "value": round(chosen.uniform(0.01, 0.6), 4),
    }
    if known and chosen.random() < CORRECTED:
        reading["replaces"] = chosen.choice(known)
    return reading


def _batch(chosen: random.Random, rotor: str, rows: Sequence[dict[str, Any]]) -> Batch:
    ids = tuple(row["id"] for row in rows)
    retract = tuple(name for name in ids if chosen.random() < RETRACTED)
    twice = chosen.random() < TWICE
    if chosen.random() < AS_CSV and not any("replaces" in row for row in rows):
        lines = [",".join(COLUMNS), *(",".join(str(row[c]) for c in COLUMNS) for row in rows)]
        return Batch(rotor, ids, "\n".join(lines).encode(), "text/csv", retract, twice)
    body: Any = rows[0] if len(rows) == 1 else {"inspections": list(rows)}
    return Batch(rotor, ids, json.dumps(body).encode(), "application/json", retract, twice)
