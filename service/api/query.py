"""Query parameters: what a route does not know is refused, not passed over.

`?time=8000` on a route that takes `time_h` would else be answered at the default hour, as if it had
been asked for; and of `?time_h=1&time_h=2` one would be taken without a word. What a route takes is
what the document says, so that nothing has to be kept beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches

from fastapi import Request

from service.api.problems import Fault, fault, invalid

MOST, NEARBY = 50, 5  # parameters of one request; names that are compared with those known
BELOW = "/v1/"  # health, metrics and pages are asked by programs with parameters of their own
Takes = Mapping[str, bool]  # a parameter's name: whether it may be given more than once


def takes(document: Mapping[str, object], path: str, method: str) -> Takes:
    """The query parameters of one operation of an OpenAPI document.

    >>> get = {"parameters": [{"in": "query", "name": "at", "schema": {"type": "string"}}]}
    >>> takes({"paths": {"/v1/x": {"get": get}}}, "/v1/x", "GET")
    {'at': False}
    """
    operations = document["paths"][path]  # type: ignore[index]
    told = operations[method.lower()].get("parameters", [])
    return {
        one["name"]: one.get("schema", {}).get("type") == "array"
        for one in told
        if one["in"] == "query"
    }


async def known_query(request: Request) -> None:
    """(Awaited, as every dependency here: FastAPI sends others through a thread, for each request.)

    Raises a problem 422 for parameters that the route does not take, or takes once."""
    given = request.query_params.multi_items()
    if not given or not request.url.path.startswith(BELOW):
        return
    route = request.scope["route"].path_format
    known = takes(request.app.openapi(), route, request.method)
    if (count := sum(not known.get(name) for name, _ in given)) > MOST:
        told = "are too many parameters"
        raise invalid([fault("query", count, told, f"give {MOST} at most, each once")])
    faults: list[Fault] = []
    seen: set[str] = set()
    for name, value in given:
        if name not in known:
            near = known if len(faults) < NEARBY and len(name) <= 100 else {}
            remedy = _instead(name, near, known)
            faults.append(fault(name, value, "is no parameter of this route", remedy))
        elif name in seen and not known[name]:
            faults.append(fault(name, value, "is given more than once", "give it once"))
        seen.add(name)
    if faults:
        raise invalid(faults)


def _instead(name: str, near: Takes, known: Takes) -> str:
    if found := get_close_matches(name, near, 1, 0.5):
        return f"use {found[0]}"
    return f"use {', '.join(known)}" if known else "leave it out: this route takes none"
