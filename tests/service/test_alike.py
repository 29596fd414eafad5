"""What the tests' applications share (`conftest.alike`) is what each would have made by itself."""

from __future__ import annotations

import httpx
import pytest
from fastapi import FastAPI

from service.bootstrap import make_app
from service.fake import FakeScience
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from tests.service.conftest import alike


@pytest.fixture
def database_url(sqlite_url: str) -> str:
    """Nothing here is of the database."""
    return sqlite_url


def fresh(store: SqlStore, science: FakeScience, settings: Settings, keys: str) -> FastAPI:
    return make_app(store, science, settings.model_copy(update={"keys": keys}))


@pytest.mark.parametrize(("keys", "needed"), [("auto", False), ("always", True)])
def test_the_shared_document_is_the_one_that_an_application_makes_itself(
    store: SqlStore, science: FakeScience, settings: Settings, keys: str, needed: bool
) -> None:
    shared = fresh(store, science, settings, keys)
    for other in (not needed, needed):  # whichever of the two was asked for first
        alike(fresh(store, science, settings, "always" if other else "auto"), keys=other)
    alike(shared, keys=needed)
    assert shared.openapi() == fresh(store, science, settings, keys).openapi()


@pytest.mark.parametrize("time", ["first", "second"])
def test_the_shared_routes_find_the_database_of_their_own_test(
    api: httpx.Client, time: str
) -> None:
    """A route that kept the first test's store would refuse the second rotor of that name."""
    body = {"id": "r1", "model": "rotor-blade", "particles": 64, "blades": [{"id": "B1"}]}
    assert api.get("/v1/rotors").json()["items"] == []
    assert api.post("/v1/rotors", json=body).status_code == 201, time
