"""A blade's model over HTTP by the UM-Bridge protocol, called by the protocol's own client."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import umbridge
import uvicorn

from core.calibration.state import blade_posterior
from core.observation import Inspection
from core.prediction import predict
from service.bootstrap import make_worker
from service.free_port import free_port
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.reads import Basis, basis
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord, Which
from service.settings import Settings
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from service.umbridge.app import umbridge_app
from service.umbridge.models import served
from service.umbridge.protocol import answer
from tests.patience import PATIENCE_S, until
from tests.service.smooth import elongation, formula_science
from tests.service.test_processes import ROOT

PSI = [1.1, 0.87, 0.4, -0.5]
GET, POST = (partial(ask, timeout=PATIENCE_S) for ask in (httpx.get, httpx.post))


@pytest.fixture
def database_url(sqlite_url: str) -> str:
    """Nothing here depends on the database; SQLite is the quicker one."""
    return sqlite_url


@pytest.fixture
def found(settings: Settings) -> Iterator[tuple[SqlStore, Basis]]:
    """B1 of a rotor on the formula, with two readings."""
    store = SqlStore(open_engine(settings.database_url))
    science = formula_science()
    register_builtins(store, science)
    create_rotor(store, "r1", "rotor-blade", [BladeRecord("B1")], 512, 5)
    readings = [
        Inspection(f"i{t}", "B1", "elongation", t, np.array([y]), sigma=0.003)
        for t, y in ((8000.0, 0.11), (30_000.0, 0.27))
    ]
    post_inspections(store, "r1", [Item("", one) for one in readings])
    make_worker(store, science, settings).drain()
    yield store, basis(store, science, "r1", Which(), "B1")
    store.close()


@pytest.fixture
def url(found: tuple[SqlStore, Basis]) -> Iterator[str]:
    """The protocol's server over a real connection."""
    models = {
        name: model
        for name, model in served(found[0], formula_science(), found[1]).items()
        if name.startswith("elongation")
    }
    config = uvicorn.Config(umbridge_app(models), host="127.0.0.1", port=0, log_config=None)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.005)
    yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    server.should_exit = True
    thread.join()


def test_the_model_at_given_parameters_is_that_of_core(url: str) -> None:
    assert umbridge.supported_models(url) == ["elongation", "elongation.posterior"]
    model = umbridge.HTTPModel(url, "elongation")
    assert model.supports_evaluate()
    assert not model.supports_gradient()
    config = {"times": [8000, 30_000.5]}
    assert model.get_input_sizes(config) == [4]
    assert model.get_output_sizes(config) == [2, 2]
    mean, sd = model([PSI], config)
    truth = [float(elongation(np.array([PSI]), t)[0]) for t in config["times"]]
    assert mean == truth
    assert sd == [0.0, 0.0]
    other = model([[1.1, 0.88, 0.4, -0.5]], config)[0]
    assert other != truth, "negative control"
    told = POST(f"{url}/ModelFacts", json={"name": "elongation"}).json()
    names = ["tbc_thickness", "t1t_rate", "creep_transient", "creep_steady"]
    assert [one["name"] for one in told["parameters"]] == names
    assert told["parameters"][1] == {"name": "t1t_rate", "unit": "1", "low": 0.8, "high": 1.0}


def test_the_posterior_model_is_the_prediction_of_core(
    url: str, found: tuple[SqlStore, Basis]
) -> None:
    store, here = found
    science = formula_science()
    model = umbridge.HTTPModel(url, "elongation.posterior")
    config = {"count": 2, "probability": 0.9}
    assert model.get_input_sizes(config) == [2]
    assert model.get_output_sizes(config) == [2] * 5
    told = model([[9000.0, 41_000.5]], config)
    with store.read() as tx:
        own = blade_posterior(here.state.meta, tx.states.reader(here.state), "B1")
        truth = predict(
            science.models.of(here.card), own, "elongation", [9000.0, 41_000.5], None, 0.9
        )
    assert told[0] == truth.mean.tolist()
    assert told[2] == truth.sd["total"].tolist()
    assert told[3:] == [truth.lower.tolist(), truth.upper.tolist()]
    noise = np.array(told[2]) ** 2 - np.array(told[1]) ** 2
    assert noise == pytest.approx(truth.sd["noise"] ** 2)
    info = POST(f"{url}/ModelFacts", json={"name": "elongation.posterior"}).json()
    assert info["rests_on"]["state_digest"] == here.state.digest
    assert info["health"]["status"] == "ok"


