"""A worker beside models that another release registered."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import pytest

from core.builtin.paper_network import rotor_blade_network
from core.errors import ModelError
from service.bootstrap import make_worker
from service.fake import FakeScience
from service.models import NAME, WIDE, Models
from service.ports import ModelCard
from service.settings import Settings
from service.store.unit_of_work import SqlStore


@dataclass(frozen=True, slots=True)
class Strict(FakeScience):
    """A release that refuses models of other versions than its own, as the calibration does."""

    fit: bool = True

    def warm(self, card: ModelCard) -> None:
        if not self.fit or card != self.builtin(self.builtins[0]):
            raise ModelError(f"model {card.id} {card.version} is none of this release's")


def register(store: SqlStore, card: ModelCard) -> None:
    with store.write() as tx:
        tx.records.put_model(card, {"builtin": card.id}, newest=True)


@pytest.mark.parametrize("given", [{"id": "rotor-blade-wide"}, {"version": "newer"}], ids=str)
def test_a_worker_starts_beside_a_model_that_a_newer_release_registered(
    store: SqlStore,
    settings: Settings,
    caplog: pytest.LogCaptureFixture,
    given: dict[str, str],
) -> None:
    """Rotors of other models would wait for it, too, while a release is taken over or back."""
    register(store, replace(FakeScience().builtin("rotor-blade"), **given))
    with caplog.at_level(logging.ERROR, logger="bladetwin.worker"):
        make_worker(store, Strict(), settings).warm()
    assert ["none of this release's" in one.getMessage() for one in caplog.records] == [True]


def test_a_worker_that_cannot_load_its_own_model_does_not_start(
    store: SqlStore, settings: Settings
) -> None:
    with pytest.raises(ModelError, match="rotor-blade"):
        make_worker(store, Strict(fit=False), settings).warm()


@pytest.mark.parametrize(
    ("name", "remedy"), [(NAME, "BLADETWIN_MODEL_DIR"), (WIDE, "create the rotor anew")]
)
def test_the_remedy_fits_the_model(name: str, remedy: str) -> None:
    """BLADETWIN_MODEL_DIR is a rotor-blade model's alone."""
    models = Models("", None, None)
    card = replace(models.builtin(name), version="another", network=rotor_blade_network())
    with pytest.raises(ModelError, match=remedy) as told:
        models.of(card)
    assert ("BLADETWIN_MODEL_DIR" in str(told.value)) == (name == NAME)


def test_of_versions_registered_within_one_tick_the_last_is_the_newest(store: SqlStore) -> None:
    """SQLite's clock tells milliseconds; whichever comes first in the table was taken."""
    card = FakeScience().builtin("rotor-blade")
    names = [f"v{k}" for k in (3, 1, 4, 0, 2)]
    with store.write() as tx:
        for name in names:
            tx.records.put_model(replace(card, version=name), {"builtin": card.id}, newest=True)
            assert tx.records.model(card.id).version == name
    with store.write() as tx:  # one that is known, again
        tx.records.put_model(replace(card, version="v3"), {"builtin": card.id}, newest=True)
        tx.records.put_model(replace(card, version="v1"), {"builtin": card.id}, newest=False)
        assert tx.records.model(card.id).version == "v3"
