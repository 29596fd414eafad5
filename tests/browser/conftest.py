"""A real service with a real rotor, made once for a module, and a headless Chromium on its pages.

Where no Chromium is found the tests are skipped and say so; `.ci/run` installs one.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright
from sqlalchemy import text

from core.model import rotor_blade
from service.free_port import free_port
from service.store.engine import open_engine, transaction
from tests.patience import PATIENCE_S
from tests.service.told import told

ARGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PATIENCE_MS = 1e3 * PATIENCE_S  # others may keep the machine busy
expect.set_options(timeout=PATIENCE_MS)
HOSTILE = '<img src=x onerror="alert(1)">'


def find_chromium() -> str | None:
    """BLADETWIN_CHROMIUM, or the system's."""
    given = os.environ.get("BLADETWIN_CHROMIUM")
    return given or next((found for name in NAMES if (found := shutil.which(name))), None)


@dataclass(frozen=True)
class Running:
    """A service on the loopback and its database."""

    url: str
    database: str
    client: httpx.Client

    @contextmanager
    def changed(self, table: str, values: str, back: str, where: str) -> Iterator[None]:
        """A row changed for the time of a test, as if something had gone wrong there."""
        for part, last in ((values, False), (back, True)):
            engine = open_engine(self.database)
            with transaction(engine, write=True) as connection:
                connection.execute(text(f"UPDATE {table} SET {part} WHERE {where}"))
            engine.dispose()
            if not last:
                yield


def scan() -> dict[str, Any]:
    """A scan of B2, as the model would have it in the middle of its ranges."""
    surrogate = rotor_blade().part("deformation")
    middle = [[(one.low + one.high) / 2 for one in surrogate.inputs]]
    nodes = list(range(40, 5600, 400))
    mean, _ = surrogate.predict(np.array(middle), "deformation", np.array([16000.0]), nodes)
    values = mean[0, 0].tolist()
    given = {"quantity": "deformation", "time_h": 16000, "unit": "mm", "sigma": 0.02}
    return {"id": "scan", "blade": "B2", "nodes": nodes, "values": values, **given}


def reading(name: str, blade: str, hours: float, value: float, **more: Any) -> dict[str, Any]:
    told = {"quantity": "elongation", "time_h": hours, "value": value, "unit": "mm"}
    return {"id": name, "blade": blade, "instrument": "gauge", "campaign": "outage", **told, **more}


def fill(client: httpx.Client) -> None:
    """Three blades with readings: late, corrected, retracted; a fourth with none."""
    blades = [{"id": f"B{i}", "slot": str(i), "lot": HOSTILE} for i in (1, 2, 3, 4)]
    rotor = {"id": "r1", "model": "rotor-blade", "particles": 200, "blades": blades}
    client.post("/v1/rotors", json=rotor).raise_for_status()
    sent = [
        reading("a", "B1", 16000, 0.24),
        reading("late", "B1", 8000, 0.17, campaign=HOSTILE),
        reading("wrong", "B1", 24000, 0.55),
        reading("right", "B1", 24000, 0.30, replaces="wrong"),
        reading("gone", "B1", 20000, 0.45),
        reading("b", "B2", 16000, 0.21),
        reading("c", "B3", 16000, 0.26),
        scan(),
    ]
    client.post("/v1/rotors/r1/inspections", json={"inspections": sent}).raise_for_status()
    head = client.post("/v1/rotors/r1/inspections/gone/retraction").json()["head_seq"]
    sealed(client, head)


def sealed(client: httpx.Client, seq: int, rotor: str = "r1") -> None:
    end = time.monotonic() + 2 * PATIENCE_S
    while time.monotonic() < end:
        now = client.get(f"/v1/rotors/{rotor}", params={"wait_for": seq, "timeout": 20}).json()
        if now["applied_seq"] >= seq and now["posterior"] and now["posterior"]["sealed"]:
            return
        time.sleep(0.2)
    raise TimeoutError(f"the rotor is not sealed through {seq}: {now['status']}")


