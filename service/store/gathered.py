"""Many rows fetched as one.

SQLite's driver gives up the interpreter's lock at every row and has to win it back, which under
load takes until another thread lets it go: up to `sys.getswitchinterval()`. A hundred rows wait a
hundred times, the more threads the longer, and a burst of requests turns into a standstill that
feeds itself. So what nearly every request reads comes as a single row, a JSON array of arrays.
(PostgreSQL's driver fetches a result at once.)

A text has another use, on both databases: whoever made something of it remembers what, and needs to
look at no row of it again (`Gathered.told`). PostgreSQL's JSON has every digit.

SQLite writes real numbers as decimals that do not always read back as the same number. So a real
number x comes as two integers: its whole part i, and g = (x - i) 2⁶². All of this arithmetic is
exact for 0 and |x| >= 2⁻¹⁰, which SQLite itself confirms; where it does not, the rows come one by
one.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Connection,
    Double,
    Integer,
    ScalarSelect,
    Select,
    String,
    Text,
    case,
    cast,
    func,
    literal,
    null,
    select,
)

PARTS = 2**62


class Told(NamedTuple):
    """Rows as a text; `split`: a real number comes as two integers."""

    text: str
    split: bool


class Gathered:
    """A query for rows of text and numbers, in no order; TypeError: a column is of another type."""

    def __init__(self, query: Select[Any]) -> None:
        inner = query.subquery()
        for column in inner.c:
            if not isinstance(column.type, (Integer, String, Double)):
                raise TypeError(f"column {column.name} is {column.type!r}: no text, no number")
        self._rows = query
        self._real = [isinstance(column.type, Double) for column in inner.c]
        rows = func.json_agg(func.json_build_array(*inner.c))
        told = [part for column in inner.c for part in _told(column)]
        self._one = {
            False: select(func.coalesce(cast(rows, Text), "[]")),
            True: select(func.json_group_array(func.json_array(*told))),
        }

    def rows(self, connection: Connection, asked: Mapping[str, object]) -> list[tuple[Any, ...]]:
        """The values of each row, as the query alone would give them."""
        if connection.dialect.name == "sqlite":
            try:
                return self.read(self.told(connection, asked))
            except InexactError:
                pass
        return self.single(connection, asked)

    def single(self, connection: Connection, asked: Mapping[str, object]) -> list[tuple[Any, ...]]:
        """The rows, one by one."""
        return [tuple(row) for row in connection.execute(self._rows, asked).all()]

    def told(self, connection: Connection, asked: Mapping[str, object]) -> Told:
        """All rows as one text: who made something of an equal one need not do so again."""
        split = connection.dialect.name == "sqlite"
        return Told(str(connection.execute(self._one[split], asked).scalar_one()), split)

    def column(self, split: bool) -> ScalarSelect[Any]:
        """The text as a column of another query's row; `split` as in `Told`, for SQLite."""
        return self._one[split].scalar_subquery()

    def read(self, told: Told) -> list[tuple[Any, ...]]:
        """The rows of a text; InexactError: it does not hold all of their numbers exactly."""
        parts = self._joined if told.split else self._plain
        return [tuple(parts(row)) for row in json.loads(told.text)]

    def _plain(self, row: list[Any]) -> Iterator[Any]:
        for real, value in zip(self._real, row, strict=True):
            yield float(value) if real and value is not None else value

    def _joined(self, row: list[Any]) -> Iterator[Any]:
        parts = iter(row)
        for real in self._real:
            value = next(parts)
            if not real:
                yield value
                continue
            fraction = next(parts)
            if value is None and fraction is not None:
                raise InexactError
            yield None if value is None else float(value) + fraction / PARTS


class InexactError(Exception):
    """A real number that its two integers do not give."""


def _told(column: ColumnElement[Any]) -> tuple[ColumnElement[Any], ...]:
    """A column as integers and text; a number that would not be exact: (NULL, 0)."""
    if not isinstance(column.type, Double):
        return (column,)
    whole = cast(column, BigInteger)
    parts = cast((column - whole) * literal(float(PARTS)), BigInteger)
    exact = whole + cast(parts, Double) / literal(float(PARTS)) == column
    missing = column.is_(None)
    return (
        case((exact, whole), else_=null()),
        case((missing, null()), (exact, parts), else_=literal(0)),
    )
