"""Fields that an object of a JSON body has twice.

Readers of JSON take the last without a word, and a reading would lose a value; columns of CSV and
parameters of a query are refused alike.

The parser keeps no trace of it. But outside of a text a quote before a colon ends a field's name,
and inside of one every quote stands behind a backslash: so names are counted in the body, and where
there are more than fields in what was read, the body is read again to find which. (A name that
itself ends with a backslash is not counted, and may be missed.)

Readings are held against it where they are read, each under its own media type; every other route
by `given_once`, on which it depends.
"""

from __future__ import annotations

import json
import re
from typing import Any

from fastapi import Request

from service.api.problems import MOST_FAULTS, Fault, fault, invalid

JSON = ("", "application/json")
NAMES, INSIDE = re.compile(rb'"\s*:'), re.compile(rb'\\"\s*:')
REMEDY = "give it once"


async def given_once(request: Request) -> None:
    """Raises a problem 422 for fields that an object of a JSON body has more than once.

    What is no JSON is the route's to refuse.
    """
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if request.method != "POST" or kind not in JSON or not (body := await request.body()):
        return
    try:
        data = json.loads(body)
    except (ValueError, RecursionError):
        return
    refuse_repeated(body, data)


def refuse_repeated(body: bytes, data: object) -> None:
    """RequestError names each field that an object of a body has more than once, and its values.

    data   what was read of the body
    """
    if names(body) <= shallow(data) or names(body) <= fields(data):
        return
    if found := repeated(body):
        raise invalid(found)


def names(body: bytes) -> int:
    r"""How many names of fields a body has.

    >>> names(b'{"a": 1, "b" : "x\\":"}')
    2
    """
    return len(NAMES.findall(body)) - len(INSIDE.findall(body))


def shallow(data: object) -> int:
    """Fields of a batch of readings, or of one, that have no objects in them; no more than there
    are."""
    if not isinstance(data, dict):
        return 0
    rows = data.get("inspections")
    rows = rows if isinstance(rows, list) else []
    return len(data) + sum(len(row) for row in rows if isinstance(row, dict))


def fields(data: object) -> int:
    """Fields of all objects in what was read.

    >>> fields([{"a": [[{"b": 1}]], "c": {}}])
    3
    """
    count, left = 0, [data]
    while left:
        one = left.pop()
        if isinstance(one, dict):
            count += len(one)
            left += one.values()
        elif isinstance(one, list):
            left += [part for part in one if isinstance(part, (dict, list))]
    return count


def repeated(body: bytes) -> list[Fault]:
    """A fault for each field that comes twice in one object.

    >>> [(one["field"], one["value"]) for one in repeated(b'[{"a": 1, "b": 2, "a": 3}, {"a": 1}]')]
    [('a', '[1, 3]')]
    """
    found: list[Fault] = []

    def seen(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        told = dict(pairs)
        if len(told) < len(pairs) and len(found) <= MOST_FAULTS:
            for name in told:
                values = [value for own, value in pairs if own == name]
                if len(values) > 1:
                    found.append(fault(name, values, "is given more than once", REMEDY))
        return told

    json.loads(body, object_pairs_hook=seen)
    return found
