"""A heat map of residuals: blades across, inspections down, before above after.

Classes of |z|, told by colour and, from three sds on, by the number in the cell as well.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from service.report.figures import BOTH, label_of, named
from service.report.markup import Markup
from service.report.svg import LETTER, WIDE, block, picture, short, words

Json = Mapping[str, Any]
EDGES = (0.5, 1.0, 2.0, 3.0, 4.0)
MOST = 100  # blades across; more go on below
SAME = 0.02  # of the longest history: readings of one visit


def klass(z: float) -> str:
    """The class of a cell.

    >>> klass(0.2), klass(-1.5), klass(9.0)
    ('z0', 'n2', 'p5')
    """
    level = sum(abs(z) >= e for e in EDGES)
    return "z0" if level == 0 else f"{'n' if z < 0 else 'p'}{level}"


def visits(readings: Sequence[Json]) -> list[str]:
    """Of each reading the visit: its campaign, else the rotor's hours of those that go together."""
    longest = max((r["rotor_h"] for r in readings), default=0.0)
    named: dict[float, float] = {}
    start = None
    for hour in sorted({r["rotor_h"] for r in readings if r["campaign"] is None}):
        if start is None or hour - start > SAME * longest:
            start = hour
        named[hour] = start
    return [
        r["campaign"] if r["campaign"] is not None else f"{named[r['rotor_h']]:,.0f} h"
        for r in readings
    ]


def rows_of(readings: Sequence[Json]) -> dict[str, list[int]]:
    """Readings by visit and quantity, in the order of hours."""
    several = len({r["quantity"] for r in readings}) > 1
    found: dict[str, list[int]] = {}
    visit = visits(readings)
    for i in sorted(
        range(len(readings)), key=lambda i: (readings[i]["rotor_h"], readings[i]["id"])
    ):
        what = f", {label_of(readings[i]['quantity'])}" if several else ""
        found.setdefault(visit[i] + what, []).append(i)
    return found


def people(name: str) -> list[str | int]:
    """Names in the order of people: numbers in them by their size.

    >>> sorted(["B10", "B2", "A", "B2-1"], key=people)
    ['A', 'B2', 'B2-1', 'B10']
    """
    return [int(part) if i % 2 else part for i, part in enumerate(re.split(r"(\d+)", name))]


def heat(readings: Sequence[Json], *, changed: bool) -> list[Markup]:
    """As few pictures as hold `MOST` blades each, of as many blades as the others but one."""
    blades = sorted({r["blade"] for r in readings}, key=people)
    rows, pictures = rows_of(readings), -(-len(blades) // MOST)
    ends = [len(blades) * k // pictures for k in range(pictures + 1)] if pictures else [0]
    return [_map(readings, rows, blades[a:b], changed=changed) for a, b in pairwise(ends)]


def _map(
    readings: Sequence[Json], rows: Mapping[str, list[int]], blades: Sequence[str], *, changed: bool
) -> Markup:
    names = [short(name, 26) for name in rows]
    left = 24 + LETTER * max(map(len, names))
    wide = min(44.0, (WIDE - 12 - left) / len(blades))
    tall = 20.0
    place = {b: left + wide * i for i, b in enumerate(blades)}
    step = max(1, -(-16 // max(1, int(wide))))
    parts: list[Markup] = []
    longest = LETTER * max(len(short(b, 16)) for b in blades)
    turned = wide < longest + 6
    head = (longest + 10 if turned else 16.0) + 26
    y = head
    for which in BOTH if changed else BOTH[:1]:
        parts.append(words(left, y - 6, named(which, changed=changed), f"{which} head"))
        for name, members in zip(names, rows.values(), strict=True):
            parts.append(words(left - 8, y + 14, name, "tick", "end"))
            worst: dict[str, Json] = {}
            for i in members:
                r = readings[i]
                old = worst.get(r["blade"])
                if old is None or abs(r[which]["z"]) > abs(old[which]["z"]):
                    worst[r["blade"]] = r
            for blade in blades:
                if blade not in worst:
                    continue
                r, z = worst[blade], worst[blade][which]["z"]
                where = f"{r['id']}: {blade}, {r['time_h']:,.0f} h, z = {z:.2f}"
                x = place[blade]
                parts.append(block(x + 0.5, y + 0.5, wide - 1, tall - 1, f"cell {klass(z)}", where))
                if abs(z) >= EDGES[3] and wide >= 22:
                    said = f"{z:+z.1f}".replace("-", "−")
                    kind = f"in-cell on-{klass(z)}"
                    parts.append(words(x + wide / 2, y + 14, said, kind, "middle"))
            y += tall
        y += 26
    for i, blade in enumerate(blades):
        if i % step:
            continue
        x = place[blade] + wide / 2
        if turned:
            turn = f"rotate(-90 {x + 4:.1f} {head - 24:.1f})"
            parts.append(words(x + 4, head - 24, short(blade, 16), "tick", transform=turn))
        else:
            parts.append(words(x, head - 26, short(blade, 16), "tick", "middle"))
    parts += _key(left, y)
    return picture(y + 34, *parts, label="z of every reading by blade and inspection")


def _key(left: float, y: float) -> list[Markup]:
    """What the colours mean."""
    kinds = [f"n{k}" for k in range(5, 0, -1)] + ["z0"] + [f"p{k}" for k in range(1, 6)]
    edges = [*(f"−{e:g}" for e in reversed(EDGES)), *(f"{e:g}" for e in EDGES)]
    parts = [block(left + 34 * i, y, 34, 10, f"cell {kind}") for i, kind in enumerate(kinds)]
    parts += [
        words(left + 34 * (i + 1), y + 23, edge, "tick", "middle") for i, edge in enumerate(edges)
    ]
    parts.append(words(left + 34 * 11 + 10, y + 10, "z, in sd", "tick"))
    return parts
