"""Whether a stored version is what was written.

A version is called by the digest of its description and of the SHA-256 of each of its arrays
(`core.digest.state_digest`), written in the transaction that made it. `check` makes that digest
again from what stands in the tables now; the bytes of an array are compared when it is decoded.

What the digest does not cover is compared with what says the same elsewhere: the columns that
repeat the description, and where the newest version ends, which is where the cursor stands. The
time of writing (`created_at`) has no second witness.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from types import SimpleNamespace
from typing import Any

from sqlalchemy import Row

from core.digest import state_digest
from service.errors import DamagedError

Stored = Row[Any] | SimpleNamespace  # of `service.store.kept.stored`, or its values by name
REPEATED = ("sealed", "events_digest", "algorithm_version")


def told(row: Stored) -> str:
    """A name of everything that `check` looks at in the row itself."""
    stands = (row.version > row.newest, row.version == row.newest and row.applied_seq)
    parts = (row.meta, row.digest, row.through_seq, *stands)
    text = json.dumps([*parts, *(getattr(row, name) for name in REPEATED)])
    return sha256(text.encode()).hexdigest()


def problems(row: Stored, names: Mapping[str, str]) -> list[str]:
    """What in a row of `service.store.kept.stored` is not what was written.

    names   SHA-256 of each array that the version has
    """
    try:
        meta = json.loads(row.meta)
    except ValueError as error:
        return [f"its description is no JSON: {error}"]
    if not isinstance(meta, dict):
        return ["its description is no JSON object"]
    found = []
    digest = state_digest(meta, names)
    if digest != row.digest:
        found.append(f"its digest is {digest[:12]}…, written was {row.digest[:12]}…")
    for name in REPEATED:
        if meta.get(name) != getattr(row, name):
            found.append(
                f"{name} is {getattr(row, name)!r}, its description says {meta.get(name)!r}"
            )
    if row.version > row.newest:
        found.append(f"it is beyond the newest version, {row.newest}")
    if row.version == row.newest and row.through_seq != row.applied_seq:
        found.append(f"through_seq is {row.through_seq}, the cursor stands at {row.applied_seq}")
    return found


def check(row: Stored, names: Mapping[str, str]) -> None:
    """DamagedError where the version is not what was written."""
    found = problems(row, names)
    if found:
        raise DamagedError(row.rotor_id, row.version, "state", "; ".join(found))
