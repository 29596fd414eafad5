"""The calibration behind the `Science` port: core.model, core.calibration, core.prediction.

Which models it has: `service.models`. What a stored posterior tells: `service.beliefs`.

Imported only where it is wired; the compiled kernels of the calibration are imported when a
worker warms up, so that a process that only serves never loads them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Any

from core.calibration.state import SUPERSEDED, RotorState
from core.calibration.state import RotorSpec as Calibrated
from core.model import Model
from core.network import Network
from core.observation import Inspection
from service import kernels
from service.beliefs import Beliefs
from service.made_up import made_up_rotor
from service.models import Models
from service.packed import pack, write_network
from service.ports import (
    BladeRecord,
    Get,
    Json,
    ModelCard,
    PlanTarget,
    Progress,
    RotorSpec,
)


class CoreScience(Beliefs):
    """The science of this release, on the models that come with it.

    folder   holds a rebuilt rotor-blade model, used instead of the shipped one
    model    any network and surrogate, e.g. a formula (core.surrogate.formula), used instead of
             rotor-blade and alone
    files    gives a stored file by its SHA-256: artefacts that were trained on users' runs
    kept     update with kept machine code only: CompiledError where kernels were compiled here
             (`service.kernels`); for processes that can run again
    """

    def __init__(
        self,
        folder: str = "",
        model: Model | None = None,
        files: Callable[[str], bytes] | None = None,
        *,
        kept: bool = False,
    ) -> None:
        super().__init__(Models(folder, model, files))
        self.builtins = self.models.builtins
        self.superseded = SUPERSEDED
        self._kept = kept
        self._workspace: Any = None

    def vary(self, card: ModelCard, asked: Json | None) -> ModelCard:
        return self.models.vary(card, asked)

    def builtin(self, name: str) -> ModelCard:
        return self.models.builtin(name)

    def train(
        self,
        name: str,
        network: Network,
        runs: bytes,
        leave_out: Sequence[str],
        facts: Json,
        progress: Progress,
    ) -> tuple[ModelCard, bytes]:
        from core.archive.opening import opened
        from core.archive.trial import tried
        from core.surrogate.own import make

        with tempfile.TemporaryDirectory(prefix="bladetwin-runs-") as folder:
            file, made = Path(folder) / "runs.nc", Path(folder) / "model"
            file.write_bytes(runs)
            tried(file)
            with opened(file) as source:
                make(source, network, made, leave_out=leave_out, progress=progress, facts=facts)
            write_network(made, network)
            artefact = pack(made)
        return self.opened(name, artefact), artefact

    def opened(self, name: str, artefact: bytes) -> ModelCard:
        return self.models.opened(name, artefact)

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: Any,
        *,
        quick: bool,
    ) -> RotorState:
        from core.calibration import online

        if self._workspace is None:
            self._workspace = online.Workspace()
        spec = _spec(rotor)
        state = online.update(
            self.models.of(card), spec, readings, previous, quick=quick, workspace=self._workspace
        )
        if self._kept:
            kernels.insist()
        return state

    def warm(self, card: ModelCard) -> None:
        """One update of a made-up rotor compiles what an update needs."""
        rotor = made_up_rotor(self.models.of(card), card.horizon_h)
        if rotor is not None:
            spec, first, later = rotor
            self.meet(card, spec, [first])
            state = self.update(card, spec, [first], None, quick=False)
            self.update(card, spec, [first, later], state, quick=True)

    def meet(self, card: ModelCard, rotor: RotorSpec, readings: Sequence[Inspection]) -> None:
        """What many blades alike would need, of which the made-up rotor has one."""
        from core.calibration import alike, online

        spec = _spec(rotor)
        alike.meet(online.begun(self.models.of(card), spec, readings).messages.values())

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
        from service.worth import planned

        state = self.restore(meta, get)
        return planned(self.models.of(card), state, blades, readings, target, count)

    def check_families(self, card: ModelCard, families: Sequence[Json]) -> None:
        from service.effects import families_of

        families_of(self.models.of(card), families)

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
        from service.effects import diagnosed

        model, spec = self.models.of(card), _spec(rotor)
        asked = (facts, readings, families, compare_h)
        return diagnosed(model, spec, *asked, progress, kept, heed)

    def residuals(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        progress: Progress,
    ) -> Json:
        from service.residuals import computed

        spec = _spec(rotor)
        return computed(self.models.of(card), spec, facts, readings, progress)


def _spec(rotor: RotorSpec) -> Calibrated:
    """The rotor as the science names it."""
    return Calibrated(rotor.id, rotor.blades, rotor.particles, rotor.seed, rotor.known)
