"""What requests may hold. Unknown fields are refused, numbers are numbers and finite.

JSON's ``NaN`` and ``Infinity``, which some writers emit, are read and then refused by name.
"""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    StringConstraints,
)
from pydantic.config import JsonValue
from pydantic_core import PydanticCustomError

from service.hooks import Kind
from service.names import ID_PATTERN, TEXT_PATTERN

Id = Annotated[str, StringConstraints(max_length=100, pattern=ID_PATTERN)]


def _whole(text: str) -> str:
    if text != text.strip():
        raise PydanticCustomError("blank_end", "begins or ends with a blank")
    return text


Text = Annotated[
    str,
    StringConstraints(min_length=1, max_length=200, pattern=TEXT_PATTERN),
    AfterValidator(_whole),
]


def _moment(text: str) -> str:
    try:
        if datetime.fromisoformat(text).tzinfo is not None:
            return text
    except ValueError:
        pass
    raise PydanticCustomError("moment", "is no moment")


Moment = Annotated[
    str, StringConstraints(max_length=40, pattern=TEXT_PATTERN), AfterValidator(_moment)
]


class Body(BaseModel):
    """A body or a part of one."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class ModelIn(Body):
    """A model to register."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"builtin": "rotor-blade"}]})

    builtin: Id


HOOKS: list[JsonValue] = [
    {"id": "ops", "url": "https://plant.example/twin", "events": ["blocked", "alarm"]}
]


class WebhookIn(Body):
    """Where to send what happens to rotors; `events` and `rotors` left out: all."""

    model_config = ConfigDict(json_schema_extra={"examples": HOOKS})

    id: Id
    url: Annotated[str, StringConstraints(min_length=1, max_length=2000)]
    events: list[Kind] | None = Field(None, min_length=1, max_length=10)
    rotors: list[Id] | None = Field(None, min_length=1, max_length=10_000)


class Nothing(Body):
    """A body without fields."""
