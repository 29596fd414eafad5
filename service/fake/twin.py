"""The twin behind the `Science` port, with delays and provisional states as tests ask for them."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as default
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.network import Network
from core.observation import Inspection
from service.fake import draws, questions
from service.fake.conjugate import HORIZON_H, FakeState, fake_network, fitted
from service.fake.outputs import (
    FakeForward,
    FakeLife,
    FakePrediction,
    banded,
    field_of,
    life_of,
    surface_of,
)
from service.ports import (
    BladeRecord,
    Draws,
    Field,
    Forward,
    Get,
    JointDraws,
    Json,
    Mesh,
    ModelCard,
    Output,
    PlanTarget,
    Progress,
    RotorSpec,
    Surface,
)


@dataclass(frozen=True, slots=True)
class FakeScience:
    """The twin. `delay_s` makes an update slow; `provisional` makes quick updates unsealed."""

    node_count: int = 6448
    delay_s: float = 0.0
    provisional: bool = False
    network: Network = default(default_factory=fake_network)
    builtins: tuple[str, ...] = ("rotor-blade",)

    def builtin(self, name: str) -> ModelCard:
        if name not in self.builtins:
            raise InputError("builtin", name, "is no built-in model", f"use {self.builtins[0]}")
        digest = hashlib.sha256(json.dumps(self.network.to_json()).encode()).hexdigest()
        return ModelCard(
            id=name,
            version=f"fake-{digest[:8]}",
            digest=digest,
            network=self.network,
            horizon_h=HORIZON_H,
            node_count=self.node_count,
            nodes={"tip": self.node_count - 1, "critical": 3},
            time_h=tuple(np.linspace(0.0, HORIZON_H, 6).tolist()),
            outputs={q.name: Output(q.unit, q.kind) for q in self.network.quantities},
            summary={"what": "conjugate Gaussian twin"},
        )

    def train(
        self,
        name: str,
        network: Network,
        runs: bytes,
        leave_out: Sequence[str],
        facts: Json,
        progress: Progress,
    ) -> tuple[ModelCard, bytes]:
        """Nothing is learnt here: the card is the twin's own, under another name."""
        for done in range(3):
            progress("pretending to train", done, 3)
            time.sleep(self.delay_s)
        artefact = hashlib.sha256(runs).digest()
        return self.opened(name, artefact), artefact

    def opened(self, name: str, artefact: bytes) -> ModelCard:
        card = self.builtin(self.builtins[0])
        told = {"artefact": hashlib.sha256(artefact).hexdigest(), "kind": "a twin's"}
        return replace(card, id=name, version=f"fake-{artefact[:4].hex()}", summary=told)

    def vary(self, card: ModelCard, asked: Json | None) -> ModelCard:
        if asked is None:
            return card
        raise InputError(
            "network", sorted(asked), "is not varied by the twin", "set BLADETWIN_SCIENCE=core"
        )

    def warm(self, card: ModelCard) -> None:
        """Nothing is compiled here."""

    def check_families(self, card: ModelCard, families: Sequence[Json]) -> None:
        from service.effects import read_families

        names = [parameter.name for parameter in card.network.parameters]
        read_families(families, names, list(card.outputs))

    def diagnose(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        families: Sequence[Json],
        compare_h: float | None,
        progress: Progress,
        kept: MutableMapping[str, Any],
    ) -> Json:
        return questions.diagnosed(card, rotor, readings, progress, self.delay_s, kept)

    def plan(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blades: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        target: PlanTarget,
        count: int,
    ) -> Json:
        return questions.planned(get, blades, readings, target)

    def residuals(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        progress: Progress,
    ) -> Json:
        def update(before: Sequence[Inspection]) -> FakeState:
            return self.update(card, rotor, before, None, quick=False)

        return questions.residuals_of(update, rotor, facts, readings, progress)

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: Any,
        *,
        quick: bool,
    ) -> FakeState:
        time.sleep(self.delay_s)
        sealed = not (quick and self.provisional)
        return fitted(card, rotor, readings, sealed=sealed, previous=previous)

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
