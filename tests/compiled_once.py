"""What is compiled by libraries once for each engine or call, kept for all tests of a process.

A server makes one engine and compiles each statement once; a program builds its command line once.
Tests open a database each and call many commands: of the time of a test of the service a quarter
went into compiling the same statements for the next engine, and much of a command's into its line.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import typer.testing
from sqlalchemy import Engine
from sqlalchemy.util import LRUCache


class Compiled(LRUCache[Any, Any]):
    """SQLAlchemy's cache of compiled statements, by the kind of dialect instead of the dialect."""

    def get(self, key: Any, default: Any = None) -> Any:
        return super().get(_of_kind(key), default)

    def __setitem__(self, key: Any, value: Any) -> None:
        super().__setitem__(_of_kind(key), value)


def _of_kind(key: tuple[Any, ...]) -> tuple[Any, ...]:
    dialect, *rest = key
    return (type(dialect), *rest)


def keep() -> None:
    """From now on: every engine has the same cache, and an application one command line."""
    statements = Compiled(2000)
    here = property(lambda engine: statements, lambda engine, own: None)
    Engine._compiled_cache = here  # type: ignore[assignment]
    typer.testing._get_command = cache(typer.testing._get_command)  # type: ignore[attr-defined]