@contextmanager
def serving(folder: Path, workers: int = 1) -> Iterator[Running]:
    """The service of the blade physics on an empty database in `folder`."""
    port, database = free_port(), f"sqlite:///{folder / 'pages.db'}"
    given = {"DATABASE_URL": database, "PORT": str(port), "DIAGNOSERS": "0"}
    given |= {
        "WORKERS": str(workers),
        "SEALERS": "0",
        "HEARTBEAT_S": "1",
    }  # no process that all others go before
    env = os.environ | {f"BLADETWIN_{name}": value for name, value in given.items()}
    command = [sys.executable, "-P", "-m", "service.cli", "serve"]
    with (folder / "log").open("wb") as log:
        server = subprocess.Popen(command, env=env, stdout=log, stderr=log, cwd=folder)
    url = f"http://127.0.0.1:{port}"
    try:
        with httpx.Client(base_url=url, timeout=60, verify=False) as client:
            end = time.monotonic() + 3 * PATIENCE_S
            while True:
                try:
                    if client.get("/readyz").status_code == 200:
                        break
                except httpx.TransportError:
                    pass
                assert time.monotonic() < end, (folder / "log").read_text()[-2000:]
                assert server.poll() is None, (folder / "log").read_text()[-2000:]
                time.sleep(0.1)
            yield Running(url, database, client)
    finally:
        server.terminate()
        server.wait(PATIENCE_S)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with serving(tmp_path_factory.mktemp("service")) as running:
        fill(running.client)
        yield running


@pytest.fixture(scope="module")
def diagnosis(service: Running) -> str:
    """A diagnosis that ended with an effect; its result is written as a worker would."""
    tried = [{"what": HOSTILE, "log_bf": 6.4}, {"what": "fouling, all", "log_bf": -0.4}]
    return ended(service, told("effect", campaign="outage", tried=tried))


def ended(service: Running, result: dict[str, Any]) -> str:
    """A diagnosis that has this result."""
    path = "/v1/rotors/r1/diagnoses"
    made = service.client.post(path, json={"compare": True}).json()["diagnosis"]["id"]
    engine = open_engine(service.database)
    with transaction(engine, write=True) as connection:
        done = "UPDATE job SET status='done', result=:result, finished_at=created_at WHERE id=:id"
        connection.execute(text(done), {"result": json.dumps(result), "id": made})
    engine.dispose()
    return str(made)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    path = find_chromium()
    if path is None:
        pytest.skip("no chromium on this system: apt-get install chromium, or BLADETWIN_CHROMIUM")
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=path, args=list(ARGS), timeout=PATIENCE_MS
        )
        yield opened
        opened.close()


def comes(page: Page, true: Callable[[], object]) -> bool:
    """Whether something comes, for which the page, and what listens to it, has its time."""
    end = time.monotonic() + PATIENCE_S
    while not (there := true()) and time.monotonic() < end:
        page.wait_for_timeout(20)
    return bool(there)


@dataclass
class Watched:
    """A page of the browser, and what it did that it should not.

    errors    of the console and of scripts
    outside   requests to other places than the service
    """

    page: Page
    service: Running
    errors: list[str] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)

    def open(self, path: str, *, state: str = "ready") -> Page:
        """The page once it stands, with what it said until then."""
        self.page.goto(self.service.url + path)
        self.page.wait_for_selector(f"body[data-state={state}]", state="attached")
        return self.page


@pytest.fixture
def watched(browser: Browser, service: Running) -> Iterator[Watched]:
    yield from watching(browser, service)


def watching(browser: Browser, service: Running) -> Iterator[Watched]:
    """A page of its own on a service, until the test ends."""
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    seen = Watched(page, service)
    page.on("pageerror", lambda error: seen.errors.append(str(error)))
    page.on("console", lambda said: seen.errors.append(said.text) if said.type == "error" else None)
    page.on(
        "request",
        lambda asked: (
            None
            if asked.url.startswith((service.url, "blob:", "data:"))
            else seen.outside.append(asked.url)
        ),
    )
    yield seen
    page.unroute_all(behavior="ignoreErrors")  # a page that asks again while it closes
    context.close()
