"""What one reading sees of the model, and whether the model can use it.

An `Inspection` is a value that never changes. Which of a log's count: `core.log`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError, RangeError, UnitError
from core.network import Network

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Inspection:
    """One reading of one blade.

    values  (1,) for a scalar or a field at one node, (n, 3) for a 3-D deformation [unit]
    nodes   the n node indices, or None where the quantity needs none
    sigma   known standard deviation of this reading's noise [unit]; None: the rotor's shared one

    `core.readings` makes readings that were checked once from their fields alone.
    """

    id: str
    blade: str
    quantity: str
    time_h: float
    values: Array
    nodes: NDArray[np.int64] | None = None
    unit: str | None = None
    sigma: float | None = None
    instrument: str | None = None
    campaign: str | None = None
    observed_at: str | None = None
    replaces: str | None = None
    _digest: str = field(default="", init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=np.float64)
        values.flags.writeable = False
        object.__setattr__(self, "values", values)
        if self.nodes is not None:
            nodes = np.array(self.nodes, dtype=np.int64)
            nodes.flags.writeable = False
            object.__setattr__(self, "nodes", nodes)

    def to_json(self) -> dict[str, Any]:
        """A plain dictionary; absent fields are left out, floats are exact."""
        out: dict[str, Any] = {
            **self._head(),
            "values": self.values.tolist(),
        }
        if self.nodes is not None:
            out["nodes"] = self.nodes.tolist()
        return out

    def _head(self) -> dict[str, Any]:
        out: dict[str, Any] = {
            "id": self.id,
            "blade": self.blade,
            "quantity": self.quantity,
            "time_h": float(self.time_h),
        }
        for name in ("unit", "sigma", "instrument", "campaign", "observed_at", "replaces"):
            if (value := getattr(self, name)) is not None:
                out[name] = value
        return out

    @staticmethod
    def from_json(data: dict[str, Any]) -> Inspection:
        return Inspection(**data)

    def apart(self) -> Inspection:
        """The same with arrays of its own, to be kept: of readings that were made of columns
        (`core.readings`) each shares its arrays with all others, and would hold them, too."""
        shared = self.values.base is not None or (
            self.nodes is not None and self.nodes.base is not None
        )
        if not shared:
            return self
        own = replace(self)
        object.__setattr__(own, "_digest", self._digest)
        return own

    def digest(self) -> str:
        """128 bits over everything the reading says, as hex; equal exactly for equal readings."""
        if self._digest:
            return self._digest
        made = blake2b(json.dumps(self._head(), sort_keys=True).encode(), digest_size=16)
        made.update(repr(self.values.shape).encode() + self.values.astype("<f8").tobytes())
        if self.nodes is not None:
            made.update(self.nodes.astype("<i8").tobytes())
        object.__setattr__(self, "_digest", made.hexdigest())
        return self._digest


class Covers(Protocol):
    """What `check` needs to know of a model."""

    @property
    def horizon_h(self) -> float: ...
    @property
    def node_count(self) -> int: ...
    @property
    def nodes(self) -> Mapping[str, int]:
        """Nodes that have a name."""


def check(reading: Inspection, network: Network, model: Covers, where: str = "") -> None:
    """Refuse a reading that the model cannot use: raises the first of its `faults`."""
    for fault in faults(reading, network, model, where):
        raise fault


def faults(
    reading: Inspection, network: Network, model: Covers, where: str = ""
) -> Iterator[InputError]:
    """All that keeps the model from using a reading; `where` prefixes the field's name.

    InputError, UnitError or RangeError, each with the field, its value and the remedy. Of a
    quantity that the network lacks, or values of another shape, nothing more is asked.
    """

    def name(fieldname: str) -> str:
        return f"{where}{fieldname}"

    try:
        quantity = network.quantity(reading.quantity)
    except InputError as unknown:
        yield unknown
        return
    if reading.unit is not None and reading.unit != quantity.unit:
        yield UnitError(
            name("unit"),
            reading.unit,
            f"is not the unit of {quantity.name}",
            f"convert the value to {quantity.unit!r}: one without a unit is taken for that, too",
        )
    time = reading.time_h
    if not (math.isfinite(time) and 0 <= time <= model.horizon_h):
        yield RangeError(
            name("time_h"),
            time,
            f"lies outside 0 … {model.horizon_h:g} h, which the model covers",
            "give the blade's operating hours at the inspection",
        )
    values = reading.values
    bad = np.argwhere(~np.isfinite(values))
    outside = np.argwhere((values < quantity.low) | (values > quantity.high))
    if bad.size:
        yield InputError(
            name("values"),
            float(values[tuple(bad[0])]),
            f"at {bad[0].tolist()} is not a number",
            "leave readings that failed out",
        )
    elif outside.size:
        yield RangeError(
            name("values"),
            float(values[tuple(outside[0])]),
            f"lies outside the plausible {quantity.low:g} … {quantity.high:g} {quantity.unit}",
            f"check the unit: {quantity.unit!r} is expected",
        )
    if reading.sigma is not None and not (math.isfinite(reading.sigma) and reading.sigma > 0):
        yield RangeError(
            name("sigma"), reading.sigma, "is not a positive number", "give the noise's sd"
        )
    try:
        _check_shape(reading, quantity.kind, model.node_count, name("values"), name("nodes"))
        if quantity.kind == "field" and reading.nodes is None:
            quantity.node_among(model.nodes)
    except InputError as shape:
        yield shape


def _check_shape(
    reading: Inspection, kind: str, node_count: int, values_name: str, nodes_name: str
) -> None:
    values, nodes = reading.values, reading.nodes
    if kind == "vector":
        if nodes is None or nodes.size == 0:
            raise InputError(nodes_name, None, "is missing", "name the node of each x, y, z triple")
        if values.shape != (nodes.size, 3):
            raise InputError(
                values_name,
                list(values.shape),
                f"is not the shape of {nodes.size} nodes × 3",
                "give x, y, z for each node",
            )
        own, counts = np.unique(nodes, return_counts=True)
        if own.size != nodes.size:
            twice = int(own[counts > 1][0])
            raise InputError(nodes_name, twice, "is a node named twice", "give each node once")
    else:
        if values.shape != (1,):
            raise InputError(
                values_name, list(values.shape), "is not one value", "post each value by itself"
            )
        if kind == "scalar" and nodes is not None:
            raise InputError(
                nodes_name, nodes.tolist(), "belongs to no scalar quantity", "leave it out"
            )
        if kind == "field" and nodes is not None and nodes.shape != (1,):
            raise InputError(nodes_name, nodes.tolist(), "is not one node", "name one node")
    if nodes is not None:
        wrong = nodes[(nodes < 0) | (nodes >= node_count)]
        if wrong.size:
            raise RangeError(
                nodes_name,
                int(wrong[0]),
                f"does not exist: the mesh has nodes 0 … {node_count - 1}",
                "use the node numbers of the model's mesh",
            )
