"""Which arrays a version has, and the SHA-256 of each.

Of each name the row with the greatest version up to the one asked for; one without a SHA-256 says
that the array ended there. Of all names of a rotor that is a question of a millisecond, and every
process asks it of every version that it meets; but between two versions few arrays change.
"""

from __future__ import annotations

from collections.abc import Mapping
from sys import intern

from sqlalchemy import Connection, bindparam, func, select

from service.store import tables as t
from service.store.gathered import Gathered

a = t.state_array.c
_OWN = (a.rotor_id == bindparam("rotor"), a.version <= bindparam("version"))
NEWEST_NAMES = select(a.name, func.max(a.version).label("version")).where(*_OWN).group_by(a.name)
_NEWEST = NEWEST_NAMES.subquery()
_ALL = Gathered(
    select(a.name, a.sha256).where(
        a.rotor_id == bindparam("rotor"), a.name == _NEWEST.c.name, a.version == _NEWEST.c.version
    )
)
_SINCE = Gathered(select(a.version, a.name, a.sha256).where(*_OWN, a.version > bindparam("since")))


def digests(connection: Connection, rotor_id: str, version: int | None = None) -> dict[str, str]:
    """name -> SHA-256 of each array of a version; None: of the newest."""
    asked = {"rotor": rotor_id, "version": 2**63 - 1 if version is None else version}
    # Names, and most digests, are those of the versions before: each text is held once.
    rows = _ALL.rows(connection, asked)
    return {intern(name): intern(sha256) for name, sha256 in rows if sha256}


def digests_since(
    connection: Connection, rotor_id: str, version: int, since: int, names: Mapping[str, str]
) -> dict[str, str]:
    """The same of a version, where `names` are those of the earlier version `since`.

    Rows of before that are not what they were do not show here: who needs that asks for `digests`.
    """
    asked = {"rotor": rotor_id, "version": version, "since": since}
    found = dict(names)
    for _, name, sha256 in sorted(_SINCE.rows(connection, asked)):
        if sha256:
            found[intern(name)] = intern(sha256)
        else:
            found.pop(name, None)
    return found
