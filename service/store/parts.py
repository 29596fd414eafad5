"""Parts of a stored JSON text, taken out by the database: lists of long texts read none whole."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Boolean, Text, literal_column
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement


class json_parts(FunctionElement[str]):
    """``json_parts(column, name, …)``: the values of these members, as the text of a JSON array.

    NULL, or an array of nulls, where there is no text. Names are constants of the program.
    """

    type = Text()
    inherit_cache = False

    def __init__(self, column: Any, *names: str) -> None:
        assert len(names) > 1
        assert all(name.isidentifier() for name in names)
        self.names = names
        super().__init__(column)


@compiles(json_parts, "sqlite")
def _parts_sqlite(element: Any, compiler: Any, **kw: Any) -> str:
    paths = ", ".join(f"'$.{name}'" for name in element.names)
    return f"json_extract({compiler.process(element.clauses, **kw)}, {paths})"


@compiles(json_parts, "postgresql")
def _parts_postgresql(element: Any, compiler: Any, **kw: Any) -> str:
    text = compiler.process(element.clauses, **kw)
    values = ", ".join(f"({text})::json -> '{name}'" for name in element.names)
    return f"json_build_array({values})::text"


class without_long(FunctionElement[str]):
    """``without_long(column, most)``: a reading's text; with more than `most` values their
    ``count`` instead of values and nodes.
    """

    type = Text()
    inherit_cache = True

    def __init__(self, column: Any, most: int) -> None:
        super().__init__(column, literal_column(str(most)))


# A value takes two characters at least, so that most texts need not be looked into.
@compiles(without_long, "sqlite")
def _short_sqlite(element: Any, compiler: Any, **kw: Any) -> str:
    text, most = (compiler.process(clause, **kw) for clause in element.clauses)
    count = f"json_array_length({text}, '$.values')"
    return (
        f"CASE WHEN length({text}) > 2 * {most} AND {count} > {most} THEN "
        f"json_set(json_remove({text}, '$.values', '$.nodes'), '$.count', {count}) ELSE {text} END"
    )


@compiles(without_long, "postgresql")
def _short_postgresql(element: Any, compiler: Any, **kw: Any) -> str:
    text, most = (compiler.process(clause, **kw) for clause in element.clauses)
    count = f"json_array_length({text}::json -> 'values')"
    rest = f"({text}::jsonb - 'values' - 'nodes')"
    return (
        f"CASE WHEN length({text}) > 2 * {most} THEN CASE WHEN {count} > {most} "
        f"THEN ({rest} || jsonb_build_object('count', {count}))::text ELSE {text} END "
        f"ELSE {text} END"
    )


class among(FunctionElement[bool]):
    """``among(column, names)``: whether it is one of the names, a JSON array of texts; PostgreSQL.

    A statement with a parameter for each name is another text for each number of them, which both
    SQLAlchemy and the driver would read anew. (SQLite's planner takes no index for such a question
    where most of the column is empty, and its driver reads each text anyway.)
    """

    type = Boolean()
    inherit_cache = True


@compiles(among, "postgresql")
def _among_postgresql(element: Any, compiler: Any, **kw: Any) -> str:
    column, names = (compiler.process(clause, **kw) for clause in element.clauses)
    return f"{column} = ANY (ARRAY (SELECT json_array_elements_text(CAST({names} AS json))))"
