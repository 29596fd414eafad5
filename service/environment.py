"""Settings from the environment: read, refused where unknown, handed on to child processes.

A setting is an environment variable ``BLADETWIN_<NAME>``; what is not set has its default. An
unknown ``BLADETWIN_…`` variable is refused, so that a misspelt one is never silently ignored. The
database's URL may stand in a file instead, so that its password is in nobody's environment.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from core.errors import InputError

PREFIX = "BLADETWIN_"
# Names under the prefix that belong to the tests and not to the service.
FOREIGN = frozenset({"BLADETWIN_CHROMIUM", "BLADETWIN_TEST_DATABASE_URL"})  # of the tests


class FromEnvironment(BaseModel):
    """Settings that are read from the environment, and the database's URL, which may be a secret;
    frozen."""

    model_config = ConfigDict(frozen=True, extra="forbid", hide_input_in_errors=True)

    database_url: str = Field(
        "sqlite:///bladetwin.db",
        description="where everything is kept: sqlite:///file.db or postgresql://user@host/name",
        repr=False,
    )
    database_url_file: str = Field(
        "", description="a file with that URL in it, for secrets; read in place of it"
    )

    @classmethod
    def load(cls, environ: Mapping[str, str] | None = None, **overrides: Any) -> Self:
        """Settings from the environment; `overrides` that are not None win."""
        environ = os.environ if environ is None else environ
        values: dict[str, Any] = {}
        for name, text in environ.items():
            if not name.startswith(PREFIX) or name in FOREIGN:
                continue
            field = name.removeprefix(PREFIX).lower()
            if field not in cls.model_fields:
                raise InputError(name, "…", "is no setting", f"use one of {', '.join(names(cls))}")
            values[field] = text
        if values.get("database_url_file"):
            values["database_url"] = _secret("database_url", values)
        values |= {name: value for name, value in overrides.items() if value is not None}
        try:
            return cls(**values)
        except ValidationError as error:
            first = error.errors()[0]
            name = PREFIX + str(first["loc"][0]).upper()
            shown = "…" if "URL" in name else values[str(first["loc"][0])]
            raise InputError(name, shown, f"does not fit: {first['msg']}", "correct it") from None

    def environ(self) -> dict[str, str]:
        """The same settings as environment variables, for a child process.

        A URL that was read from a file is read there again and not handed on.
        """
        given = self.model_dump(exclude={"database_url"} if self.database_url_file else None)
        return {
            PREFIX + name.upper(): str(value) for name, value in given.items() if value is not None
        }


def _secret(field: str, values: Mapping[str, Any]) -> str:
    """What the file says that stands for `field`: its text without white space around."""
    name = f"{PREFIX}{field.upper()}_FILE"
    path = values[f"{field}_file"]
    if field in values:
        raise InputError(
            name, path, f"and {PREFIX}{field.upper()} are both given", "unset one of them"
        )
    try:
        text = Path(path).read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        problem = f"cannot be read: {getattr(error, 'strerror', None) or 'it is no text'}"
        raise InputError(
            name, path, problem, f"let the user {os.geteuid()} of the service read it"
        ) from None
    if not text or "\n" in text:
        raise InputError(name, path, "does not hold one line", "write the value and nothing else")
    return text


def names(settings: type[BaseModel]) -> list[str]:
    """The environment variable of each setting."""
    return [PREFIX + name.upper() for name in settings.model_fields]


def table(settings: type[BaseModel]) -> list[tuple[str, str, str]]:
    """(variable, default, meaning) of each setting, for help and documents."""
    return [
        (
            PREFIX + name.upper(),
            "" if field.default is None else str(field.default),
            str(field.description),
        )
        for name, field in settings.model_fields.items()
    ]
