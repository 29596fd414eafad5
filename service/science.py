"""The calibration behind the `Science` port: core.model, core.calibration, core.prediction.

Three models come with it: blades on their shipped surrogate; the same blades on one of wider runs,
in which effects that the first lacks find room; and creep specimens in closed form. Others are
trained on users' own runs and lie as files in the store (`service.packed`).

Imported only where it is wired; the compiled kernels of the calibration are imported when a
worker warms up, so that a process that only serves never loads them.
"""

from __future__ import annotations

import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

import core.builtin
from core.builtin import creep_specimens
from core.calibration.state import Arrays, Posterior, RotorState, blade_posterior, shared_posterior
from core.discrepancy import parameters
from core.errors import InputError, ModelError
from core.model import Model, rotor_blade_wide
from core.network import Network, rotor_blade_network
from core.observation import Inspection
from core.prediction import predict
from core.surrogate.artefact import load
from service import kernels
from service.packed import pack, unpack, write_network
from service.ports import (
    Array,
    BladeRecord,
    Draws,
    Field,
    Forward,
    Get,
    JointDraws,
    Json,
    Mesh,
    ModelCard,
    NoiseFrom,
    Output,
    PlanTarget,
    Progress,
    RotorSpec,
    Surface,
)
from service.variant import named, vary

SHIPPED = Path(core.builtin.__file__).with_name("rotor_blade_model")
NAME = "rotor-blade"
WIDE = f"{NAME}-wide"
SPECIMENS = creep_specimens.NAME
INSTANTS = 51
MOST_VARIED = 64  # varied models kept with the rows compiled for them
MOST_OWN = 8  # models of users' runs that are kept loaded


@dataclass(frozen=True, slots=True)
class Bands:
    """A prediction; for a 3-D deformation the arrays are (T, 3)."""

    time_h: Array
    mean: Array
    sd: Mapping[str, Array]
    lower: Array
    upper: Array
    quantiles: Mapping[float, Array]
    instrument: str | None
    noise_from: NoiseFrom


