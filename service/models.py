"""Which model a card means: loaded, kept, and varied by a rotor's own network.

Three models come with a release: blades on their shipped surrogate; the same blades on one of wider
runs, in which effects that the first lacks find room; and creep specimens in closed form. Others
are trained on users' own runs and lie as files in the store (`service.packed`).

A card names the model's version. Where that is not the one that is loaded, nothing is answered:
the posterior that rests on it would be another one.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

import core.builtin
from core.builtin import creep_specimens, shipped
from core.builtin.paper_network import rotor_blade_network
from core.discrepancy import parameters
from core.errors import InputError, ModelError
from core.model import Model, rotor_blade_wide
from core.surrogate.artefact import load
from service.packed import unpack
from service.ports import Json, ModelCard, Output
from service.variant import named, vary

SHIPPED = Path(core.builtin.__file__).with_name("rotor_blade_model")
NAME = "rotor-blade"
WIDE = f"{NAME}-wide"
SPECIMENS = creep_specimens.NAME
INSTANTS = 51
MOST_VARIED = 64  # varied models kept with the rows compiled for them
MOST_OWN = 8  # models of users' runs that are kept loaded


def _else(name: str) -> str:
    """What is to be done with rotors of a model of another release, but to run that one."""
    if name == NAME:
        return "set BLADETWIN_MODEL_DIR to the folder of that model"
    return (
        "create the rotor anew, which takes this release's model, and post its readings there "
        "(`bladetwin export ROTOR FILE --format csv`)"
    )


class Models:
    """The models of one process; of users' own and of varied ones the last used are kept.

    folder, model, files   as `service.science.CoreScience` has them
    """

    def __init__(
        self, folder: str, model: Model | None, files: Callable[[str], bytes] | None
    ) -> None:
        self._files = files
        self._own: OrderedDict[str, Model] = OrderedDict()
        self._folder = Path(folder) if folder else SHIPPED
        self._models: dict[str, Model] = {} if model is None else {NAME: model}
        self.builtins = (NAME, WIDE, SPECIMENS) if model is None else (NAME,)
        self._lock = threading.Lock()
        self._varied: OrderedDict[str, Model] = OrderedDict()

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
        whole = shipped.WHOLE[SHIPPED.name] if self._folder == SHIPPED else None
        return Model(rotor_blade_network(), load(self._folder, whole))

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

    def of(self, card: ModelCard) -> Model:
        """The loaded model, or its surrogate under the varied network of the card."""
        with self._lock:
            own = card.id not in self.builtins and "artefact" in card.summary
            model = self._trained(card) if own else self._loaded(card.id)
            if card.version != model.version:
                raise ModelError(
                    f"model {card.id} {card.version} is registered, but this release has "
                    f"{model.version}. Run the release that registered it, or {_else(card.id)}."
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
        model = self.of(card)
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
        return self.card(name, model)

    def card(self, name: str, model: Model, more: Json | None = None) -> ModelCard:
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

    def opened(self, name: str, artefact: bytes) -> ModelCard:
        model = unpack(artefact)
        return self.card(name, model, {"artefact": sha256(artefact).hexdigest()})