MODEL, BELIEF = "elongation", "elongation.posterior"
REFUSED: list[tuple[str, Any, str, str]] = [
    ("/Evaluate", {"name": "none", "input": [PSI]}, "ModelNotFound", MODEL),
    ("/Evaluate", {"name": MODEL, "input": [PSI[:3]]}, "InvalidInput", "4 numbers"),
    ("/Evaluate", {"name": MODEL, "input": PSI}, "InvalidInput", "1 vectors"),
    ("/Evaluate", {"name": MODEL, "input": [[1, 0.87, 0, "x"]]}, "InvalidInput", "finite"),
    ("/Evaluate", {"name": MODEL, "input": [[1, 0.87, 0, 10**400]]}, "InvalidInput", "finite"),
    ("/Evaluate", {"name": MODEL, "input": [[1, 0.7, 0, 0]]}, "InvalidInput", "0.8 … 1"),
    ("/Evaluate", {"name": MODEL, "input": [PSI], "x": 1}, "InvalidInput", "'x'"),
    ("/InputSizes", {"name": MODEL, "config": {"time": [1]}}, "InvalidInput", "config.time"),
    ("/InputSizes", {"name": MODEL, "config": {"times": "1"}}, "InvalidInput", "list"),
    ("/OutputSizes", {"name": MODEL, "config": {"times": [60_000]}}, "InvalidInput", "50000"),
    ("/InputSizes", {"name": BELIEF, "config": {"count": 0}}, "InvalidInput", "count"),
    ("/OutputSizes", {"name": BELIEF, "config": {"instrument": 3}}, "InvalidInput", "no name"),
    ("/Gradient", {"name": MODEL}, "UnsupportedFeature", "/Gradient"),
    ("/ModelInfo", [], "InvalidInput", "object"),
]


def test_what_cannot_be_answered_is_refused_in_the_protocol_s_words(url: str) -> None:
    for path, body, kind, word in REFUSED:
        told = POST(f"{url}{path}", json=body)
        error = told.json()["error"]
        assert (error["type"], told.status_code < 500) == (kind, True), (path, body, error)
        assert word in error["message"], (path, body, error)
    assert POST(f"{url}/ModelInfo", content=b"{").json()["error"]["type"] == "InvalidInput"
    assert GET(f"{url}/Evaluate").status_code == 405
    model = umbridge.HTTPModel(url, "elongation")
    with pytest.raises(Exception, match=r"InvalidInput: .*training runs"):
        model([[1.1, 0.5, 0.4, -0.5]])


def test_others_than_programs_of_this_machine_are_not_answered(url: str) -> None:
    for headers in ({"host": "evil.example"}, {"origin": "http://evil.example"},
                    {"x-forwarded-for": "192.0.2.1"}):  # fmt: skip
        assert GET(f"{url}/Info", headers=headers).status_code == 403
    large = POST(f"{url}/Evaluate", content=b" " * (2**22 + 1))
    assert large.status_code == 413


def test_a_model_that_fails_says_so_and_tells_nothing_else() -> None:
    class Broken:
        def info(self) -> Any:
            raise RuntimeError("a secret")

    status, told = answer({"m": Broken()}, "POST", "/ModelFacts", b'{"name": "m"}')  # type: ignore[dict-item]
    assert (status, told["error"]["type"]) == (500, "InternalError")
    assert "secret" not in told["error"]["message"]


def test_the_command_serves_what_the_service_says(
    settings: Settings, store: SqlStore, rotor: str, worker: Any, api: httpx.Client,
    post: Callable[..., int], reading: Callable[..., Inspection],
) -> None:  # fmt: skip
    post(rotor, reading("i1"))
    worker.drain()
    port = free_port()
    command = [sys.executable, "-m", "service.cli", "umbridge", "r1", "B1", "--port", str(port)]
    environ = {
        **os.environ,
        **settings.environ(),
        "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
    }
    process = subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(7)]
        version = api.get("/v1/rotors/r1").json()["version"]
        of = f"rotor r1, blade B1, version {version}"
        assert lines[0] == f"UM-Bridge at http://127.0.0.1:{port}: {of}\n"
        assert lines[1:3] == ["  elongation\n", "  elongation.posterior\n"]

        def answers() -> bool:
            with suppress(httpx.TransportError):
                return GET(f"http://127.0.0.1:{port}/Info").is_success
            return False

        until("an answer", answers)
        model = umbridge.HTTPModel(f"http://127.0.0.1:{port}", "deformation.posterior")
        told = model([[16_000.0]], {"node": 17})
        path = "/v1/rotors/r1/blades/B1/prediction?quantity=deformation&node=17&times=16000"
        said = api.get(path).json()
        assert told[0] == said["mean"][0]
        assert told[4] == said["upper"][0]
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(PATIENCE_S)
        process.stdout.close()


VENDOR = Path(__file__).parent / "vendor" / "umbridge"
JSONSCHEMA = """import jsonschema_rs


def validate(instance, schema):
    jsonschema_rs.validate(schema, instance)
"""


def conform(url: str, folder: Path, value: list[float]) -> subprocess.CompletedProcess[str]:
    """UM-Bridge's own test of a server (protocol 1.0), run as it stands."""
    for name in ("conftest.py", "test_model_schema.py"):
        (folder / name).write_text((VENDOR / f"{name}.txt").read_text())
    (folder / "jsonschema.py").write_text(JSONSCHEMA)  # the validator that is installed here
    asked = [f"--model_url={url}", "--input_value=" + str(value).replace(" ", "")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *asked]
    return subprocess.run(
        [*command, "test_model_schema.py"], cwd=folder, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(folder)},
    )  # fmt: skip


def test_the_server_conforms_by_the_protocol_s_own_test(url: str, tmp_path: Path) -> None:
    listed = (VENDOR / "VENDORED").read_text().splitlines()[1:]
    for line in listed:
        digest, name = line.split("  ")
        assert sha256((VENDOR / name).read_bytes()).hexdigest() == digest, name
    run = conform(url, tmp_path, PSI)
    assert run.returncode == 0, run.stdout[-3000:]
    assert re.search(r"\b\d{2,} passed", run.stdout), run.stdout
