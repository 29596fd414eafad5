"""Versions of the blade physics are made again one by one, each from the one before it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import update

from core.observation import Inspection
from service.bootstrap import make_science, make_store, make_worker, prepare
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord, Science
from service.settings import Settings
from service.store import tables as t
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.studies.chaos.check import Findings, by_physics, check

READINGS = [("a", "B1", 9100.0, 0.117), ("b", "B2", 16_000.0, 0.203), ("c", "B1", 21e3, 0.231)]


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings.load({}, database_url=f"sqlite:///{tmp_path / 'core.db'}", seal_after_s=0.0)


@pytest.fixture
def store(settings: Settings) -> Iterator[SqlStore]:
    """A rotor with a version for each reading, the last one sealed."""
    opened = make_store(settings)
    prepare(opened, settings)
    science = make_science(settings, opened)
    register_builtins(opened, science)
    create_rotor(opened, "r1", "rotor-blade", [BladeRecord("B1"), BladeRecord("B2")], 64, 7)
    applies = make_worker(opened, science, settings, "w", "apply")
    for name, blade, hours, value in READINGS:
        one = Inspection(name, blade, "elongation", hours, np.array([value]))
        post_inspections(opened, "r1", [Item("", one)])
        assert applies.updater.run_once()
    assert make_worker(opened, science, settings, "s", "seal").updater.run_once()
    yield opened
    opened.close()


def found(store: SqlStore, settings: Settings) -> Findings:
    science: Science = make_science(settings, store)
    acknowledged = {("r1", name): seq for seq, (name, *_) in enumerate(READINGS, start=1)}
    return check(store, acknowledged, again=by_physics(science))


def test_every_version_is_what_the_one_before_it_and_its_readings_give(
    store: SqlStore, settings: Settings
) -> None:
    seen = found(store, settings)
    assert seen.faults == {}
    assert seen.counts["versions"] == 4
    # Negative control: the second version says that it ends before the reading that is in it.
    second = (t.state.c.rotor_id == "r1") & (t.state.c.version == 2)
    with transaction(store.engine, write=True) as connection:
        connection.execute(update(t.state).where(second).values(through_seq=1))
    assert found(store, settings).faults == {
        "wrong_versions": ["r1 version 2: is not what entries 1 … 1 give"]
    }
