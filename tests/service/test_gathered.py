"""Many rows fetched as one: the same values to the last bit, in a single row of SQLite's driver."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from sqlalchemy import bindparam, event, func, insert, select

from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.store import tables as t
from service.store.engine import is_sqlite
from service.store.gathered import Gathered, InexactError
from service.store.records import BLADE
from service.store.unit_of_work import SqlStore

B = t.blade.c
QUERY = select(B.id, B.time_h0, B.retired_seq).where(B.rotor_id == bindparam("rotor"))
ASKED = {"rotor": "r1"}
# What two integers give: at least 2⁻¹⁰ in size, or nothing.
PLAIN = [
    0.1,
    0.1 + 0.2,
    math.pi,
    1 / 3,
    -2 / 3,
    1e6 + 0.1,
    2.0**53 + 2.0,
    2.0**-10,
    0.0,
    -7.5,
    None,
]
# What they do not.
ODD = [1e-20, 2.0**-10 / 3, 1e30, -5e-324, 1.7976931348623157e308]


def stored(store: SqlStore, hours: list[float | None]) -> None:
    """A rotor with a blade for each of the hours."""
    create_rotor(store, "r1", "rotor-blade", [], 64, 7)
    rows = [
        {"rotor_id": "r1", "id": f'é"\\{i}', "time_h0": hour, "added_seq": 0, "retired_seq": i}
        for i, hour in enumerate(hours)
    ]
    with store.write() as tx:
        tx.connection.execute(insert(t.blade), rows)


def both(store: SqlStore) -> tuple[list[Any], list[Any], list[str]]:
    """The rows one by one, the rows as one, and the statements that the latter took."""
    said: list[str] = []

    def note(connection: Any, cursor: Any, statement: str, *rest: Any) -> None:
        said.append(statement)

    with store.read() as tx:
        single = [tuple(row) for row in tx.connection.execute(QUERY, ASKED)]
        event.listen(store.engine, "before_cursor_execute", note)
        try:
            as_one = Gathered(QUERY).rows(tx.connection, ASKED)
        finally:
            event.remove(store.engine, "before_cursor_execute", note)
    return _bits(single), _bits(as_one), said


def _bits(rows: list[Any]) -> list[Any]:
    """The rows with their real numbers as text that tells every bit."""
    return sorted(
        (tuple(v.hex() if isinstance(v, float) else v for v in row) for row in rows),
        key=lambda row: row[2],
    )


def test_the_same_values_in_one_row(store: SqlStore) -> None:
    rng = np.random.default_rng(5)
    drawn = (rng.standard_normal(500) * 10.0 ** rng.uniform(-2, 14, 500)).tolist()
    stored(store, [*PLAIN, *(x for x in drawn if abs(x) >= 2.0**-10)])
    single, as_one, said = both(store)
    assert len(single) > 400
    assert as_one == single
    assert len(said) == 1
    assert ("json_group_array" in said[0]) == is_sqlite(store.engine)


@pytest.mark.parametrize("odd", ODD)
def test_what_two_integers_do_not_give_comes_row_by_row(store: SqlStore, odd: float) -> None:
    stored(store, [*PLAIN, odd])
    single, as_one, said = both(store)
    assert as_one == single
    assert len(said) == (2 if is_sqlite(store.engine) else 1)


def test_reals_as_plain_json_would_not_read_back(store: SqlStore) -> None:
    """The control: SQLite's own JSON loses digits, so that the integers are needed."""
    if not is_sqlite(store.engine):
        pytest.skip("PostgreSQL's rows come as they are")
    stored(store, PLAIN)
    inner = QUERY.subquery()
    with store.read() as tx:
        text = tx.connection.execute(select(func.json_group_array(inner.c.time_h0)), ASKED).scalar()
    assert set(json.loads(str(text))) != set(PLAIN)


def test_no_rows(store: SqlStore) -> None:
    stored_nothing = both(store)
    assert stored_nothing[:2] == ([], [])


def test_a_column_of_another_type_is_refused() -> None:
    with pytest.raises(TypeError, match="column dirty"):
        Gathered(select(t.cursor.c.dirty))


def test_blades_come_as_they_were_stored(store: SqlStore) -> None:
    known = {"h_TBC": 0.1 + 0.2}
    own = BladeRecord("B2", "4", "lot", None, None, 1234.1, 0, None, known)
    create_rotor(store, "r1", "rotor-blade", [BladeRecord("B1")], 64, 7)
    with store.write() as tx:
        tx.records.put_blade("r1", own)
    with store.read() as tx:
        assert tx.records.blades("r1") == [BladeRecord("B1"), own]
        assert tx.records.blade("r1", "B2") == own
        assert tx.records.blade_ids("r1") == {"B1", "B2"}
        single = tx.connection.execute(select(*BLADE).where(B.rotor_id == "r1")).all()
    assert len(single) == 2


def test_as_a_text_the_rows_are_the_same(store: SqlStore) -> None:
    """On both databases; PostgreSQL's text has every digit, SQLite's says where it has not."""
    gathered = Gathered(QUERY)
    stored(store, PLAIN if is_sqlite(store.engine) else [*PLAIN, *ODD])
    with store.read() as tx:
        told = gathered.told(tx.connection, ASKED)
        assert told == gathered.told(tx.connection, ASKED)
        assert _bits(gathered.read(told)) == _bits(gathered.single(tx.connection, ASKED))
    with store.write() as tx:
        row = {"rotor_id": "r1", "id": "odd", "added_seq": 0, "retired_seq": 99, "time_h0": ODD[0]}
        tx.connection.execute(insert(t.blade), row)
    with store.read() as tx:
        other = gathered.told(tx.connection, ASKED)
    assert other != told
    if is_sqlite(store.engine):
        with pytest.raises(InexactError):
            gathered.read(other)


def test_no_row_is_an_empty_text_of_rows(store: SqlStore) -> None:
    with store.read() as tx:
        assert Gathered(QUERY).read(Gathered(QUERY).told(tx.connection, ASKED)) == []


@pytest.mark.parametrize("hours", [1234.1, 1e-20])
def test_blades_change_with_their_rows(store: SqlStore, hours: float) -> None:
    """What was made of a rotor's rows is not given for other ones, nor for another rotor's."""
    for rotor in ("r1", "r2"):
        create_rotor(store, rotor, "rotor-blade", [BladeRecord("B1", time_h0=hours)], 64, 7)
    with store.read() as tx:
        assert tx.records.blades("r1") == tx.records.blades("r2")
    with store.write() as tx:
        tx.records.retire_blade("r1", "B1", 3)
    with store.read() as tx:
        (first,), (second,) = tx.records.blades("r1"), tx.records.blades("r2")
    assert (first.retired_seq, second.retired_seq) == (3, None)
    assert first.time_h0 == second.time_h0 == hours
