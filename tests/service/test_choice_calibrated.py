"""An alternative as the real science tells it: two names of one and the same misfit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from service.bootstrap import make_worker
from service.handlers import reads
from service.handlers.adoptions import adopt, back_out
from service.handlers.choice import Choice
from service.handlers.diagnoses import find_diagnosis, request_diagnosis
from service.handlers.inspections import Item, post_inspections
from service.handlers.rotors import view_rotor
from service.ports import Which
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from tests.service.smooth import formula_science
from tests.service.test_effects import NOISE, made, visits

INSTRUMENT = "instrument offset (instrument gauge 2)"


@pytest.fixture
def database_url(sqlite_url: str) -> str:
    """The science is the same on both databases, and takes a minute."""
    return sqlite_url


@pytest.fixture
def fleet(settings: Settings) -> Iterator[SqlStore]:
    opened = made(settings.database_url)
    yield opened
    opened.close()


def another_gauge(off: float) -> list[Item]:
    """Readings of which the second visit's are all by a gauge that took no others."""
    gauge = {"0": "gauge 1", "1": "gauge 2", "2": "gauge 1"}
    own = [item.reading for item in visits(off)]
    return [Item("", replace(r, instrument=gauge[r.id.split("-")[1]])) for r in own]


def test_the_chosen_one_of_two_is_the_model_that_was_calibrated_and_backs_out(
    fleet: SqlStore, settings: Settings
) -> None:
    science = formula_science()
    post_inspections(fleet, "r1", another_gauge(5.0))
    make_worker(fleet, science, settings).drain()
    before = view_rotor(fleet, "r1").state
    assert before is not None
    job, _ = request_diagnosis(fleet, science, "r1", (), compare=True, horizon_h=None)
    make_worker(fleet, science, settings, "d", "diagnose").drain()
    found = find_diagnosis(fleet, "r1", job.id).result or {}
    assert found["verdict"] == "not separable", found["reasons"]
    each = found["alternatives"]["each"]
    assert [one["number"] for one in each] == [*range(1, len(each) + 1)]
    named = {one["adoption"]["effects"][0]["name"]: one for one in each}
    assert INSTRUMENT in named
    assert "campaign offset (campaign visit 1)" in named
    chosen = named[INSTRUMENT]
    choice = Choice(chosen["number"], "the gauge was found bent")
    change = adopt(fleet, science, "r1", job.id, choice)
    make_worker(fleet, formula_science(), settings).drain()
    after = view_rotor(fleet, "r1").state
    assert after is not None
    assert after.meta["model"] == change.body["models"]["after"] == chosen["adoption"]["model"]
    size = chosen["adoption"]["effects"][0]["amplitude"]
    assert abs(size["mean"] - 5 * NOISE) < 3 * size["sd"] < 3 * NOISE
    here = reads.posterior(fleet, science, reads.basis(fleet, science, "r1", Which()))
    told = here["parameters"][INSTRUMENT]
    assert told["mean"] == pytest.approx(size["mean"], abs=0.2 * size["sd"])
    assert told["sd"] == pytest.approx(size["sd"], rel=0.1)
    back_out(fleet, science, "r1", job.id)
    make_worker(fleet, formula_science(), settings).drain()
    again = view_rotor(fleet, "r1").state
    assert again is not None
    assert again.digest == before.digest
