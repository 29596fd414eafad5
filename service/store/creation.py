"""What a rotor's versions are computed from beside its log, held against what it was called.

A rotor's digest was made from its row and the blades of its creation (`service.digests`); what it
does by itself now, where somebody decided so since, has one of its own. A blade
that joined or left later has an entry of the log, which has its digest and its place. The log
cannot make these rows again, so that nothing is to be computed where one of them is damaged:
whoever computes takes a rotor's blades from `sound_blades`, and who reads has them checked.

What no digest covers has no witness: the version of the model, the `origin` and `created_at`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

from sqlalchemy import (
    Connection,
    ScalarSelect,
    String,
    bindparam,
    func,
    literal_column,
    select,
    union_all,
)

from service.digests import as_created, digest_of_blade, digest_of_rotor, policy_problem
from service.entries import BLADES
from service.errors import DamagedRotorError
from service.ports import BladeRecord, Event, RotorRecord
from service.store import tables as t
from service.store.cache import Compared, Sound
from service.store.records import SqlRecords

e = t.entry.c
Part = Literal["rotor", "blade"]
Problem = tuple[Part, str, str]
Ends = tuple[int, int | None, int]
# Of each kind by itself, so that an index finds them (`service.store.log`).
_MOVES = union_all(
    *(
        select(e.kind, e.blade, e.seq, e.digest).where(
            e.rotor_id == bindparam("rotor"), e.kind == kind
        )
        for kind in BLADES
    )
)


def count_of(kinds: Sequence[str]) -> ScalarSelect[int]:
    """How many entries of these kinds a rotor has, as a column of a query for one."""
    # written out: values of an IN are put into the statement anew, each time that it is asked
    names = [literal_column(f"'{kind}'", String()) for kind in kinds]
    own = select(func.count()).where(e.rotor_id == bindparam("rotor"), e.kind.in_(names))
    return own.scalar_subquery()


# Where a rotor's row says that its log ends, where it does, and how many of it moved a blade.
MOVED = count_of(BLADES)
END = select(func.max(e.seq)).where(e.rotor_id == t.rotor.c.id).scalar_subquery()
_ENDS = select(t.rotor.c.head_seq, END, MOVED).where(t.rotor.c.id == bindparam("rotor"))


class Move(NamedTuple):
    """An entry by which a blade joined or left."""

    kind: str
    blade: str
    seq: int
    digest: str


def sound_blades(
    connection: Connection, rotor: RotorRecord, compared: Compared | None = None
) -> list[BladeRecord]:
    """The rotor's blades; DamagedRotorError: its row, or one of theirs, is not what was written.

    compared   what was found sound before. Every row is read all the same, and those of the log
               that tell of blades: only where all of them read as they did is no digest made again
    """
    blades = SqlRecords(connection).blades(rotor.id)
    head, end, moved = connection.execute(_ENDS, {"rotor": rotor.id}).one()
    sound(connection, rotor, blades, (head, end, moved), compared)
    return blades


def sound(
    connection: Connection,
    rotor: RotorRecord,
    blades: list[BladeRecord],
    ends: tuple[int, int | None, int],
    compared: Compared | None,
) -> None:
    """DamagedRotorError as of `sound_blades`. ends   the head, the log's end, how many moved"""
    head, end, moved = ends
    moves = _moves(connection, rotor, blades) if moved else ()
    known = compared is not None and compared.knows(rotor, moves, blades)
    _refuse(rotor, [] if known else _problems(rotor, blades, moves), head, end)
    if compared is not None:
        compared.put(rotor, moves, blades)


def check(
    connection: Connection,
    rotor: RotorRecord,
    blades: Sequence[BladeRecord],
    sound: Sound | None = None,
    ends: Ends | None = None,
) -> None:
    """DamagedRotorError: a rotor's row, or one of its blades' in byte order, is not what was
    written.

    A blade may join or leave between two of these questions: what its row does not tell yet is no
    damage where it came after the rotor was read.

    sound   what was compared before, and reads the same, is not compared again
    ends    (head_seq, `END`, `MOVED`) as they were read with the rotor and its blades
    """
    head, end, moved = ends or connection.execute(_ENDS, {"rotor": rotor.id}).one()
    known = sound is not None and sound.knows_all(rotor, moved, blades)
    moves = _moves(connection, rotor, blades) if moved and not known else ()
    _refuse(rotor, [] if known else _problems(rotor, blades, moves), head, end)
    if sound is not None:
        sound.put(rotor, moved, blades)


