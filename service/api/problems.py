"""Problem details (RFC 9457): the one shape of every error.

``type`` names the kind, ``detail`` says what is wrong in a sentence, and ``faults`` lists each
fault with ``field``, ``value``, ``problem`` and ``remedy``, so that a program need not read the
sentence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from fastapi import Request
from fastapi.responses import JSONResponse

from core.errors import InputError
from service.api import known_fields
from service.api.visit import visit_of
from service.errors import MOST_FAULTS as MOST_FAULTS
from service.names import TEXT_PATTERN, TITLE_PATTERN
from service.tokens import redacted

LONGEST = 200
MOST_READINGS = 100_000  # of one body
Fault = dict[str, Any]


class RequestError(Exception):
    """A request that is refused before any use case: status, kind, and what to do."""

    def __init__(self, status: int, kind: str, detail: str, faults: Sequence[Fault] = ()) -> None:
        self.status = status
        self.kind = kind
        self.detail = detail
        self.faults = list(faults)
        super().__init__(detail)


def said(text: str) -> str:
    r"""Text from outside as an answer can carry it: without tokens and halves of characters.

    >>> said("a\ud800b")
    'a?b'
    """
    return redacted(text.encode("utf-8", "replace").decode())


def shown(value: object) -> object:
    """A value as JSON can carry it, and not longer than a line or two.

    >>> shown(float("nan")), shown("x" * 1000)[-1]
    ('NaN', '…')
    """
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if value is None or isinstance(value, (bool, float)):
        return value
    if isinstance(value, int) and abs(value) < 2**63:
        return value
    if isinstance(value, int):
        return "an integer of more than 64 bits"
    text = said(value if isinstance(value, str) else repr(value))
    return text if len(text) <= LONGEST else text[:LONGEST] + "…"


def fault(field: str, value: object, problem: str, remedy: str) -> Fault:
    told = {"problem": said(problem), "remedy": said(remedy)}
    return {"field": said(field), "value": shown(value)} | told


def document(
    status: int, kind: str, detail: str, instance: str, faults: Sequence[Fault] = ()
) -> dict[str, Any]:
    """The body of an answer for one error."""
    return {
        "type": f"urn:bladetwin:problem:{kind}",
        "title": kind.replace("-", " "),
        "status": status,
        "detail": said(detail),
        "instance": instance,
        "faults": list(faults),
    }


def problem(
    request: Request,
    status: int,
    kind: str,
    detail: str,
    faults: Sequence[Fault] = (),
    headers: Mapping[str, str] | None = None,
    instance: str | None = None,
) -> JSONResponse:
    """The answer for one error. `instance` is the request's path where nothing else is given."""
    visit = visit_of(request.scope)
    if visit is not None:
        visit.problem = kind
    body = document(
        status, kind, detail, said(request.url.path) if instance is None else instance, faults
    )
    return JSONResponse(
        body, status, media_type="application/problem+json", headers=dict(headers or {})
    )


def invalid(faults: Sequence[Fault]) -> RequestError:
    """422 with every fault, up to `MOST_FAULTS`; the sentence is the first one's."""
    first, faults = faults[0], bounded(faults)
    text = (
        f"{first['field']} = {first['value']!r}: {first['problem']}. To mend it: {first['remedy']}"
    )
    more = f"; and {len(faults) - 1} more" if len(faults) > 1 else ""
    return RequestError(422, "invalid-input", text + more, faults)


def bounded(faults: Sequence[Fault]) -> Sequence[Fault]:
    """The first `MOST_FAULTS`, and one that says that there are more."""
    if len(faults) <= MOST_FAULTS:
        return faults
    told = f"has more than {MOST_FAULTS} faults, of which these are the first"
    remedy = "mend these and post again to hear of the others"
    return [*faults[:MOST_FAULTS], fault("body", None, told, remedy)]


def too_many(count: int, most: int) -> RequestError:
    """422 for a body of more readings than it may hold."""
    return invalid([fault("inspections", count, f"are above {most}", f"post {most} at a time")])


def fault_of(error: InputError) -> Fault:
    return fault(error.what, error.value, error.problem, error.remedy)


NUMBER = "write a bare number with a decimal point, e.g. 0.41 (no comma, unit or quotes)"
WHOLE = "write a whole number, e.g. 3 (no point, comma, unit or quotes)"
OBJECT = "write an object with its fields, {…}"
REMEDIES = {
    "missing": "give it",
    "float_type": f"{NUMBER}; leave out what is not known",
    "float_parsing": NUMBER,
    "int_type": WHOLE,
    "int_parsing": WHOLE,
    "string_type": "write it as text, in double quotes",
    "moment": "write it with its offset, e.g. 2031-05-04T10:00:00Z",
    "no_value": "give it, or leave the reading out; of a scan give `values` with `nodes`",
    "two_values": "give one of them",
    "finite_number": "give a finite number; leave readings that failed out",
    "string_pattern_mismatch": "use letters, digits and . _ : @ + - (no slash, no space)",
    "blank_end": "leave the blank out: with it the text names something else",
    "literal_error": "use one of these",
    "model_type": OBJECT,
    "model_attributes_type": OBJECT,
}
ONE_LINE = "write one line of text, without tabs and other control characters"
PATTERNS = {
    TEXT_PATTERN: ONE_LINE,
    TITLE_PATTERN: "use letters, digits, blanks and _ + -, a letter or a digit first",
}
VALUED = {"no_value": "value", "two_values": "value"}  # faults of a whole reading, by the field
NOT_THERE = frozenset({"missing", *VALUED})
TAGS = frozenset({"vector", "scalar"})
PLACES = frozenset({"body", "query", "path", "header"})


def faults_of_validation(errors: Sequence[Any], kind: Any, prefix: str = "") -> list[Fault]:
    """The faults that pydantic found in a body of a type, under the names that the caller wrote."""
    return [
        fault(
            prefix + (VALUED.get(error["type"]) or _field(error["loc"])),
            None if error["type"] in NOT_THERE else error.get("input"),
            _problem(error["msg"]),
            _remedy(error, kind),
        )
        for error in errors
    ]


def _remedy(error: Any, kind: Any) -> str:
    if error["type"] == "extra_forbidden":
        return known_fields.remedy(kind, _inside(error["loc"]))
    by_pattern = PATTERNS.get(error.get("ctx", {}).get("pattern"))
    return by_pattern or REMEDIES.get(error["type"], "correct the value")


def _problem(told: str) -> str:
    """What pydantic says, without its own word for what a check of ours said.

    >>> _problem("Value error, holds no face"), _problem("Field required")
    ('holds no face', 'field required')
    >>> _problem("Extra inputs are not permitted")
    'is not known here'
    """
    told = told.removeprefix("Value error, ")
    told = told.replace("Extra inputs are not permitted", "is not known here")
    return told[:1].lower() + told[1:]


def _inside(loc: Sequence[str | int]) -> Sequence[str | int]:
    """Without the part of the request that it is in."""
    return loc[1:] if len(loc) > 1 and loc[0] in PLACES else loc


def _field(loc: Sequence[str | int]) -> str:
    text = ""
    for part in _inside(loc):
        if isinstance(part, int):
            text += f"[{part}]"
        elif part not in TAGS:
            text += f".{part}" if text else part
    return text or "body"
