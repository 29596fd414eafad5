"""What is asked of the server, and when: a function of the seed.

Posts are single readings. Of reads half show a rotor, four in ten a blade's prediction, one in ten
a page of readings; a reader sends the ETag that it was last given for an address, as browsers and
gateways do.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

Kind = Literal["post", "rotor", "prediction", "readings"]
READS: tuple[tuple[Kind, float], ...] = (("rotor", 0.5), ("prediction", 0.4), ("readings", 0.1))
HOURS = "8000,24000,50000"


@dataclass(frozen=True, slots=True)
class Request:
    """One request, due `at_s` seconds after the beginning."""

    at_s: float
    kind: Kind
    path: str
    body: dict[str, Any] | None = None


def rotor_name(number: int) -> str:
    return f"rotor-{number:03d}"


def blade_name(number: int) -> str:
    return f"B{number:03d}"


def moments(rate: float, seconds: float, chosen: random.Random) -> Iterator[float]:
    """Arrivals of a Poisson process of `rate` a second, in order."""
    at = chosen.expovariate(rate) if rate > 0 else seconds
    while at < seconds:
        yield at
        at += chosen.expovariate(rate)


def posts(rate: float, seconds: float, rotors: int, blades: int, seed: int) -> Iterator[Request]:
    """Single readings to rotors and blades at random."""
    chosen = random.Random(f"{seed}/posts")
    for number, at in enumerate(moments(rate, seconds, chosen)):
        reading = {
            "id": f"i{number:07d}",
            "blade": blade_name(chosen.randrange(blades)),
            "quantity": "elongation",
            "time_h": float(chosen.randrange(500, 50_000)),
            "value": round(chosen.uniform(0.01, 0.6), 4),
        }
        path = f"/v1/rotors/{rotor_name(chosen.randrange(rotors))}/inspections"
        yield Request(at, "post", path, reading)


def reads(rate: float, seconds: float, rotors: int, blades: int, seed: int) -> Iterator[Request]:
    """Reads of rotors and blades at random, in the shares of `READS`."""
    chosen = random.Random(f"{seed}/reads")
    kinds, shares = zip(*READS, strict=True)
    for at in moments(rate, seconds, chosen):
        kind: Kind = chosen.choices(kinds, shares)[0]
        path = f"/v1/rotors/{rotor_name(chosen.randrange(rotors))}"
        if kind == "prediction":
            blade = blade_name(chosen.randrange(blades))
            path += f"/blades/{blade}/prediction?quantity=elongation&times={HOURS}"
        elif kind == "readings":
            path += "/inspections?limit=50&newest=true"
        yield Request(at, kind, path)
