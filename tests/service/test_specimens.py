"""The second built-in model over HTTP, on the real calibration: creep specimens, not blades."""

from __future__ import annotations

from dataclasses import replace

import httpx
import numpy as np
import pytest

from core.builtin import creep_specimens as built
from core.errors import ModelError
from service.bootstrap import make_worker
from service.client import Client
from service.handlers.models import register_builtins
from service.models import NAME, SPECIMENS
from service.ports import Science
from service.science import CoreScience
from service.settings import Settings
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from tests.service.test_api import refuse

STRESS = {"S1": 150.0, "S2": 180.0, "S3": 210.0}
RATES = {"S1": -4.45, "S2": -4.55, "S3": -4.5, "new": -4.5}


@pytest.fixture(scope="module")
def science() -> CoreScience:
    return CoreScience()


def truth(name: str, stress: float, time_h: float) -> float:
    """Norton's law, n = 7."""
    x = np.array([RATES[name], 7.0, 0.0, 0.04, 0.0, stress])
    return float(built.strain(x, time_h))


def registered(api: httpx.Client, store: SqlStore, science: Science, settings: Settings) -> str:
    """The version, by POST /v1/models and a worker."""
    job = api.post("/v1/models", json={"builtin": SPECIMENS})
    assert job.status_code == 202
    make_worker(store, science, settings).drain()
    done = api.get(job.headers["location"]).json()
    assert done["status"] == "done", done
    return str(done["result"]["version"])


def test_specimens_are_registered_calibrated_and_predicted_over_http_and_after_a_restart(
    api: httpx.Client, store: SqlStore, settings: Settings, science: CoreScience
) -> None:
    twin = Client(http=api)
    assert [m["id"] for m in api.get("/v1/models").json()["items"]] == [NAME]
    version = registered(api, store, science, settings)
    assert registered(api, store, science, settings) == version
    card = api.get(f"/v1/models/{SPECIMENS}").json()
    assert card["digest"].startswith(version)
    assert card["summary"]["kind"] == "closed form"
    assert set(card["outputs"]) == {built.QUANTITY}

    blades = [{"id": name, "known": {"stress": s}} for name, s in STRESS.items()]
    twin.create_rotor("set", model=SPECIMENS, blades=blades, particles=1024)
    rng, readings = np.random.default_rng(2), []
    for name, stress in STRESS.items():
        end = 3.0 / truth(name, stress, 1.0)
        for i, t in enumerate(np.linspace(0.2, 1.0, 5) * end):
            value = truth(name, stress, t) + 0.02 * rng.normal()
            reading = {"id": f"{name}-{i}", "blade": name, "quantity": built.QUANTITY}
            readings.append(reading | {"time_h": t, "value": value, "unit": "%"})
    twin.post_inspections("set", readings)
    twin.add_blade("set", {"id": "new", "known": {"stress": 195.0}})
    make_worker(store, science, settings).drain()
    assert twin.rotor("set")["posterior"]["sealed"]

    shared = api.get("/v1/rotors/set/posterior").json()["parameters"]
    assert abs(shared["n"]["mean"] - 7.0) < 3 * shared["n"]["sd"]
    late = 4.0 / truth("S2", 180.0, 1.0)
    bands = {
        name: twin.prediction("set", name, times=[late], probability=0.99)
        for name in (*STRESS, "new")
    }
    for name, band in bands.items():
        true = truth(name, STRESS.get(name, 195.0), late)
        assert band["lower"][0] < true < band["upper"][0], name
        assert band["sd"]["surrogate"][0] == 0.0
        assert band["rests_on"]["model_digest"] == card["digest"]
    assert bands["new"]["sd"]["parameters"][0] > 2 * bands["S2"]["sd"]["parameters"][0]

    # a process that starts anew finds the model and the state in the database alone
    again = SqlStore(open_engine(settings.database_url))
    fresh = CoreScience()
    register_builtins(again, fresh)
    with again.read() as tx:
        found = tx.records.model(SPECIMENS)
    assert found.digest == card["digest"] == fresh.builtin(SPECIMENS).digest
    more = {"id": "S1-late", "blade": "S1", "quantity": built.QUANTITY, "time_h": late}
    twin.post_inspections("set", [more | {"value": truth("S1", 150.0, late)}])
    make_worker(again, fresh, settings).drain()
    later = twin.prediction("set", "S1", times=[late])
    assert later["sd"]["parameters"][0] < bands["S1"]["sd"]["parameters"][0]
    again.close()


def test_a_formula_that_answers_otherwise_is_another_version_and_refused_by_name(
    science: CoreScience,
) -> None:
    card = science.builtin(SPECIMENS)
    other = replace(
        built.formula(), formulas={built.QUANTITY: lambda x, t: 1.01 * built.strain(x, t)}
    )
    assert other.digest != built.formula().digest
    with pytest.raises(ModelError, match=f"{SPECIMENS} 0123.* has {card.version}"):
        science.vary(replace(card, version="0123"), {})
    with pytest.raises(ModelError, match="none of this release's"):
        science.vary(replace(card, id="turbine-disc"), {})


def test_a_specimen_without_its_stress_or_a_strain_in_the_wrong_unit_is_refused(
    api: httpx.Client, store: SqlStore, settings: Settings, science: CoreScience
) -> None:
    registered(api, store, science, settings)
    body = {"id": "set", "model": SPECIMENS, "blades": [{"id": "S1"}]}
    refuse(api.post("/v1/rotors", json=body), 422, "blades[0].known.stress")
    far = body | {"blades": [{"id": "S1", "known": {"stress": 900.0}}]}
    refuse(api.post("/v1/rotors", json=far), 422, "blades[0].known.stress")
    good = body | {"blades": [{"id": "S1", "known": {"stress": 180.0}}]}
    assert api.post("/v1/rotors", json=good).status_code == 201
    reading = {"id": "i", "blade": "S1", "quantity": built.QUANTITY, "time_h": 10.0, "value": 0.5}
    refuse(api.post("/v1/rotors/set/inspections", json=reading | {"unit": "mm"}), 422, "unit")
    refuse(
        api.post("/v1/rotors/set/inspections", json=reading | {"quantity": "elongation"}),
        422,
        "quantity",
    )
    refuse(api.post("/v1/models", json={"builtin": "turbine-disc"}), 422, "builtin")
