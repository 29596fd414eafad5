"""The calibration and its model, as the use cases see them."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from core.network import Network
from core.observation import Inspection
from service.ports.records import BladeRecord, PlanTarget
from service.ports.values import (
    Draws,
    Field,
    Forward,
    Get,
    JointDraws,
    Json,
    Life,
    Mesh,
    ModelCard,
    Prediction,
    Progress,
    RotorSpec,
    RotorState,
    Surface,
)


class Science(Protocol):
    """The calibration: pure functions of readings, rotor and earlier state."""

    @property
    def builtins(self) -> tuple[str, ...]:
        """Names of the models that come with it; the first is registered without being asked."""
        ...

    def builtin(self, name: str) -> ModelCard: ...
    def train(
        self,
        name: str,
        network: Network,
        runs: bytes,
        leave_out: Sequence[str],
        facts: Json,
        progress: Progress,
    ) -> tuple[ModelCard, bytes]:
        """A model of a user's runs (a file of `core.archive.source`): its card and its artefact.

        facts      are kept in the card's summary
        progress   as of `diagnose`

        Raises FaultsError with everything that is wrong with the runs.
        """
        ...

    def opened(self, name: str, artefact: bytes) -> ModelCard:
        """The card of an artefact that `train`, or `bladetwin model train`, made.

        Raises ModelError for one that is damaged.
        """
        ...

    def vary(self, card: ModelCard, asked: Json | None) -> ModelCard:
        """A registered model under a rotor's own network (`service.variant`), with its own digest.

        None asks for nothing: the card itself.

        Raises FaultsError or InputError for what cannot be asked of it.
        """
        ...

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: RotorState | None,
        *,
        quick: bool,
    ) -> RotorState: ...
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
        """By how much inspections would narrow the target (`core.planning.worth`).

        blades     that run; readings: those that count
        Returns `unit`, `mean` and `sd` of the target, `single` readings and the best `set`, each
        with `sd_after` and `narrower`. Raises InputError where there is nothing to inspect.
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
        so that later ones have too little of an effect; None: at none of the model's hours."""
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

    def warm(self, card: ModelCard) -> None: ...
    def check_families(self, card: ModelCard, families: Sequence[Json]) -> None:
        """Refuse families of effects (`core.diagnosis.Family`) that the model cannot be asked for.

        Raises InputError.
        """
        ...

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
        """What the model lacks, by the readings that count (`core.diagnosis`), as plain JSON.

        families    beside the built-in ones, checked by `check_families`
        compare_h   hour of the forecast before and after [h]; None: no comparison
        progress    called with (what, done, total) before each step; what it raises ends the work
        kept        what an earlier attempt had found out, as JSON; what is found out now joins it.
                    The answer is the same with and without

        Raises InputError where there is nothing to diagnose.
        """
        ...

    def residuals(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        progress: Progress,
    ) -> Json:
        """Every reading predicted before it is used, and tests (`service.residuals.told`).

        progress    as of `diagnose`

        Raises InputError where no reading counts.
        """
        ...
