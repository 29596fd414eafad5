"""UM-Bridge 1.0 without a connection: a path and a JSON body in, a status and a JSON answer out.

    GET  /Info                               → protocolVersion, names of the models
    POST /ModelInfo    {name}                → what of the protocol a model supports
    POST /ModelFacts   {name}                → not of the protocol: names, units and bounds of the
                                               inputs, outputs, what a posterior rests on
    POST /InputSizes   {name, config}        → lengths of its input vectors
    POST /OutputSizes  {name, config}        → lengths of its output vectors
    POST /Evaluate     {name, input, config} → its output vectors

Errors are ``{"error": {"type", "message"}}``: ModelNotFound, InvalidInput, UnsupportedFeature,
InternalError. A config with a field that a model does not know is refused, as is a body with one.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from core.errors import BladetwinError, InputError
from service.errors import FaultsError

log = logging.getLogger("bladetwin.umbridge")
Json = dict[str, Any]
Vectors = list[list[float]]
FIELDS = {
    "/ModelInfo": {"name"},
    "/ModelFacts": {"name"},
    "/InputSizes": {"name", "config"},
    "/OutputSizes": {"name", "config"},
    "/Evaluate": {"name", "config", "input"},
}
UNSUPPORTED = ("Gradient", "ApplyJacobian", "ApplyHessian")


class Served(Protocol):
    """A model as the protocol sees it; a config holds the model's own settings."""

    def info(self) -> Json:
        """What it is, beside what the protocol asks for."""
        ...

    def input_sizes(self, config: Json) -> list[int]: ...
    def output_sizes(self, config: Json) -> list[int]: ...
    def evaluate(self, inputs: Vectors, config: Json) -> Vectors: ...


class _RefusedError(Exception):
    def __init__(self, kind: str, message: str, status: int = 400) -> None:
        self.answer = status, {"error": {"type": kind, "message": message}}
        super().__init__(message)


def answer(models: Mapping[str, Served], method: str, path: str, body: bytes) -> tuple[int, Json]:
    """Status and answer of one request; no exception leaves it."""
    try:
        return 200, _answer(models, method, path, body)
    except _RefusedError as error:
        return error.answer
    except (InputError, FaultsError) as error:
        return _RefusedError("InvalidInput", str(error)).answer
    except BladetwinError as error:
        log.error("%s %s: %s", method, path, error)
        return _RefusedError("InternalError", str(error), 500).answer
    except Exception:
        log.exception("%s %s failed", method, path)
        return _RefusedError("InternalError", "it failed; the log says why", 500).answer


def _answer(models: Mapping[str, Served], method: str, path: str, body: bytes) -> Json:
    if path == "/Info":
        if method != "GET":
            raise _RefusedError("InvalidInput", f"{method} /Info: use GET", 405)
        return {"protocolVersion": 1.0, "models": list(models)}
    if path.removeprefix("/") in UNSUPPORTED:
        raise _RefusedError("UnsupportedFeature", f"{path} is not supported by these models")
    if path not in FIELDS:
        known = ", ".join(["/Info", *FIELDS])
        raise _RefusedError("UnsupportedFeature", f"{path} is not served here: use {known}", 404)
    if method != "POST":
        raise _RefusedError("InvalidInput", f"{method} {path}: use POST", 405)
    asked = _object(body, FIELDS[path])
    model = models.get(str(asked.get("name")))
    if model is None:
        named = ", ".join(models)
        raise _RefusedError("ModelNotFound", f"no model {asked.get('name')!r}: use one of {named}")
    if path == "/ModelInfo":
        support = {"Evaluate": True} | dict.fromkeys(UNSUPPORTED, False)
        return {"support": support}
    if path == "/ModelFacts":
        return model.info()
    config = asked.get("config") or {}
    if not isinstance(config, dict):
        raise _RefusedError("InvalidInput", "config is no JSON object")
    if path == "/InputSizes":
        return {"inputSizes": model.input_sizes(config)}
    if path == "/OutputSizes":
        return {"outputSizes": model.output_sizes(config)}
    vectors = _vectors(asked.get("input"), model.input_sizes(config))
    return {"output": model.evaluate(vectors, config)}


def _object(body: bytes, fields: set[str]) -> Json:
    try:
        asked = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise _RefusedError("InvalidInput", f"the body is no JSON: {error}") from None
    if not isinstance(asked, dict):
        raise _RefusedError("InvalidInput", "the body is no JSON object")
    if unknown := sorted(asked.keys() - fields):
        known = ", ".join(sorted(fields))
        raise _RefusedError("InvalidInput", f"{unknown[0]!r} is not known here: use {known}")
    return asked


def _vectors(given: Any, sizes: Sequence[int]) -> Vectors:
    if not isinstance(given, list) or len(given) != len(sizes):
        told = len(given) if isinstance(given, list) else "none"
        raise _RefusedError(
            "InvalidInput", f"input: {len(sizes)} vectors are asked for, not {told}"
        )
    for i, (vector, size) in enumerate(zip(given, sizes, strict=True)):
        if not isinstance(vector, list) or len(vector) != size:
            told = len(vector) if isinstance(vector, list) else "none"
            raise _RefusedError(
                "InvalidInput", f"input {i}: {size} numbers are asked for, not {told}"
            )
        for value in vector:
            if number(value) is None:
                raise _RefusedError("InvalidInput", f"input {i}: {value!r} is no finite number")
    return [[float(value) for value in vector] for vector in given]


def number(value: Any) -> float | None:
    """A finite number of JSON as a float; None: it is none.

    >>> number(2), number(True), number("2"), number(float("nan")), number(10**400)
    (2.0, None, None, None, None)
    """
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:
        return None
