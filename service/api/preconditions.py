"""If-Match: a change is made only while the rotor stands as the caller saw it.

The ETag of ``GET /v1/rotors/{r}`` covers blades, place in the log, posterior version and status.
A state-changing request below a rotor may carry it in If-Match; inside the request's transaction,
with the rotor's row locked against readings and workers, the rotor is looked at once more, and 412
answers where it has moved on.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from starlette.requests import Request

from service.api.rotor_answers import view_out
from service.api.tags import named_tags, tag
from service.errors import PreconditionError
from service.handlers.rotors import view_in
from service.ports import Guard, Transaction


def rotor_tag(rotor_id: str, written: str) -> str:
    """The ETag of a rotor as it stands, however it was asked for; `written`: `text_of` it."""
    return tag(f"/v1/rotors/{rotor_id}", written)


def text_of(told: Mapping[str, Any]) -> str:
    """An answer as it is sent."""
    return json.dumps(told, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def guard_of(request: Request, rotor: str | None) -> Guard | None:
    """What a request's If-Match asks for; None: it has none.

    Where no rotor is named nothing can match.
    """
    given = ",".join(request.headers.getlist("if-match"))
    if not given:
        return None

    def guard(tx: Transaction) -> None:
        if rotor is None:
            raise PreconditionError("this route", "leave If-Match out")
        tx.log.lock(rotor)
        if "*" in given.split(","):
            return
        now = rotor_tag(rotor, text_of(view_out(view_in(tx, rotor))))
        if now not in named_tags(given, weak=False):
            remedy = f"GET /v1/rotors/{rotor}, look at what changed, and send its ETag"
            raise PreconditionError(f"rotor {rotor}", remedy)

    return guard
