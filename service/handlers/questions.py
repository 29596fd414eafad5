"""Questions to a model: a quantity over hours, at a node, checked before anything is computed.

The quantity has to be one that the model predicts, the hours [h] lie within 0 … `horizon_h`, a
node be one of the model's mesh by number or name (a scalar has none), the probability of a band lie
between 0 and 1, and the instrument be one of the quantity's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from core.errors import InputError, RangeError
from service.errors import FaultsError
from service.ports import ModelCard

MOST_TIMES = 2000


@dataclass(frozen=True, slots=True)
class Question:
    """What a prediction is asked for, checked against the model."""

    quantity: str
    times: tuple[float, ...]
    node: int | None
    probability: float
    instrument: str | None


def question(
    card: ModelCard,
    quantity: str | None,
    times: Sequence[float] | None,
    node: str | None,
    probability: float,
    instrument: str | None = None,
) -> Question:
    """Check a question; FaultsError names each parameter, its value and the remedy.

    quantity   None: the model's first one
    """
    faults: list[InputError] = []
    quantity = card.network.quantities[0].name if quantity is None else quantity
    output = card.outputs.get(quantity)
    if output is None:
        known = ", ".join(sorted(card.outputs))
        raise FaultsError(
            [InputError("quantity", quantity, "is not predicted by the model", f"use {known}")]
        )
    asked = card.time_h if times is None else tuple(times)
    if not 1 <= len(asked) <= MOST_TIMES:
        remedy = f"ask for 1 … {MOST_TIMES} times at once"
        faults.append(RangeError("times", len(asked), "is not a number of times", remedy))
    outside = [t for t in asked if not (math.isfinite(t) and 0 <= t <= card.horizon_h)]
    if outside:
        problem = f"lies outside 0 … {card.horizon_h:g} h, which the model covers"
        faults.append(RangeError("times", outside[0], problem, "ask for hours inside"))
    if not 0 < probability < 1:
        remedy = "give a fraction between 0 and 1, e.g. 0.95"
        faults.append(RangeError("probability", probability, "is no probability", remedy))
    number = None
    try:
        number = _node(card, quantity, node)
    except InputError as error:
        faults.append(error)
    try:
        card.network.quantity(quantity).check_instrument(instrument)
    except InputError as error:
        faults.append(error)
    if faults:
        raise FaultsError(faults)
    return Question(quantity, asked, number, probability, instrument)


def _node(card: ModelCard, quantity: str, node: str | None) -> int | None:
    if card.outputs[quantity].kind == "scalar":
        if node is not None:
            raise InputError("node", node, "belongs to no scalar quantity", "leave it out")
        return None
    if node is None:
        return card.network.quantity(quantity).node_among(card.nodes)
    named = ", ".join(sorted(card.nodes))
    remedy = f"use 0 … {card.node_count - 1}" + (f", or one of {named}" if named else "")
    if node in card.nodes:
        return card.nodes[node]
    digits = node.isascii() and node.isdigit() and len(node) <= 9
    if not digits or int(node) >= card.node_count:
        raise RangeError("node", node, "does not exist in the model's mesh", remedy)
    return int(node)
