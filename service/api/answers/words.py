"""What schemas of answers are written with."""

from __future__ import annotations

from typing import Any

Json = dict[str, Any]

TEXT: Json = {"type": "string"}
WHOLE: Json = {"type": "integer"}
NUMBER: Json = {"type": "number"}
YES: Json = {"type": "boolean"}
ANY: Json = {"type": "object"}


def maybe(schema: Json) -> Json:
    """The value, or null."""
    return schema | {"type": [schema["type"], "null"]}


def each(schema: Json) -> Json:
    return {"type": "array", "items": schema}


def named(schema: Json) -> Json:
    """Values by name."""
    return {"type": "object", "additionalProperties": schema}


def having(optional: tuple[str, ...] = (), /, **fields: Json) -> Json:
    """An object with these fields and no other."""
    required = [name for name in fields if name not in optional]
    return {
        "type": "object",
        "properties": fields,
        "required": required,
        "additionalProperties": False,
    }


def paged(schema: Json) -> Json:
    """A page; `next` is the cursor of the one after it."""
    return having(items=each(schema), next=maybe(TEXT))
