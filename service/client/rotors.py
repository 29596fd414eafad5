"""Rotors and their blades, and waiting for them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import httpx

from service.client import answers
from service.client.errors import BlockedError, ProblemError
from service.client.steps import Call, Json, Pause, Steps, ask, head_seq, path, told

Blade = str | Mapping[str, Any]
LONGEST_S = 20.0  # of one long poll


def ready(patience_s: float = 30.0) -> Steps[None]:
    """Return as soon as the service is ready; TimeoutError when it does not become so."""
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        try:
            if (yield Call("GET", "/readyz")).status_code == 200:
                return
        except httpx.TransportError:
            pass
        yield Pause(0.05)
    raise TimeoutError(f"the service was not ready within {patience_s:g} s")


def create_rotor(
    rotor: str,
    *,
    blades: Sequence[Blade],
    model: str = "rotor-blade",
    particles: int | None = None,
    seed: int | None = None,
    network: Mapping[str, Any] | None = None,
    adopt: str | None = None,
    diagnose: str | None = None,
) -> Steps[answers.RotorMade]:
    """Create a rotor; a blade is an id or ``{"id", "slot"?, "lot"?, "known"?, …}``.

    network   what it varies of the model's network, e.g.
              ``{"quantities": {"elongation": {"by_instrument": True}}, "forgetting_h": 2e4}``
    adopt     ``effect``: a diagnosis that names an effect is adopted by itself
    diagnose  ``alarm``: residuals that alarm ask for a diagnosis by themselves; ``readings``: so do
              a quarter more readings
    """
    listed = [{"id": b} if isinstance(b, str) else dict(b) for b in blades]
    body: Json = {"id": rotor, "model": model, "blades": listed}
    body |= {} if particles is None else {"particles": particles}
    body |= {} if seed is None else {"seed": seed}
    body |= {} if network is None else {"network": dict(network)}
    body |= {} if adopt is None else {"adopt": adopt}
    body |= {} if diagnose is None else {"diagnose": diagnose}
    return ask("POST", path("rotors"), json=body)


def set_policy(
    rotor: str, *, adopt: str | None = None, diagnose: str | None = None
) -> Steps[answers.Standing]:
    """Decide what the rotor does by itself from now on; what is left out stays as it is.

    adopt, diagnose   as in `create_rotor`, or ``never``
    """
    body = {"adopt": adopt, "diagnose": diagnose}
    given = {name: value for name, value in body.items() if value is not None}
    return ask("POST", path("rotors", rotor, "policy"), json=given)


def rotors() -> Call:
    """Every rotor, by name, page by page."""
    return Call("GET", path("rotors"))


def rotor(rotor: str, *, version: int | None = None, at: str | None = None) -> Steps[answers.Rotor]:
    """The rotor as it stands; with a version or a moment, its blades and posterior then."""
    return ask("GET", path("rotors", rotor), params=told(version=version, at=at))


def versions(rotor: str) -> Call:
    """Versions that are kept, the newest first, page by page."""
    return Call("GET", path("rotors", rotor, "versions"))


def blades(
    rotor: str,
    *,
    quantity: str | None = None,
    time_h: float | None = None,
    node: int | str | None = None,
    version: int | None = None,
    at: str | None = None,
) -> Call:
    """Every blade at one hour: prediction and readings of each, page by page.

    time_h   hour of the prediction [h]; None: the model's last
    """
    params = told(quantity=quantity, time_h=time_h, node=node, version=version, at=at)
    return Call("GET", path("rotors", rotor, "blades"), params)


def add_blade(rotor: str, blade: Blade) -> Steps[int]:
    """Add a blade; the sequence number to wait for."""
    body = {"id": blade} if isinstance(blade, str) else dict(blade)
    return head_seq(ask("POST", path("rotors", rotor, "blades"), json=body))


def retire_blade(rotor: str, blade: str) -> Steps[int]:
    """A blade leaves; the sequence number to wait for."""
    return head_seq(ask("POST", path("rotors", rotor, "blades", blade, "retirement")))


def retry(rotor: str) -> Steps[answers.Standing]:
    """Let a blocked rotor be tried again."""
    return ask("POST", path("rotors", rotor, "retry"))


def wait_for(rotor: str, seq: int, patience_s: float = 120.0) -> Steps[answers.Rotor]:
    """The rotor once everything up to `seq` counts; BlockedError, TimeoutError."""
    end, longest = time.monotonic() + patience_s, LONGEST_S
    while (left := end - time.monotonic()) > 0:
        params = told(wait_for=seq, timeout=min(longest, left))
        try:
            answer: answers.Rotor = yield from ask("GET", path("rotors", rotor), params=params)
        except ProblemError as error:  # this service lets nobody wait so long
            if not longest or [one["field"] for one in error.faults] != ["timeout"]:
                raise
            longest = longest / 2 if longest > 0.5 else 0.0
            continue
        if answer["status"] == "blocked":
            raise BlockedError({**answer})
        if answer["version"] > 0 and answer["applied_seq"] >= seq:
            return answer
        if not longest:
            yield Pause(0.2)
    raise TimeoutError(f"rotor {rotor}: {seq} was not applied within {patience_s:g} s")


def wait_sealed(rotor: str, patience_s: float = 120.0) -> Steps[answers.Rotor]:
    """The rotor once its newest posterior is sealed."""
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        answer = yield from wait_for(rotor, 0, max(0.001, end - time.monotonic()))
        posterior = answer["posterior"]
        if posterior is not None and posterior["sealed"] and answer["status"] == "current":
            return answer
        yield Pause(0.05)
    raise TimeoutError(f"rotor {rotor} was not sealed within {patience_s:g} s")


def events(rotor: str, *, after: int | None = None, silence_s: float = 60.0) -> Call:
    """Hints as they come: ``{"id", "event", "rotor", "version", …}``; ends with the server.

    after   id of the last event known; None: begin with the newest. An event ``reset`` says
            that some in between are no longer kept: read the rotor again.
    silence_s   without even a heartbeat the connection is lost: httpx.ReadTimeout
    """
    return Call("GET", path("rotors", rotor, "events"), told(after=after), silence_s=silence_s)
