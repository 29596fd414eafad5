"""What a model has to compile for candidates, compiled for all of their hours at once.

Blades that share their effects share what answers for them, and blades of several ages are asked
about at as many hours, and for several quantities. One by one each would be compiled from the start
of time on (`core.surrogate.kept`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from core.model import Model
from core.response import Response
from core.surrogate.driven import Driven
from core.surrogate.kept import Wanted

Array = NDArray[np.float64]


def ready(
    model: Model,
    count: int,
    asked: Iterable[tuple[str, str, float]],
    shapes: Iterable[tuple[str, Sequence[tuple[str, float]], Array]] = (),
) -> None:
    """Of (blade, quantity, hour), where `count` particles of each blade are going to ask; of shapes
    a quantity's modes, blades with an hour each, and the mixing."""
    hours: dict[tuple[int, Wanted], set[float]] = {}
    parts: dict[int, Driven] = {}

    def needs(blade: str, wanted: Wanted, hour: float) -> None:
        part = model.for_blade(blade).part(wanted.quantity)
        if isinstance(part, Driven):
            parts[id(part)] = part
            hours.setdefault((id(part), wanted), set()).add(hour)

    for blade, quantity, hour in asked:
        declared, part = model.network.quantity(quantity), model.part(quantity)
        nodes = None if declared.kind == "scalar" else [declared.node_among(part.named)]
        needs(blade, Wanted.of(quantity, nodes), hour)
    for quantity, blades, mixing in shapes:
        wanted = Wanted.of(quantity, mixing=mixing)
        for blade, hour in blades:
            needs(blade, wanted, hour)
    for which, part in parts.items():
        part.ready(count, {wanted: own for (of, wanted), own in hours.items() if of == which})


def modes(
    model: Model, quantity: str, blades: Sequence[tuple[str, float]], mixing: Array
) -> dict[tuple[int, float], Response]:
    """Mixtures of a quantity's modes, of blades with an hour each; by model and hour.

    Models of blades are kept by their model, and told apart by their identity.
    """
    hours: dict[int, set[float]] = {}
    models = {}
    for blade, hour in blades:
        own = model.for_blade(blade)
        models[id(own)] = own
        hours.setdefault(id(own), set()).add(hour)
    found: dict[tuple[int, float], Response] = {}
    for which, of_it in hours.items():
        part, times = models[which].part(quantity), sorted(of_it)
        if isinstance(part, Driven):
            made = part.mode_responses(times, mixing)
        else:
            made = [part.mode_response(t, mixing) for t in times]
        found |= {(which, t): one for t, one in zip(times, made, strict=True)}
    return found
