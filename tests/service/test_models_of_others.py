"""A worker beside models that another release registered."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import pytest
from sqlalchemy import update

from core.builtin.paper_network import rotor_blade_network
from core.errors import ModelError
from service.bootstrap import make_worker
from service.fake import FakeScience
from service.models import NAME, WIDE, Models
from service.ports import ModelCard
from service.settings import Settings
from service.store import tables as t
from service.store.unit_of_work import SqlStore, SqlTransaction


@dataclass(frozen=True, slots=True)
class Strict(FakeScience):
    """A release that refuses models of other versions than its own, as the calibration does."""

    fit: bool = True

    def warm(self, card: ModelCard) -> None:
        if not self.fit or card != self.builtin(self.builtins[0]):
            raise ModelError(f"model {card.id} {card.version} is none of this release's")


def register_in(tx: SqlTransaction, card: ModelCard) -> None:
    tx.records.put_model(card, {"builtin": card.id}, newest=True)


def register(store: SqlStore, card: ModelCard) -> None:
    with store.write() as tx:
        register_in(tx, card)


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


def test_the_newest_version_is_the_last_registered_whatever_the_clock_says(
    store: SqlStore,
) -> None:
    """SQLite's tells milliseconds, and two may fall into one; any may have gone back."""
    card = FakeScience().builtin("rotor-blade")
    ahead = 1e10
    with store.write() as tx:
        for name in ("a", "c"):
            register_in(tx, replace(card, version=name))
        tx.connection.execute(update(t.model).values(created_at=ahead))
        register_in(tx, replace(card, version="b"))
        assert tx.records.model(card.id).version == "b"
        register_in(tx, replace(card, version="a"))  # known, and the one again
        assert tx.records.model(card.id).version == "a"
        tx.records.put_model(replace(card, version="c"), {"builtin": card.id}, newest=False)
        assert tx.records.model(card.id).version == "a"
