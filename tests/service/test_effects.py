"""Diagnoses by the real science, on blades given by a formula, through a worker."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from core.errors import InputError
from core.observation import Inspection
from service.bootstrap import make_worker
from service.diagnose_command import lines_of
from service.handlers.diagnoses import find_diagnosis, request_diagnosis
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord, Json
from service.settings import Settings
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from tests.service.smooth import elongation, formula_science
from tests.service.test_diagnoses import FAMILY

BLADES, VISITS, NOISE = 6, (8000.0, 16_000.0, 24_000.0), 0.004


@pytest.fixture
def database_url(tmp_path: Any, sqlite_template: Any) -> str:
    """The science is the same on both databases, and takes a minute."""
    shutil.copy(sqlite_template, tmp_path / "bladetwin.db")
    return f"sqlite:///{tmp_path / 'bladetwin.db'}"


@pytest.fixture
def fleet(settings: Settings) -> Iterator[SqlStore]:
    opened = SqlStore(open_engine(settings.database_url))
    register_builtins(opened, formula_science())
    blades = [BladeRecord(f"B{b}", lot=f"L{b % 2}") for b in range(BLADES)]
    create_rotor(opened, "r1", "rotor-blade", blades, 400, 7)
    yield opened
    opened.close()


def visits(off: float) -> list[Item]:
    """Readings of six blades at three visits; the second visit reads `off` noises too long."""
    rng = np.random.default_rng(20310504)
    found = []
    for b in range(BLADES):
        x = np.array([[1.0 + 0.05 * rng.normal(), 0.87, 0.3 * rng.normal(), 0.3 * rng.normal()]])
        for k, h in enumerate(VISITS):
            y = float(elongation(x, h)[0]) + NOISE * rng.normal() + NOISE * off * (k == 1)
            reading = Inspection(
                f"{b}-{k}",
                f"B{b}",
                "elongation",
                h,
                np.array([y]),
                sigma=NOISE,
                campaign=f"visit {k}",
            )
            found.append(Item("", reading))
    return found


def diagnosed(fleet: SqlStore, settings: Settings, off: float) -> Json:
    post_inspections(fleet, "r1", visits(off))
    science = formula_science()
    job, _ = request_diagnosis(fleet, science, "r1", (), compare=True, horizon_h=None)
    make_worker(fleet, science, settings, "d", "diagnose").drain()
    ended = find_diagnosis(fleet, "r1", job.id)
    assert ended.status == "done", ended.error
    assert ended.result is not None
    return {"rotor": "r1", "result": ended.result}


def test_a_campaign_that_read_five_noises_too_long_is_named_with_its_amplitude(
    fleet: SqlStore, settings: Settings
) -> None:
    told = diagnosed(fleet, settings, 5.0)
    found = told["result"]
    assert (found["verdict"], found["names"]) == ("effect", ["campaign offset (campaign visit 1)"])
    size = found["effects"][0]["amplitude"]
    assert abs(size["mean"] - 5 * NOISE) < 3 * size["sd"] < 3 * NOISE
    assert found["readings"] == {"delivered": 18, "used": 18}
    assert (
        found["models"]["after"] != found["models"]["before"] == found["rests_on"]["model_digest"]
    )
    compared = found["before_after"]
    assert compared["held_out"] == ["1-2", "3-2", "5-2"]
    assert compared["after"]["log_score"] > compared["before"]["log_score"]
    shown = "\n".join(lines_of(told))
    assert "rotor r1: effect" in shown
    assert "campaign offset (campaign visit 1): 0.018" in shown
    assert "3 readings that neither model used" in shown


def test_the_same_blades_without_the_offset_are_adequate(
    fleet: SqlStore, settings: Settings
) -> None:
    """The negative control: nothing is claimed, and nothing compared."""
    found = diagnosed(fleet, settings, 0.0)["result"]
    assert (found["verdict"], found["effects"], found["before_after"]) == ("adequate", [], None)
    assert found["p"] > 0.05


def test_a_family_of_an_input_that_the_model_has_not_is_refused_before_anything_is_queued(
    fleet: SqlStore,
) -> None:
    science = formula_science()
    worn = FAMILY | {"target": "input", "of": "tbc_thickness", "whom": ["all"], "name": "worn"}
    for families, at in (
        ([worn, worn | {"name": "other", "of": "wall_loss"}], r"families\[1\].of"),
        ([worn, worn], r"families\[1\].name"),
    ):
        with pytest.raises(InputError, match=at):
            request_diagnosis(fleet, science, "r1", families, compare=True, horizon_h=None)
    assert request_diagnosis(fleet, science, "r1", [worn], compare=True, horizon_h=None)[1]
