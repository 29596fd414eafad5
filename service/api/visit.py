"""What the layers of the API know of one request, kept in its ASGI scope."""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass, field
from typing import Any

from service.access import Act, KeyRecord
from service.ports import Guard

PLACE = "bladetwin.visit"


@dataclass(slots=True)
class Visit:
    """One request on its way in and out.

    address   of the client; where a proxy on this machine says for whom it asks, of that one
    key       None: without a key, by the loopback
    act       for a state-changing request
    guard     what must hold when its transaction begins (If-Match)
    problem   kind of the problem that it was answered with
    headers   that its answer gets
    """

    request_id: str
    address: str | None
    key: KeyRecord | None = None
    act: Act | None = None
    guard: Guard | None = None
    problem: str | None = None
    headers: dict[str, str] = field(default_factory=dict)


def visit_of(scope: MutableMapping[str, Any]) -> Visit | None:
    """The visit of a request; None outside of the API's layers."""
    found: Visit | None = scope.get(PLACE)
    return found