def _refuse(rotor: RotorRecord, problems: Iterable[Problem], head: int, end: int | None) -> None:
    """DamagedRotorError where there are problems, or where the log ends elsewhere than at `head`,
    where the rotor's row says that it does."""
    found = list(problems)
    if head != (end or 0):
        found.append(("rotor", rotor.id, f"its head_seq is {head}, the log ends at {end or 0}"))
    if found:
        raise DamagedRotorError(
            rotor.id, [f"rotor {rotor.id}: {part} {name}: {what}" for part, name, what in found]
        )


def check_one(
    connection: Connection,
    rotor: RotorRecord,
    name: str | None,
    found: BladeRecord | None,
    sound: Sound,
    moved: int,
) -> None:
    """The same where one blade was asked for, or none: all of them are compared the first time in a
    process, and wherever one of the two rows reads otherwise than then.

    found   the blade, if the rotor has it
    moved   `MOVED` as it was read with them
    """
    if not sound.knows(rotor, moved, name, found):
        check(connection, rotor, SqlRecords(connection).blades(rotor.id), sound)


def _moves(
    connection: Connection, rotor: RotorRecord, blades: Sequence[BladeRecord]
) -> tuple[Move, ...]:
    """What the log tells of blades, up to where the rotor and the blades were read."""
    told = {seq for blade in blades for seq in (blade.added_seq, blade.retired_seq)}
    moves = (Move(*row) for row in connection.execute(_MOVES, {"rotor": rotor.id}))
    return tuple(move for move in moves if move.seq <= rotor.head_seq or move.seq in told)


def problems(
    connection: Connection, rotor_id: str, events: Sequence[Event] | None
) -> Iterator[Problem]:
    """What in a rotor's row and in those of its blades is not what was written: whose, and what.

    events   the rotor's log; None: it is damaged itself, and says nothing
    """
    records = SqlRecords(connection)
    try:
        rotor, blades = records.rotor(rotor_id), records.blades(rotor_id)
    except DamagedRotorError as error:
        yield "rotor", rotor_id, error.problems[0]
        return
    moves = None
    if events is not None:
        moves = [Move(e.kind, e.blade or "", e.seq, e.digest) for e in events if e.kind in BLADES]
    yield from _problems(rotor, blades, moves)


def _problems(
    rotor: RotorRecord, blades: Sequence[BladeRecord], moves: Iterable[Move] | None
) -> Iterator[Problem]:
    asks = (rotor.particles, rotor.seed, rotor.network, rotor.adopt, rotor.diagnose)
    made = digest_of_rotor(rotor.id, rotor.model_id, as_created(blades), *asks)
    if made != rotor.digest:
        whose = "its row and the blades of its creation have"
        problem = f"{whose} digest {made[:12]}…, written was {rotor.digest[:12]}…"
        yield "rotor", rotor.id, problem
    if (now := policy_problem(rotor)) is not None:
        yield "rotor", rotor.id, now
    if moves is None:
        return
    there = {blade.id: blade for blade in blades}
    told = {(move.kind, move.blade): move for move in moves}
    for name in sorted(there.keys() | {blade for _, blade in told}):
        differs = _differs(there.get(name), name, told)
        if differs is not None:
            yield "blade", name, differs


def _differs(
    blade: BladeRecord | None, name: str, moves: Mapping[tuple[str, str], Move]
) -> str | None:
    joined, left = moves.get(("blade", name)), moves.get(("retirement", name))
    if blade is None:
        return "its row is missing, entries of the log name it"
    told = (0 if joined is None else joined.seq, None if left is None else left.seq)
    if (blade.added_seq, blade.retired_seq) != told:
        found = (blade.added_seq, blade.retired_seq)
        return f"added_seq and retired_seq are {found}, the log says {told}"
    if joined is not None and (made := digest_of_blade(blade)) != joined.digest:
        return f"its row has digest {made[:12]}…, entry {joined.seq} has {joined.digest[:12]}…"
    return None
