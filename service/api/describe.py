"""What the OpenAPI document tells beside the routes' own words: keys, scopes, headers, problems."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fastapi import FastAPI

from service.api.answers import ANSWERS
from service.api.files import FILES, contents
from service.api.scopes import RULES, STATE_CHANGING

Json = dict[str, Any]

SCHEME: Json = {
    "type": "http",
    "scheme": "bearer",
    "description": "An API key, made by `bladetwin keys create` on the server.",
}


def _header(name: str, meaning: str, **schema: Any) -> Json:
    told = {"type": "string"} | schema
    return {"name": name, "in": "header", "required": False, "schema": told, "description": meaning}


REPEAT = _header(
    "Idempotency-Key",
    "the same request with the same key is answered as the first time",
    pattern=r"^[\x21-\x7e]{1,255}$",
)
MATCH = _header("If-Match", "ETag of GET /v1/rotors/{r}: 412 where the rotor has moved on")
KNOWN = _header("If-None-Match", "ETag of an answer that the caller has: 304 where it holds")


def describe(app: FastAPI, *, keys: bool) -> None:
    """Complete the document of an application; `keys`: whether every request needs one."""
    plain: Callable[[], Json] = app.openapi

    def completed() -> Json:
        if app.openapi_schema is None:
            app.openapi_schema = complete(plain(), keys=keys)
        return app.openapi_schema

    app.openapi = completed  # type: ignore[method-assign]


def complete(document: Json, *, keys: bool) -> Json:
    """The document with security, headers and the true shape of refusals on every operation."""
    components = document.setdefault("components", {})
    components["securitySchemes"] = {"key": SCHEME}
    for name in ("HTTPValidationError", "ValidationError"):
        components.get("schemas", {}).pop(name, None)
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            _complete(f"{method.upper()} {path}", operation, keys)
    return document


def _complete(name: str, operation: Json, keys: bool) -> None:
    rule = RULES.get(name)
    scope = "none" if rule is None else rule.scope
    operation["security"] = [] if scope == "open" else [{"key": [scope]}] + [{}] * (not keys)
    operation["responses"].pop("422", None)
    for status in ("200", "201", "202"):
        if status in operation["responses"] and name in FILES and name not in ANSWERS:
            operation["responses"][status]["content"] = contents(name)
        if status in operation["responses"] and name in ANSWERS:
            told = {"application/json": {"schema": ANSWERS[name]}} | contents(name)
            operation["responses"][status]["content"] = told
    if scope == "open":
        return
    parameters = operation.setdefault("parameters", [])
    method, path = name.split(" ")
    if method == "GET":
        parameters.append(KNOWN)
        operation["responses"]["304"] = {"description": "As the caller has it"}
    if method in STATE_CHANGING:
        parameters += [REPEAT, MATCH] if "{r}" in path else [REPEAT]
