"""Typed clients of the REST service, for users' programs and for the demonstration.

with Client("http://127.0.0.1:8000") as twin:
    twin.create_rotor("r1", blades=["B01", "B02"])
    seq = twin.post_inspections("r1", [{"id": "i1", "blade": "B01", "quantity": "elongation",
                                        "time_h": 8000.0, "value": 0.11, "unit": "mm"}])
    twin.wait_for("r1", seq)
    bands = twin.prediction("r1", "B01", "elongation", times=[24000, 50000])

Answers are plain dicts whose fields type checkers know (`answers`); `frames` are of pandas and
xarray, `plots` of matplotlib. `AsyncClient` has the same methods, to be awaited. Both are one table
of calls (`table`) that are written once as steps without a connection (`steps`, and a module for
each noun) over two transports (`transports`).
"""

from __future__ import annotations

from service.client.errors import BlockedError, MissingError, ProblemError
from service.client.transports import AsyncClient, Client
from service.client.webhooks import read_webhook
from service.signing import SignatureError

__all__ = [
    "AsyncClient",
    "BlockedError",
    "Client",
    "MissingError",
    "ProblemError",
    "SignatureError",
    "read_webhook",
]
