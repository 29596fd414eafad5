"""The schema that tables are declared in: how constraints are named, types, what may run on it.

The tables are declared in `tables`, `access_tables` and `hook_tables`; `metadata` is the whole
schema where all three are imported.

`compatible_since` has one row: the oldest revision whose processes may run on this schema
(`service.store.migrate`).
"""

from __future__ import annotations

from sqlalchemy import BigInteger, Column, Integer, MetaData, String, Table

metadata = MetaData(
    naming_convention={
        "pk": "pk_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    }
)
NAME = String(200)
BIG = BigInteger().with_variant(Integer, "sqlite")

compatible_since = Table(
    "compatible_since", metadata, Column("revision", String(32), primary_key=True)
)
