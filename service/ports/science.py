"""The calibration and its model, as the use cases see them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping, Sequence
from typing import Any, Protocol

from core.network import Network
from core.observation import Inspection
from service.ports.beliefs import Beliefs
from service.ports.records import BladeRecord, PlanTarget
from service.ports.values import (
    Get,
    Json,
    ModelCard,
    Progress,
    RotorSpec,
    RotorState,
)


class Science(Beliefs, Protocol):
    """The calibration: pure functions of readings, rotor and earlier state; what is told of it."""

    @property
    def builtins(self) -> tuple[str, ...]:
        """Names of the models that come with it; the first is registered without being asked."""
        ...

    @property
    def superseded(self) -> tuple[str, ...]:
        """State algorithms before that of `update`: what rests on one is to be computed anew."""
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
        heed: Callable[[], None],
    ) -> Json:
        """What the model lacks, by the readings that count (`core.diagnosis`), as plain JSON.

        families    beside the built-in ones, checked by `check_families`
        compare_h   hour of the forecast before and after [h]; None: no comparison
        progress    called with (what, done, total) before each step; what it raises ends the work
        kept        what an earlier attempt had found out, as JSON; what is found out now joins it.
                    The answer is the same with and without
        heed        called every few seconds of a step; what it raises ends the work, too

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