class CoreScience:
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
        self._files = files
        self._kept = kept
        self._own: OrderedDict[str, Model] = OrderedDict()
        self._folder = Path(folder) if folder else SHIPPED
        self._models: dict[str, Model] = {} if model is None else {NAME: model}
        self.builtins = (NAME, WIDE, SPECIMENS) if model is None else (NAME,)
        self._lock = threading.Lock()
        self._varied: OrderedDict[str, Model] = OrderedDict()
        self._workspace: Any = None

    def _loaded(self, name: str) -> Model:
        """A built-in model, made when first asked for; the lock is held."""
        if name not in self.builtins:
            raise ModelError(
                f"model {name} is registered, but is none of this release's: "
                f"{', '.join(self.builtins)}. Run the release that registered it."
            )
        if name not in self._models:
            self._models[name] = self._make(name)
        return self._models[name]

    def _make(self, name: str) -> Model:
        if name == SPECIMENS:
            return Model(creep_specimens.network(), creep_specimens.formula())
        if name == WIDE:
            return rotor_blade_wide()
        return Model(rotor_blade_network(), load(self._folder))

    def _trained(self, card: ModelCard) -> Model:
        """A model of a user's runs, by the file that its card names; the lock is held."""
        name = str(card.summary["artefact"])
        if name not in self._own:
            if self._files is None:
                raise ModelError(f"model {card.id} lies in a database, and none is open here")
            self._own[name] = unpack(self._files(name))
            while len(self._own) > MOST_OWN:
                self._own.popitem(last=False)
        self._own.move_to_end(name)
        return self._own[name]

    def _model(self, card: ModelCard) -> Model:
        """The loaded model, or its surrogate under the varied network of the card."""
        with self._lock:
            own = card.id not in self.builtins and "artefact" in card.summary
            model = self._trained(card) if own else self._loaded(card.id)
            if card.version != model.version:
                raise ModelError(
                    f"model {card.id} {card.version} is registered, but this release has "
                    f"{model.version}. Run the release that registered it, or set "
                    "BLADETWIN_MODEL_DIR to the folder of that model."
                )
            if card.digest == model.digest:
                return model
            if card.digest not in self._varied:
                self._varied[card.digest] = Model.of(card.network, model.surrogate)
                while len(self._varied) > MOST_VARIED:
                    self._varied.popitem(last=False)
            self._varied.move_to_end(card.digest)
            return self._varied[card.digest]

    def vary(self, card: ModelCard, asked: Json | None) -> ModelCard:
        if asked is None:
            return card
        model = self._model(card)
        network = vary(card.network, card.horizon_h, asked)
        varied = Model.of(network, model.surrogate)
        for quantity in network.quantities:
            with named(f"network.quantities.{quantity.name}.discrepancy"):
                parameters(varied, quantity)
        return replace(card, network=network, digest=varied.digest)

    def builtin(self, name: str) -> ModelCard:
        if name not in self.builtins:
            remedy = f"use {' or '.join(self.builtins)}"
            raise InputError("builtin", name, "is no built-in model", remedy)
        with self._lock:
            model = self._loaded(name)
        return self._card(name, model)

    def _card(self, name: str, model: Model, more: Json | None = None) -> ModelCard:
        """What is told of a model under a name; `more` goes into its summary."""
        surrogate: Any = model.surrogate
        told: Json = {}
        if (anchor := getattr(surrogate, "anchor", None)) is not None:
            told["anchor"] = {
                "digest": anchor.fine.digest,
                "errors": anchor.fine.manifest.get("errors", {}),
                "means": "without an effect the answers and errors are those of this surrogate; "
                "the other errors are those of the wide runs by themselves",
            }
        surrogate = getattr(surrogate, "base", surrogate)
        manifest = getattr(surrogate, "manifest", {})
        instants = getattr(surrogate, "time_h", np.linspace(0.0, surrogate.horizon_h, INSTANTS))
        return ModelCard(
            id=name,
            version=model.version,
            digest=model.digest,
            network=model.network,
            horizon_h=float(surrogate.horizon_h),
            node_count=surrogate.node_count,
            nodes=dict(surrogate.named),
            time_h=tuple(np.asarray(instants).tolist()),
            outputs={q.name: Output(q.unit, q.kind) for q in model.network.quantities},
            summary={k: v for k, v in manifest.items() if k not in ("structure", "schema")}
            | told
            | (more or {}),
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
        from core.archive.opening import opened
        from core.surrogate.own import make

        with tempfile.TemporaryDirectory(prefix="bladetwin-runs-") as folder:
            file, made = Path(folder) / "runs.nc", Path(folder) / "model"
            file.write_bytes(runs)
            with opened(file) as source:
                make(source, network, made, leave_out=leave_out, progress=progress, facts=facts)
            write_network(made, network)
            artefact = pack(made)
        return self.opened(name, artefact), artefact

    def opened(self, name: str, artefact: bytes) -> ModelCard:
        model = unpack(artefact)
        return self._card(name, model, {"artefact": sha256(artefact).hexdigest()})

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
        spec = online.RotorSpec(rotor.id, rotor.blades, rotor.particles, rotor.seed, rotor.known)
        state = online.update(
            self._model(card), spec, readings, previous, quick=quick, workspace=self._workspace
        )
        if self._kept:
            kernels.insist()
        return state

    def restore(self, meta: Mapping[str, Any], get: Get) -> RotorState:
        return RotorState(meta, Arrays(meta["arrays"], {}, get))

    def shared_draws(self, meta: Mapping[str, Any], get: Get) -> Draws:
        return _draws(shared_posterior(meta, get))

    def blade_draws(self, meta: Mapping[str, Any], get: Get, blade: str) -> Draws:
        return _draws(blade_posterior(meta, get, blade))

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
    ) -> Bands:
        model = self._model(card).for_blade(blade)
        posterior = blade_posterior(meta, get, blade)
        components = [0, 1, 2] if card.outputs[quantity].kind == "vector" else [None]
        parts = [
            predict(
                model,
                posterior,
                quantity,
                times,
                node,
                probability,
                component=component,
                instrument=instrument,
                known=known,
            )
            for component in components
        ]
        noise = model.network.quantity(quantity).sigma_of(parts[0].instrument)

        def joined(arrays: list[Array]) -> Array:
            return arrays[0] if len(arrays) == 1 else np.stack(arrays, axis=1)

        return Bands(
            parts[0].time_h,
            joined([p.mean for p in parts]),
            {name: joined([p.sd[name] for p in parts]) for name in parts[0].sd},
            joined([p.lower for p in parts]),
            joined([p.upper for p in parts]),
            {q: joined([p.quantiles[q] for p in parts]) for q in parts[0].quantiles},
            parts[0].instrument,
            "readings" if noise in posterior.names else "prior",
        )

    def joint_draws(
        self, meta: Mapping[str, Any], get: Get, blades: Sequence[str], count: int
    ) -> JointDraws:
        from service.joint import joint_draws

        return joint_draws(meta, get, blades, count)

    def prior_draws(self, card: ModelCard, like: JointDraws) -> JointDraws:
        from core.calibration.target import shared_prior
        from service.predictive import prior_draws

        model = self._model(card)
        shared = {name: shared_prior(model, name) for name in like.shared_names}
        return prior_draws(card.network, shared, like)

    def replicated(
        self,
        card: ModelCard,
        drawn: JointDraws,
        readings: Sequence[Inspection],
        known: Mapping[str, Mapping[str, float]],
    ) -> list[Array]:
        from service.predictive import replicated

        return replicated(self._model(card), drawn, readings, known)

    def forward(
        self, card: ModelCard, quantity: str, blade: str | None, known: Mapping[str, float] | None
    ) -> Forward:
        from service.forward import forward_of

        model = self._model(card)
        return forward_of(model if blade is None else model.for_blade(blade), quantity, known)

    def mesh(self, card: ModelCard) -> Mesh | None:
        from service.fields import mesh_of

        return mesh_of(self._points(card), card.summary.get("mesh"))

    def _points(self, card: ModelCard) -> Array | None:
        """The nodes of the training runs, also of a surrogate that effects drive."""
        surrogate = self._model(card).surrogate
        points: Array | None = getattr(getattr(surrogate, "base", surrogate), "points", None)
        return points

    def surface(self, card: ModelCard) -> Surface | None:
        from service.fields import surface_of

        return surface_of(self._points(card), card.summary.get("mesh"))

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
        from service.fields import field_of

        model = self._model(card).for_blade(blade)
        return field_of(model, blade_posterior(meta, get, blade), quantity, time_h, known)

    def warm(self, card: ModelCard) -> None:
        """One update of a made-up rotor compiles what an update needs.

        Its readings are what the model answers in the middle of the priors.
        """
        model = self._model(card)
        quantity = next((q for q in card.network.quantities if q.kind == "scalar"), None)
        if quantity is None:
            return
        inputs = [card.network.parameter(i.name) for i in model.part(quantity.name).inputs]
        middle = {
            p.name: p.prior.quantile(np.array(0.5)).item() if p.nominal is None else p.nominal
            for p in inputs
        }
        known = {p.name: middle[p.name] for p in inputs if p.level == "known"}
        spec = RotorSpec("warm", ("w",), 256, 0, {"w": known})
        x = np.array([[middle[p.name] for p in inputs]])
        times = card.horizon_h * np.array([0.5, 0.6])
        values, _ = model.part(quantity.name).predict(x, quantity.name, times)
        first, later = (
            Inspection(
                f"w{i}", "w", quantity.name, t, values[0, [i]], sigma=quantity.sigma_obs.high
            )
            for i, t in enumerate(times.tolist())
        )
        state = self.update(card, spec, [first], None, quick=False)
        self.update(card, spec, [first, later], state, quick=True)

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
        return planned(self._model(card), state, blades, readings, target, count)

    def check_families(self, card: ModelCard, families: Sequence[Json]) -> None:
        from service.effects import families_of

        families_of(self._model(card), families)

    def diagnose(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        families: Sequence[Json],
        compare_h: float | None,
        progress: Progress,
    ) -> Json:
        from core.calibration import online
        from service.effects import diagnosed

        spec = online.RotorSpec(rotor.id, rotor.blades, rotor.particles, rotor.seed, rotor.known)
        return diagnosed(self._model(card), spec, facts, readings, families, compare_h, progress)

    def residuals(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        progress: Progress,
    ) -> Json:
        from core.calibration import online
        from service.residuals import computed

        spec = online.RotorSpec(rotor.id, rotor.blades, rotor.particles, rotor.seed, rotor.known)
        return computed(self._model(card), spec, facts, readings, progress)


def _draws(posterior: Posterior) -> Draws:
    return Draws(posterior.names, posterior.particles.psi, posterior.particles.log_w)
