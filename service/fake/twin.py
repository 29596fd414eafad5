"""The twin behind the `Science` port, with delays and provisional states as tests ask for them."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as default
from typing import Any

import numpy as np

from core.errors import InputError
from core.network import Network
from core.observation import Inspection
from service.fake import questions
from service.fake.beliefs import FakeBeliefs
from service.fake.conjugate import HORIZON_H, FakeState, fake_network, fitted
from service.ports import (
    BladeRecord,
    Get,
    Json,
    ModelCard,
    Output,
    PlanTarget,
    Progress,
    RotorSpec,
)


@dataclass(frozen=True, slots=True)
class FakeScience(FakeBeliefs):
    """The twin. `delay_s` makes an update slow; `provisional` makes quick updates unsealed."""

    node_count: int = 6448
    delay_s: float = 0.0
    provisional: bool = False
    network: Network = default(default_factory=fake_network)
    builtins: tuple[str, ...] = ("rotor-blade",)
    superseded: tuple[str, ...] = ()

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
        heed: Callable[[], None],
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
