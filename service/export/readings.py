"""Readings as rows: CSV that can be posted again, and Parquet for analysis.

A scalar, or a field at one node, is one row with its `value` (and `node`); a scan of a vector is
one row for each node, with `x`, `y` and `z`. Numbers are written so that they are read back to the
last digit, so a reading that is posted again is the same reading, by its digest.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from itertools import islice
from typing import Any

from service.errors import NotInstalledError

Json = Mapping[str, Any]
COLUMNS = (
    *("id", "blade", "quantity", "time_h", "value", "node", "x", "y", "z", "unit", "sigma"),
    *("instrument", "campaign", "observed_at", "replaces"),
)
AT_ONCE = 20_000  # rows of a group
OF_ALL = ("id", "blade", "quantity", "time_h", *COLUMNS[9:])


def rows(body: Json) -> Iterator[dict[str, Any]]:
    """The rows of one reading; cells without a value are left out.

    >>> [*rows({"id": "s", "values": [[1.0, 2.0, 3.0]], "nodes": [7]})]
    [{'id': 's', 'node': 7, 'x': 1.0, 'y': 2.0, 'z': 3.0}]
    """
    head = {name: body[name] for name in OF_ALL if body.get(name) is not None}
    nodes = body.get("nodes")
    for i, value in enumerate(body["values"]):
        place = {} if nodes is None else {"node": nodes[i]}
        given = dict(zip("xyz", value, strict=True)) if isinstance(value, list) else None
        yield head | place | (given or {"value": value})


def csv_header() -> str:
    return ",".join(COLUMNS) + "\n"


def csv_text(bodies: Iterable[Json]) -> str:
    """Lines of readings, without the header."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, restval="", lineterminator="\n")
    for body in bodies:
        writer.writerows(rows(body))
    return out.getvalue()


class Parquet:
    """A Parquet file of readings, written page by page into memory.

    Raises NotInstalledError where pyarrow is not there.
    """

    def __init__(self, facts: Mapping[str, str]) -> None:
        try:
            import pyarrow as pa
            from pyarrow import parquet
        except ModuleNotFoundError:
            raise NotInstalledError("pyarrow", "export", "use format=csv") from None
        text, number = pa.string(), pa.float64()
        kinds = dict.fromkeys(COLUMNS, text)
        kinds |= dict.fromkeys(("time_h", "value", "x", "y", "z", "sigma"), number)
        kinds |= {"node": pa.int64(), "seq": pa.int64(), "status": text, "posted_by": text}
        kinds["received_at"] = pa.timestamp("ms", tz="UTC")
        fields = [
            pa.field(n, k, metadata={"unit": "h"} if n == "time_h" else None)
            for n, k in kinds.items()
        ]
        self._schema = pa.schema(fields, metadata=dict(facts))
        self._table = pa.Table
        self._buffer = io.BytesIO()
        self._writer = parquet.ParquetWriter(self._buffer, self._schema, compression="zstd")

    def add(self, listed: Iterable[tuple[Json, int, str, float, str | None]]) -> None:
        """Readings, each with its seq, status, the moment it came (s since 1970), and its key."""
        found = (
            row
            | {"seq": seq, "status": status, "posted_by": who}
            | {"received_at": datetime.fromtimestamp(at, UTC)}
            for body, seq, status, at, who in listed
            for row in rows(body)
        )
        while some := list(islice(found, AT_ONCE)):
            self._writer.write_table(self._table.from_pylist(some, schema=self._schema))

    def end(self) -> bytes:
        self._writer.close()
        return self._buffer.getvalue()
