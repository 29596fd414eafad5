"""What is served of a blade of a rotor, two models for each quantity.

``elongation``            (psi) → mean, sd: the model at given parameters, as this blade has it (its
                          known inputs, the effects that the rotor has adopted), without
                          discrepancy and noise; sd is the surrogate's own, without what the
                          simulation errs by (`core.quantity`: numerical). Names, units and bounds
                          of psi stand in ModelFacts. config: times, node
``elongation.posterior``  (hours) → mean, sd of the blade, sd of a reading, lower, upper: what
                          ``GET …/prediction`` says of the version that ModelFacts names, with
                          the hour from which it has too little of an effect (held_from_h).
                          config: count (of hours, 1), node, probability, instrument

Of a vector each output holds x, y, z of the first hour, then of the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.errors import InputError, RangeError
from service.handlers.questions import MOST_TIMES, Question, question
from service.handlers.reads import Basis, health, held_from, predict
from service.ports import Forward, Science, Store
from service.umbridge.protocol import Json, Served, Vectors, number

NODE = "node"


def served(store: Store, science: Science, found: Basis) -> dict[str, Served]:
    """Every model of the basis' blade, by name."""
    assert found.blade is not None
    models: dict[str, Served] = {}
    for name in found.card.outputs:
        forward = science.forward(found.card, name, found.blade.id, found.blade.known)
        models[name] = AtParameters(found, name, forward)
        models[f"{name}.posterior"] = Predicted(store, science, found, name)
    return models


def taken(config: Json, *known: str) -> Json:
    """The config; InputError for a field that is not known."""
    if unknown := sorted(config.keys() - set(known)):
        raise InputError(
            f"config.{unknown[0]}", config[unknown[0]], "is not known", f"use {', '.join(known)}"
        )
    return config


def node_of(config: Json) -> str | None:
    node = config.get(NODE)
    return None if node is None else str(node)


def flat(values: Any) -> list[float]:
    out: list[float] = np.asarray(values, dtype=np.float64).reshape(-1).tolist()
    return out


@dataclass(frozen=True, slots=True)
class AtParameters:
    """A quantity as a function of the parameters."""

    found: Basis
    quantity: str
    forward: Forward

    def info(self) -> Json:
        forward = self.forward
        bounds = zip(forward.names, forward.units, forward.low, forward.high, strict=True)
        return {
            "parameters": [{"name": n, "unit": u, "low": a, "high": b} for n, u, a, b in bounds],
            "outputs": ["mean", "sd"],
            "unit": self.found.card.outputs[self.quantity].unit,
            "rests_on": self.found.to_json(),
        }

    def input_sizes(self, config: Json) -> list[int]:
        self._asked(config)
        return [len(self.forward.names)]

    def output_sizes(self, config: Json) -> list[int]:
        return 2 * [len(self._asked(config).times) * width(self.found, self.quantity)]

    def evaluate(self, inputs: Vectors, config: Json) -> Vectors:
        asked = self._asked(config)
        mean, sd = self.forward(inputs[0], asked.times, asked.node)
        return [flat(mean), flat(sd)]

    def _asked(self, config: Json) -> Question:
        times = taken(config, "times", NODE).get("times")
        if times is not None and not _numbers(times):
            raise InputError(
                "config.times", times, "is no list of hours", "give e.g. [8000, 24000]"
            )
        return question(self.found.card, self.quantity, times, node_of(config), 0.95)


def _numbers(values: Any) -> bool:
    return isinstance(values, list) and all(number(value) is not None for value in values)


def width(found: Basis, quantity: str) -> int:
    return 3 if found.card.outputs[quantity].kind == "vector" else 1


@dataclass(frozen=True, slots=True)
class Predicted:
    """A quantity as the posterior predicts it."""

    store: Store
    science: Science
    found: Basis
    quantity: str

    def info(self) -> Json:
        return {
            "inputs": [
                {"name": "time_h", "unit": "h", "low": 0.0, "high": self.found.card.horizon_h}
            ],
            "outputs": ["mean", "sd_blade", "sd_total", "lower", "upper"],
            "unit": self.found.card.outputs[self.quantity].unit,
            "held_from_h": self._held_from(),
            "health": health(self.found.state),
            "rests_on": self.found.to_json(),
        }

    def _held_from(self) -> float | None:
        blade = self.found.blade
        assert blade is not None
        return held_from(self.science, self.found, self.found.arrays(self.store), blade)

    def input_sizes(self, config: Json) -> list[int]:
        return [self._count(config)]

    def output_sizes(self, config: Json) -> list[int]:
        return 5 * [self._count(config) * width(self.found, self.quantity)]

    def evaluate(self, inputs: Vectors, config: Json) -> Vectors:
        told = predict(self.store, self.science, self.found, self._asked(inputs[0], config))
        sd = {name: np.asarray(part) for name, part in told["sd"].items()}
        own = np.sqrt(sum(sd[name] ** 2 for name in ("parameters", "surrogate", "discrepancy")))
        parts = (told["mean"], own, sd["total"], told["lower"], told["upper"])
        return [flat(part) for part in parts]

    def _count(self, config: Json) -> int:
        count = taken(config, "count", NODE, "probability", "instrument").get("count", 1)
        if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_TIMES:
            remedy = f"give 1 … {MOST_TIMES}"
            raise RangeError("config.count", count, "is not a number of hours", remedy)
        self._asked([0.0], config)
        return count

    def _asked(self, times: Sequence[float], config: Json) -> Question:
        probability = config.get("probability", 0.95)
        if (level := number(probability)) is None:
            raise InputError("config.probability", probability, "is no number", "give 0.95, say")
        instrument = config.get("instrument")
        if instrument is not None and not isinstance(instrument, str):
            raise InputError("config.instrument", instrument, "is no name", "give one, or none")
        return question(
            self.found.card,
            self.quantity,
            times,
            node_of(config),
            level,
            instrument,
        )
