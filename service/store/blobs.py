"""Files in the database, by their SHA-256, in parts.

What a model is made of has to reach every worker of every machine, so it lies where they all look.
A file is written in the transaction of what names it, and read part by part; bytes that are not
those of their name are never used. The same file is kept once.
"""

from __future__ import annotations

from hashlib import sha256

from sqlalchemy import Connection, delete, func, select
from sqlalchemy.dialects import postgresql, sqlite

from core.errors import ModelError
from service.store import tables as t

PART = 4 * 2**20
b = t.blob.c


class SqlBlobs:
    """The `Blobs` of one transaction."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def put(self, data: bytes) -> str:
        """Keep a file; its SHA-256, hexadecimal. One that is there and damaged is mended."""
        name = sha256(data).hexdigest()
        dialect = sqlite if self._connection.dialect.name == "sqlite" else postgresql
        if not (self.lock(name) and self._whole(name)):
            self.drop(name)
            for part, start in enumerate(range(0, max(len(data), 1), PART)):
                row = {"sha256": name, "part": part, "data": data[start : start + PART]}
                put = dialect.insert(t.blob).values(row).on_conflict_do_nothing()
                self._connection.execute(put)
        return name

    def lock(self, name: str) -> bool:
        """Whether the file is there; it is not dropped before this transaction ends."""
        rows = select(b.part).where(b.sha256 == name, b.part == 0).with_for_update()
        return self._connection.execute(rows).first() is not None

    def _whole(self, name: str) -> bool:
        """Whether the file that is there is what was written."""
        try:
            self.get(name)
        except ModelError:
            return False
        return True

    def has(self, name: str) -> bool:
        count = select(func.count()).select_from(t.blob).where(b.sha256 == name)
        return bool(self._connection.execute(count).scalar())

    def get(self, name: str) -> bytes:
        """The file's bytes; ModelError where they are missing or not what was written."""
        rows = select(b.data).where(b.sha256 == name).order_by(b.part)
        data = b"".join(bytes(row) for row in self._connection.execute(rows).scalars())
        found = sha256(data).hexdigest()
        if found != name:
            what = f"has SHA-256 {found[:12]}…" if data else "is missing"
            raise ModelError(
                f"the stored file {name[:12]}… {what}. To mend it: restore the database, or upload "
                "the model again."
            )
        return data

    def drop(self, name: str) -> None:
        """Forget a file that nothing names any more."""
        self._connection.execute(delete(t.blob).where(b.sha256 == name))
