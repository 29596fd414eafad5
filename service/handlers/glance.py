"""What pages show: blades at one hour, draws, fields on the mesh, kept versions, the service."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.errors import InputError, RangeError
from service.errors import FaultsError, NotFoundError
from service.handlers.blades import blades_at, blades_of
from service.handlers.questions import Question
from service.handlers.reads import Basis, bands_of, health, held_from
from service.moments import moment
from service.ports import (
    BladeReadings,
    BladeRecord,
    Json,
    ModelCard,
    Operations,
    Science,
    StateRecord,
    Store,
    Surface,
    Which,
)

MOST_DRAWS = 4000
NO_READINGS = BladeReadings(0, 0, None, None, None)


@dataclass(frozen=True, slots=True)
class Glance:
    """Blades of a version with its readings of each, and where the log ends."""

    blades: tuple[BladeRecord, ...]
    readings: dict[str, BladeReadings]
    head_seq: int


def glance(store: Store, found: Basis, which: Which, after: str, limit: int) -> Glance:
    """Blades of the version in the order of their names, after one name.

    Readings are those of the version asked for; of the newest one, those that wait as well.
    """
    rotor_id = found.state.rotor_id
    with store.read() as tx:
        blades = blades_at(blades_of(tx, rotor_id), found.state.through_seq)
        head = tx.records.rotor(rotor_id).head_seq
        through = head if which.newest else found.state.through_seq
        readings = tx.blade_readings(rotor_id, through)
    shown = [blade for blade in sorted(blades, key=lambda b: b.id) if blade.id > after]
    return Glance(tuple(shown[:limit]), readings, head)


def at_one_hour(
    store: Store, science: Science, found: Basis, asked: Question, blades: Sequence[BladeRecord]
) -> list[Json]:
    """The prediction of each blade at the one hour asked for, and sd without a reading's noise.

    With it the hour from which it has too little of an effect (`held_from`); None: no such hour.
    """
    out = []
    with store.read() as tx:
        get = tx.states.reader(found.state)
        for blade in blades:
            bands = bands_of(science, found, get, blade, asked)
            sd = {name: np.asarray(part)[0] for name, part in bands.sd.items()}
            own = np.sqrt(sum(sd[name] ** 2 for name in ("parameters", "surrogate", "discrepancy")))
            out.append(
                {
                    "mean": np.asarray(bands.mean)[0].tolist(),
                    "sd": {name: np.asarray(part).tolist() for name, part in sd.items()}
                    | {"blade": np.asarray(own).tolist()},
                    "held_from_h": held_from(science, found, get, blade),
                }
            )
    return out


def readings_out(readings: BladeReadings) -> Json:
    last = None
    if readings.last_id is not None:
        last = {
            "id": readings.last_id,
            "time_h": readings.last_time_h,
            "received_at": moment(readings.last_received_at),
        }
    return {"counting": readings.counting, "overruled": readings.overruled, "last": last}


def draws(store: Store, science: Science, found: Basis, count: int) -> Json:
    """Equally weighted draws of a blade's parameters, in random order.

    By systematic resampling, from a fixed stream: the same version gives the same draws.
    """
    if not 1 <= count <= MOST_DRAWS:
        remedy = f"ask for 1 … {MOST_DRAWS} draws"
        raise RangeError("count", count, "is not a number of draws", remedy)
    assert found.blade is not None
    with store.read() as tx:
        get = tx.states.reader(found.state)
        all_draws = science.blade_draws(found.state.meta, get, found.blade.id)
    w = np.exp(all_draws.log_w - all_draws.log_w.max())
    rng = np.random.default_rng(0)
    places = (np.arange(count) + rng.random()) / count
    index = rng.permutation(np.searchsorted(np.cumsum(w / w.sum()), places))
    values = all_draws.values[np.minimum(index, len(w) - 1)]
    return {
        "names": list(all_draws.names),
        "values": values.tolist(),
        "of": len(w),
        "health": health(found.state),
    }


def field_question(
    card: ModelCard, quantity: str | None, time_h: float | None
) -> tuple[str, float]:
    """The field and the hour asked for; FaultsError: not a field, or outside the horizon."""
    fields = [name for name, output in card.outputs.items() if output.kind != "scalar"]
    if quantity is None and not fields:
        raise NotFoundError("field of model", card.id, "its quantities are scalars")
    name = fields[0] if quantity is None else quantity
    hour = card.horizon_h if time_h is None else time_h
    faults: list[InputError] = []
    if name not in fields:
        remedy = f"use {', '.join(fields) or 'a model with fields'}"
        faults.append(InputError("quantity", name, "is no field of the model", remedy))
    if not 0 <= hour <= card.horizon_h:
        problem = f"lies outside 0 … {card.horizon_h:g} h, which the model covers"
        faults.append(RangeError("time_h", hour, problem, "ask for an hour inside"))
    if faults:
        raise FaultsError(faults)
    return name, hour


def field(store: Store, science: Science, found: Basis, quantity: str, time_h: float) -> Json:
    """Mean and sd of a field at every node, to seven digits."""
    blade, get = found.blade, found.arrays(store)
    assert blade is not None
    bands = science.field(
        found.card,
        found.state.meta,
        get,
        blade.id,
        quantity,
        time_h,
        known=blade.known,
    )
    return {
        "blade": blade.id,
        "quantity": quantity,
        "unit": found.card.outputs[quantity].unit,
        "time_h": time_h,
        "particles": bands.particles,
        "mean": seven_digits(bands.mean),
        "sd": seven_digits(bands.sd),
        "held_from_h": held_from(science, found, get, blade),
        "health": health(found.state),
    }


def seven_digits(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> list[float]:
    """Values as lists, rounded to seven digits of the largest one.

    >>> seven_digits(np.array([1.23456789, 0.0]))
    [1.234568, 0.0]
    """
    largest = float(np.abs(values).max(initial=0.0))
    digits = 6 - int(np.floor(np.log10(largest))) if largest > 0 else 0
    rounded: list[float] = np.round(values, digits).tolist()
    return rounded


def surface(store: Store, science: Science, model_id: str) -> tuple[ModelCard, Surface]:
    """The surface of the newest version of a model; NotFoundError where it has no mesh."""
    with store.read() as tx:
        card = tx.records.model(model_id)
    found = science.surface(card)
    if found is None:
        raise NotFoundError("surface of model", model_id, "the model has no mesh")
    return card, found


def versions(store: Store, rotor_id: str, before: int | None, limit: int) -> list[StateRecord]:
    """Versions of a rotor that are kept, the newest first, below a number."""
    with store.read() as tx:
        tx.records.rotor(rotor_id)
        return tx.states.page(rotor_id, before, limit)


def operations(store: Store, science: Science, limit: int) -> Operations:
    """The service at one moment; at most `limit` of each kind."""
    with store.read() as tx:
        return tx.operations(limit, science.superseded)
