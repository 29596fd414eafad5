"""A field over hours as an Arrow IPC stream: a record batch for each hour, a row for each node.

Columns: `time_h` [h], `node` (0 … N−1 in the model's order), `mean` and `sd`; of a vector `mean_x`,
`mean_y`, `mean_z`, `sd_x`, `sd_y`, `sd_z`. Each number column has its `unit`, and what the field
rests on is metadata of the schema (`facts`, JSON). pyarrow, polars, DuckDB and R's arrow read it
batch by batch, so that neither side holds all hours at once.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.errors import NotInstalledError

Array = NDArray[np.float64]
AXES = "xyz"


class ArrowStream:
    """The stream's schema; `batches` writes it hour by hour.

    vector   whether the field has x, y and z
    unit     of mean and sd
    facts    what the field rests on

    Raises NotInstalledError where pyarrow is not there.
    """

    def __init__(self, *, vector: bool, unit: str, facts: Mapping[str, Any]) -> None:
        try:
            import pyarrow as pa
        except ModuleNotFoundError:
            raise NotInstalledError("pyarrow", "export", "use format=npz") from None
        self._pa = pa
        ends = [f"_{axis}" for axis in AXES] if vector else [""]
        fields = [pa.field("time_h", pa.float64(), metadata={"unit": "h"})]
        fields.append(pa.field("node", pa.int32()))
        fields += [
            pa.field(what + end, pa.float64(), metadata={"unit": unit})
            for what in ("mean", "sd")
            for end in ends
        ]
        self._schema = pa.schema(fields, metadata={"facts": json.dumps(facts)})

    def batches(self, hours: Iterable[tuple[float, Array, Array]]) -> Iterator[bytes]:
        """The stream in pieces. `hours`: (t, mean, sd), of shape (N,) or (N, 3) each."""
        sink = io.BytesIO()
        with self._pa.ipc.new_stream(sink, self._schema) as writer:
            for hour, mean, sd in hours:
                count = len(mean)
                columns = [np.full(count, hour), np.arange(count, dtype=np.int32)]
                for values in (mean, sd):
                    columns += [*np.reshape(values, (count, -1)).T]
                made = [self._pa.array(np.ascontiguousarray(one)) for one in columns]
                writer.write_batch(self._pa.record_batch(made, schema=self._schema))
                yield _taken(sink)
        yield _taken(sink)


def _taken(sink: io.BytesIO) -> bytes:
    whole = sink.getvalue()
    sink.seek(0)
    sink.truncate()
    return whole
