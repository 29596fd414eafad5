"""What the twin's posterior tells: draws, bands, fields, life (of the real one: `service.beliefs`).

A version holds the moments of its posterior (`conjugate`); the rest follows by formulas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.observation import Inspection
from service.fake import draws
from service.fake.conjugate import FakeState
from service.fake.outputs import (
    FakeForward,
    FakeLife,
    FakePrediction,
    FakeRotorLife,
    banded,
    field_of,
    life_of,
    rotor_life_of,
    surface_of,
)
from service.ports import (
    BladeRecord,
    Draws,
    Field,
    Forward,
    Get,
    JointDraws,
    Mesh,
    ModelCard,
    Surface,
)


class FakeBeliefs:
    """The part of the twin that reads posteriors; none of it changes one."""

    __slots__ = ()

    def restore(self, meta: Mapping[str, Any], get: Get) -> FakeState:
        names = [f"column/{blade}" for blade in meta["blades"]] + ["shared/moments"]
        return FakeState(meta, {name: get(name) for name in names})

    def shared_draws(self, meta: Mapping[str, Any], get: Get) -> Draws:
        return draws.shared_draws(meta, get)

    def blade_draws(self, meta: Mapping[str, Any], get: Get, blade: str) -> Draws:
        return draws.blade_draws(meta, get, blade)

    def joint_draws(
        self, meta: Mapping[str, Any], get: Get, blades: Sequence[str], count: int
    ) -> JointDraws:
        return draws.joint_draws(meta, get, blades, count)

    def prior_draws(self, card: ModelCard, like: JointDraws) -> JointDraws:
        from service.predictive import prior_draws

        shared = {name: card.network.parameter(name).prior for name in like.shared_names}
        return prior_draws(card.network, shared, like)

    def replicated(
        self,
        card: ModelCard,
        drawn: JointDraws,
        readings: Sequence[Inspection],
        known: Mapping[str, Mapping[str, float]],
    ) -> list[NDArray[np.float64]]:
        return draws.replicated(card, drawn, readings)

    def forward(
        self, card: ModelCard, quantity: str, blade: str | None, known: Mapping[str, float] | None
    ) -> Forward:
        return FakeForward(card, quantity)

    def mesh(self, card: ModelCard) -> Mesh:
        """The strip's triangles."""
        strip = self.surface(card)
        return Mesh(strip.points, strip.triangles, "triangle")

    def surface(self, card: ModelCard) -> Surface:
        return surface_of(card)

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
        return field_of(card, meta, get, blade, quantity, time_h)

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
    ) -> FakePrediction:
        return banded(card, get, blade, quantity, times, node, probability)

    def held_from(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        known: Mapping[str, float] | None,
    ) -> float | None:
        return None  # a formula has no runs to leave

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
    ) -> FakeLife:
        return life_of(card, get, blade, quantity, limit, times, node, component)

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
    ) -> FakeRotorLife:
        names = [blade.id for blade in blades]
        return rotor_life_of(card, get, names, quantity, limit, times, node, component, ages or {})
