"""What a stored posterior tells, as the use cases see it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from core.observation import Inspection
from service.ports.records import BladeRecord
from service.ports.values import (
    Draws,
    Field,
    Forward,
    Get,
    JointDraws,
    Life,
    Mesh,
    ModelCard,
    Prediction,
    RotorLife,
    RotorState,
    Surface,
)


class Beliefs(Protocol):
    """The part of the science that reads posteriors; none of it changes one.

    A version is given by its `meta` and `get`, which gives its arrays by name.
    """

    def restore(self, meta: Mapping[str, Any], get: Get) -> RotorState: ...
    def shared_draws(self, meta: Mapping[str, Any], get: Get) -> Draws: ...
    def blade_draws(self, meta: Mapping[str, Any], get: Get, blade: str) -> Draws: ...
    def joint_draws(
        self, meta: Mapping[str, Any], get: Get, blades: Sequence[str], count: int
    ) -> JointDraws:
        """Draws of several blades with the same shared values in each, in random order."""
        ...

    def prior_draws(self, card: ModelCard, like: JointDraws) -> JointDraws:
        """As many draws of the same parameters and blades, from their priors."""
        ...

    def replicated(
        self,
        card: ModelCard,
        drawn: JointDraws,
        readings: Sequence[Inspection],
        known: Mapping[str, Mapping[str, float]],
    ) -> list[NDArray[np.float64]]:
        """What each reading would be again under each draw, with its errors: (n, k) of k values.

        known   inputs of blades that are given, by blade
        """
        ...

    def forward(
        self, card: ModelCard, quantity: str, blade: str | None, known: Mapping[str, float] | None
    ) -> Forward:
        """The model as it is, or as one blade has it, with its effects and known inputs."""
        ...

    def predict(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        quantity: str,
        times: Sequence[float],
        node: int | None,
        probability: float,
        *,
        instrument: str | None,
        known: Mapping[str, float] | None,
    ) -> Prediction: ...

    def life(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        quantity: str,
        limit: float,
        times: Sequence[float],
        node: int | None,
        *,
        component: int | None,
        known: Mapping[str, float] | None,
    ) -> Life:
        """When the blade passes a limit; component: 0, 1, 2 of a vector."""
        ...

    def rotor_life(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blades: Sequence[BladeRecord],
        quantity: str,
        limit: float,
        times: Sequence[float],
        node: int | None,
        *,
        component: int | None,
        ages: Mapping[str, float] | None = None,
    ) -> RotorLife:
        """Which of these blades pass a limit by when, and how surely any does.

        ages   hours of each blade at hour 0 of `times`; none: times are of each blade's own
        """
        ...

    def held_from(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        known: Mapping[str, float] | None,
    ) -> float | None:
        """The blade's hour [h] from which one of its inputs is held at the end of the model's runs,
        or an effect that grows has no course, so that later ones have too little of an effect;
        None: at none of the model's hours."""
        ...

    def surface(self, card: ModelCard) -> Surface | None:
        """The surface of the model's mesh; None: it has none that is known."""
        ...

    def mesh(self, card: ModelCard) -> Mesh | None:
        """The mesh of a model's fields; None where it has none."""
        ...

    def field(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        quantity: str,
        time_h: float,
        *,
        known: Mapping[str, float] | None,
    ) -> Field:
        """Mean and sd of a field or vector of the blade itself at every node, without noise."""
        ...
