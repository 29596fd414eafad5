"""Models."""

from __future__ import annotations

import time

from service.client.steps import Json, Pause, Steps, ask, part, path


def models() -> Steps[list[Json]]:
    """Every model by name, version and digest."""
    return part(ask("GET", path("models")), "items")


def model(name: str) -> Steps[Json]:
    """A model: network, quantities, mesh, errors."""
    return ask("GET", path("models", name))


def surface(name: str) -> Steps[Json]:
    """The surface of a model's mesh: `points` [mm] and `triangles`."""
    return ask("GET", path("models", name, "surface"))


def register(builtin: str, patience_s: float = 600.0) -> Steps[Json]:
    """A built-in model registered, and what it is; one that is there already stays as it is.

    Raises TimeoutError when it takes longer than `patience_s`, RuntimeError when it fails.
    """
    job: Json = (yield from ask("POST", path("models"), json={"builtin": builtin}))["job"]
    end = time.monotonic() + patience_s
    while job["status"] in ("queued", "running"):
        if time.monotonic() > end:
            raise TimeoutError(f"{builtin} was not registered within {patience_s:g} s")
        yield Pause(0.1)
        job = yield from ask("GET", path("jobs", job["id"]))
    if job["status"] != "done":
        raise RuntimeError(f"{builtin} was not registered: {job}")
    return (yield from model(builtin))
