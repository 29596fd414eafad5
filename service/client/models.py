"""Models: registered, or trained on runs that are uploaded."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import httpx

from service.client import answers
from service.client.steps import Pause, Steps, ask, path, told
from service.names import listed


def models() -> Steps[list[answers.ModelListed]]:
    """Every model by name, version and digest."""
    found: list[answers.ModelListed] = []
    cursor: str | None = None
    while True:
        page = yield from ask("GET", path("models"), params=told(cursor=cursor))
        found += page["items"]
        cursor = page["next"]
        if cursor is None:
            return found


def model(name: str, version: str | None = None) -> Steps[answers.Model]:
    """A model: network, quantities, mesh, errors; version: None is the newest."""
    return ask("GET", path("models", name), params=told(version=version))


def surface(name: str) -> Steps[answers.Surface]:
    """The surface of a model's mesh: `points` [mm] and `triangles`."""
    return ask("GET", path("models", name, "surface"))


def register(builtin: str, patience_s: float = 600.0) -> Steps[answers.Model]:
    """A built-in model registered, and what it is; one that is there already stays as it is.

    Raises TimeoutError when it takes longer than `patience_s`, RuntimeError when it fails.
    """
    job: answers.Job = (yield from ask("POST", path("models"), json={"builtin": builtin}))["job"]
    end = time.monotonic() + patience_s
    while job["status"] in ("queued", "running"):
        if time.monotonic() > end:
            raise TimeoutError(f"{builtin} was not registered within {patience_s:g} s")
        yield Pause(0.1)
        job = yield from ask("GET", path("jobs", job["id"]))
    if job["status"] != "done":
        raise RuntimeError(f"{builtin} was not registered: {job}")
    return (yield from model(builtin))


def upload_model(
    name: str,
    runs: str | Path,
    network: bytes | str,
    *,
    leave_out: Sequence[str] = (),
    patience_s: float = 7200.0,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Steps[answers.Job]:
    """Runs and network sent, and the job when it has ended: ``status`` is done or failed.

    runs      a netCDF file (`core.archive.source`); network: its text, YAML or JSON
    progress  called with (what, done, total) as the training goes on
    Its ``result`` has ``version``, ``quality`` and ``warnings``, or ``faults`` and ``warnings``.

    Raises TimeoutError when it takes longer than `patience_s`.
    """
    fields = {"id": name} | ({"leave_out": listed(leave_out)} if leave_out else {})
    text = network.encode() if isinstance(network, str) else network
    parts = {"network": ("network.yaml", text), "runs": ("runs.nc", Path(runs).read_bytes())}
    form = httpx.Request("POST", "http://service", data=fields, files=parts)
    headers = {"content-type": form.headers["content-type"]}
    sent = ask("POST", path("models"), content=form.read(), headers=headers)
    job: answers.Job = (yield from sent)["job"]
    end = time.monotonic() + patience_s
    while job["status"] in ("queued", "running"):
        if time.monotonic() > end:
            raise TimeoutError(f"{name} was not trained within {patience_s:g} s")
        yield Pause(0.2)
        job = yield from ask("GET", path("jobs", job["id"]))
        if (now := job["progress"]) is not None:
            progress(now["what"], now["done"], now["total"])
    return job
