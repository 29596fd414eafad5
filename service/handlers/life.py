"""When a blade, or a rotor's blades, pass a limit, with everything that it rests on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.ages import Age, ages
from core.errors import InputError, RangeError
from service.errors import FaultsError
from service.handlers.plans import counting
from service.handlers.questions import Question, question
from service.handlers.reads import Basis, health, held_from
from service.handlers.rows import everyone_running
from service.ports import BladeRecord, Json, ModelCard, Science, Store

AXES = ("x", "y", "z")
RADIUS = "z"
MOST_CHANCES = 20_000  # of a rotor: blades times hours


def along_question(
    card: ModelCard,
    quantity: str | None,
    times: Sequence[float] | None,
    node: str | None,
    component: str | None,
    probability: float = 0.95,
) -> tuple[Question, int | None]:
    """What is asked for, and the component of a vector (default: z).

    FaultsError names each fault.
    """
    faults: list[InputError] = []
    name = card.network.quantities[0].name if quantity is None else quantity
    output = card.outputs.get(name)
    vector = output is not None and output.kind == "vector"
    if component is not None and output is not None and not vector:
        faults.append(InputError("component", component, f"{name} has none", "leave it out"))
    try:
        asked = question(card, quantity, times, node, probability)
    except FaultsError as error:
        raise FaultsError([*error.faults, *faults]) from None
    if faults:
        raise FaultsError(faults)
    return asked, AXES.index(component or RADIUS) if vector else None


def life(
    store: Store,
    science: Science,
    found: Basis,
    asked: Question,
    component: int | None,
    limit: float,
) -> Json:
    """The distribution of the time to the limit, as plain lists."""
    blade, get = found.blade, found.arrays(store)
    assert blade is not None
    told = science.life(
        found.card,
        found.state.meta,
        get,
        blade.id,
        asked.quantity,
        limit,
        asked.times,
        asked.node,
        component=component,
        known=blade.known,
    )
    return {
        "blade": blade.id,
        **_asked(found, asked, component, limit),
        "time_h": np.asarray(told.time_h).tolist(),
        "passed": np.asarray(told.passed).tolist(),
        "quantiles": {str(p): hour for p, hour in told.quantiles.items()},
        "held_from_h": held_from(science, found, get, blade),
        "health": health(found.state),
    }


def rotor_life(
    store: Store,
    science: Science,
    found: Basis,
    asked: Question,
    component: int | None,
    limit: float,
    ahead: bool = False,
) -> Json:
    """The chances that the blades that run have passed the limit, alone and together.

    ahead   the hours that are asked for count from now on, for each blade from its own age; else
            they are of each blade's own operation

    Raises RangeError for more hours than one answer should hold (the model's own may be asked of
    any number of blades), and where a blade would be older than its model.
    """
    blades = everyone_running(store, found)
    most = max(MOST_CHANCES // max(len(blades), 1), len(found.card.time_h))
    if len(asked.times) > most:
        problem = f"hours of {len(blades)} blades are more than one answer holds"
        raise RangeError("times", len(asked.times), problem, f"ask for 1 … {most} times at once")
    old = aged(store, found, blades, max(asked.times)) if ahead else {}
    get = found.arrays(store)
    told = science.rotor_life(
        found.card,
        found.state.meta,
        get,
        blades,
        asked.quantity,
        limit,
        asked.times,
        asked.node,
        component=component,
        ages={blade: age.hours for blade, age in old.items()},
    )
    return {
        **_asked(found, asked, component, limit),
        "ahead": ahead,
        **{
            name: np.asarray(getattr(told, name)).tolist() for name in ("time_h", "any", "expected")
        },
        "blades": [
            {
                "id": blade.id,
                "age_h": old[blade.id].hours if ahead else None,
                "age_by": old[blade.id].by if ahead else None,
                "passed": np.asarray(told.passed[blade.id]).tolist(),
                "held_from_h": held_from(science, found, get, blade),
            }
            for blade in blades
        ],
        "health": health(found.state),
    }


def aged(
    store: Store, found: Basis, blades: Sequence[BladeRecord], longest: float
) -> dict[str, Age]:
    """How old the blades are as of a version, and what tells it (`core.ages`).

    Raises RangeError where one would be beyond its model in `longest` hours.
    """
    with store.read() as tx:
        readings = counting(tx, found.state.rotor_id, found.state.through_seq)
    old = ages([blade.id for blade in blades], readings)
    last = found.card.horizon_h
    oldest = max(old, key=lambda blade: old[blade].hours, default=None)
    if oldest is not None and (age := old[oldest].hours) + longest > last:
        problem = f"is hour {age + longest:g} of blade {oldest}; the model ends at {last:g} h"
        left = last - age
        remedy = f"ask for {left:g} h ahead at most" if left >= 0 else "ask for times instead"
        raise RangeError("ahead", longest, problem, remedy)
    return old


def _asked(found: Basis, asked: Question, component: int | None, limit: float) -> Json:
    return {
        "quantity": asked.quantity,
        "unit": found.card.outputs[asked.quantity].unit,
        "node": asked.node,
        "component": None if component is None else AXES[component],
        "limit": limit,
    }
