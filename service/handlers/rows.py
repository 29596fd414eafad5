"""Bands over hours as flat rows, for dashboards that read tables (Grafana)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.errors import RangeError
from service.handlers.blades import blades_at, blades_of
from service.handlers.questions import Question
from service.handlers.reads import Basis, bands_of, held_from
from service.ports import BladeRecord, Json, Science, Store

MOST_ROWS = 20_000


def everyone_running(store: Store, found: Basis) -> list[BladeRecord]:
    """Blades that run in the version, in the order of their names."""
    state = found.state
    with store.read() as tx:
        blades = blades_at(blades_of(tx, state.rotor_id), state.through_seq)
    return sorted((b for b in blades if not b.retired_seq), key=lambda blade: blade.id)


def running(store: Store, found: Basis, after: str, count: int) -> list[BladeRecord]:
    """Those after one name, so many."""
    return [blade for blade in everyone_running(store, found) if blade.id > after][:count]


def check_rows(asked: Question, blades: int) -> None:
    """RangeError: more rows than one answer should hold."""
    count = len(asked.times) * blades
    if count > MOST_ROWS:
        problem = f"hours of {blades} blades are {count} rows, more than {MOST_ROWS}"
        most = max(MOST_ROWS // len(asked.times), 1)
        remedy = f"ask for fewer `times`, or for limit={most} and follow `next`"
        raise RangeError("times", len(asked.times), problem, remedy)


def rows(
    store: Store,
    science: Science,
    found: Basis,
    asked: Question,
    component: int | None,
    blades: Sequence[BladeRecord],
) -> list[Json]:
    """A row for each blade and hour: ``blade, time, value, lower, upper, held``.

    time   operating hours; value: the mean; lower, upper: between which a reading falls with the
           probability asked for
    held   an adopted effect would take an input out of the model's runs by then, and it is held at
           their end, or its course ended: there is too little of the effect (`held_from`)
    """
    out: list[Json] = []
    get = found.arrays(store)
    for blade in blades:
        bands = bands_of(science, found, get, blade, asked)
        start = held_from(science, found, get, blade)
        parts = [np.asarray(part) for part in (bands.mean, bands.lower, bands.upper)]
        along = [(p if component is None else p[:, component]).tolist() for p in parts]
        for time, value, lower, upper in zip(asked.times, *along, strict=True):
            row = {"time": time, "value": value, "lower": lower, "upper": upper}
            row["held"] = start is not None and time >= start
            out.append({"blade": blade.id} | row)
    return out
