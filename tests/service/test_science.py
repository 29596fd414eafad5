"""The calibration behind the port, on a blade given by a formula."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.builtin.paper_network import rotor_blade_network
from core.errors import ModelError
from core.model import Model
from core.observation import Inspection
from core.surrogate.artefact import whole_of
from core.surrogate.formula import FormulaInput, FormulaModel
from service import models
from service.bootstrap import make_worker
from service.handlers import reads
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.questions import question
from service.handlers.rotors import create_rotor, view_rotor
from service.ports import BladeRecord, RotorSpec, Which
from service.science import CoreScience
from service.settings import Settings
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from tests.service.smooth import TRUE, elongation, formula_science

Make = Callable[..., Inspection]
VERSION = "bd0e81fbaf3e38fb"  # of the shipped model


@pytest.fixture
def real_store(settings: Settings) -> Iterator[SqlStore]:
    opened = SqlStore(open_engine(settings.database_url))
    register_builtins(opened, formula_science())
    yield opened
    opened.close()


def test_any_order_of_arrival_ends_in_the_same_sealed_posterior_and_a_band_that_holds_the_truth(
    real_store: SqlStore, settings: Settings, reading: Make
) -> None:
    times = (4000.0, 9000.0, 16_000.0)
    found = [float(elongation(TRUE, t)[0]) for t in times]
    noise = (0.002, -0.003, 0.001)
    readings = [
        reading(f"i{i}", time_h=t, value=round(y + e, 4), sigma=0.003)
        for i, (t, y, e) in enumerate(zip(times, found, noise, strict=True))
    ]
    readings.append(reading("z", blade="B2", time_h=8000.0, value=0.12, sigma=0.003))
    blades = [BladeRecord("B1"), BladeRecord("B2")]
    create_rotor(real_store, "r1", "rotor-blade", blades, 512, 5)
    worker = make_worker(real_store, formula_science(), settings)
    for i in (3, 2, 0, 1):
        post_inspections(real_store, "r1", [Item("", readings[i])])
        worker.drain()
    state = view_rotor(real_store, "r1").state
    assert state is not None
    assert state.sealed
    science = formula_science()
    basis = reads.basis(real_store, science, "r1", Which(), "B1")
    spec = RotorSpec("r1", ("B1", "B2"), 512, 5)
    alone = science.update(basis.card, spec, readings, None, quick=False)
    assert state.digest == alone.digest
    get = real_store.arrays("r1", state.version)
    assert all(get(name).tobytes() == array.tobytes() for name, array in alone.arrays.items())

    asked = question(basis.card, "elongation", [30_000.0, 50_000.0], None, 0.95)
    bands = reads.predict(real_store, science, basis, asked)
    truth = [float(elongation(TRUE, t)[0]) for t in asked.times]
    for low, true, high in zip(bands["lower"], truth, bands["upper"], strict=True):
        assert low < true < high
    total = np.array(bands["sd"]["total"]) ** 2
    parts = sum(np.array(v) ** 2 for k, v in bands["sd"].items() if k != "total")
    assert parts == pytest.approx(total)
    assert "t1t_rate" in reads.posterior(real_store, science, basis)["parameters"]
    own = reads.posterior(real_store, science, replace(basis, blade=BladeRecord("B1")))
    assert 1.0 <= own["parameters"]["tbc_thickness"]["r_hat"] <= own["r_hat"] < 1.1
    assert own["parameters"]["t1t_rate"]["r_hat"] > 1.0


def test_a_model_of_another_release_is_refused_by_name(real_store: SqlStore) -> None:
    network = rotor_blade_network()
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in network.parameters)
    other = FormulaModel(inputs, {"elongation": elongation}, "another", 50_000.0)
    with real_store.read() as tx:
        card = tx.records.model("rotor-blade")
    with pytest.raises(ModelError, match=card.version):
        CoreScience(model=Model(network, other)).warm(card)


def test_a_changed_note_of_a_shipped_model_keeps_it_from_being_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shipped one is held against the release, even where its own digest was made to fit; a
    rebuilt one (`BLADETWIN_MODEL_DIR`) against its own."""
    copy = tmp_path / models.SHIPPED.name
    shutil.copytree(models.SHIPPED, copy)
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["runs"]["test"] = 340
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ModelError, match="a note on errors or provenance was changed"):
        CoreScience(str(copy)).builtin("rotor-blade")
    manifest["whole"] = whole_of(manifest)
    (copy / "manifest.json").write_text(json.dumps(manifest))
    assert CoreScience(str(copy)).builtin("rotor-blade").summary["runs"]["test"] == 340
    monkeypatch.setattr(models, "SHIPPED", copy)
    with pytest.raises(ModelError, match="this release says"):
        CoreScience().builtin("rotor-blade")


def test_what_a_card_tells_of_a_model_is_what_earlier_releases_registered() -> None:
    """A manifest's second digest is not among it, or `verify` would find the card changed."""
    card = CoreScience().builtin("rotor-blade")
    assert (card.version, "whole" in card.summary) == (VERSION, False)
