"""What the science gives and takes: models, draws, predictions, fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from dataclasses import field as default
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from core.network import Network

Array = np.ndarray[Any, np.dtype[Any]]
Json = dict[str, Any]
Get = Callable[[str], Array]
NoiseFrom = Literal["readings", "prior"]
Progress = Callable[[str, int, int], None]
Adopt = Literal["never", "effect"]
Diagnose = Literal["never", "alarm", "readings"]


@dataclass(frozen=True, slots=True)
class Output:
    """A quantity that the model predicts; kind scalar, field or vector."""

    unit: str
    kind: str


@dataclass(frozen=True, slots=True)
class ModelCard:
    """What is known of a model without loading it: enough to check a reading."""

    id: str
    version: str
    digest: str
    network: Network
    horizon_h: float
    node_count: int
    nodes: Mapping[str, int]
    time_h: tuple[float, ...]
    outputs: Mapping[str, Output]
    summary: Mapping[str, Any]

    def to_json(self) -> Json:
        return {
            "id": self.id,
            "version": self.version,
            "digest": self.digest,
            "network": self.network.to_json(),
            "horizon_h": self.horizon_h,
            "node_count": self.node_count,
            "nodes": dict(self.nodes),
            "time_h": list(self.time_h),
            "outputs": {name: asdict(output) for name, output in self.outputs.items()},
            "summary": dict(self.summary),
        }

    @staticmethod
    def from_json(data: Json) -> ModelCard:
        outputs = {name: Output(**output) for name, output in data["outputs"].items()}
        network = Network.from_json(data["network"])
        parts = {"network": network, "outputs": outputs, "time_h": tuple(data["time_h"])}
        return ModelCard(**data | parts)


@dataclass(frozen=True, slots=True)
class RotorSpec:
    """What an update needs to know of a rotor besides its readings.

    known   values of the model's known inputs, by blade
    """

    id: str
    blades: tuple[str, ...]
    particles: int
    seed: int
    known: Mapping[str, Mapping[str, float]] = default(default_factory=dict)


class RotorState(Protocol):
    """A posterior of one rotor: a JSON-able `meta` and named arrays; never changes.

    meta holds at least ``algorithm_version``, ``events_digest``, ``sealed`` and ``health``.
    fresh names the arrays that the update made; the others are those of the state before, and need
    not be looked at to write this one.
    """

    @property
    def meta(self) -> Mapping[str, Any]: ...
    @property
    def arrays(self) -> Mapping[str, Array]: ...
    @property
    def fresh(self) -> frozenset[str]: ...


@runtime_checkable
class PartlyLoaded(Protocol):
    """Arrays of a state that are loaded when they are first looked at; `held`: those that were."""

    @property
    def held(self) -> Mapping[str, Array]: ...


@dataclass(frozen=True, slots=True)
class Draws:
    """Weighted draws: names (d,), values (n, d), log_w (n,).

    node  (n,) which of the shared nodes a draw hangs on; draws of one node are no replicates
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    log_w: NDArray[np.float64]
    node: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class JointDraws:
    """Equally weighted draws of the shared parameters and of several blades' own ones, jointly.

    shared  (n, S) by `shared_names`, local (n, B, L) by `blades` and `local_names`: row i of both
            is one draw, in which all blades have the same shared values
    of      weighted particles behind them, of one blade
    """

    shared_names: tuple[str, ...]
    shared: NDArray[np.float64]
    local_names: tuple[str, ...]
    blades: tuple[str, ...]
    local: NDArray[np.float64]
    of: int


class Prediction(Protocol):
    """Bands of one quantity of one blade, by source (see core.prediction).

    instrument   whose noise a reading has in them, where noises are by instrument
    noise_from   what that noise is known from: ``readings``, or its ``prior`` alone
    """

    @property
    def time_h(self) -> Array: ...
    @property
    def mean(self) -> Array: ...
    @property
    def sd(self) -> Mapping[str, Array]: ...
    @property
    def lower(self) -> Array: ...
    @property
    def upper(self) -> Array: ...
    @property
    def quantiles(self) -> Mapping[float, Array]: ...
    @property
    def instrument(self) -> str | None: ...
    @property
    def noise_from(self) -> NoiseFrom: ...


class Life(Protocol):
    """The distribution of the hours until a quantity passes a limit (see core.life).

    time_h, passed  (T,): share of belief that it has passed it by then
    quantiles       {p: hour}; None: not in the model's hours
    """

    @property
    def time_h(self) -> Array: ...
    @property
    def passed(self) -> Array: ...
    @property
    def quantiles(self) -> Mapping[float, float | None]: ...


class RotorLife(Protocol):
    """How the blades of a rotor pass a limit, alone and together (see core.rotor_life).

    time_h    (T,); passed: by blade, share of belief that it has passed it by then (T,)
    expected  number of blades that have (T,); any: share of belief that at least one has (T,)
    """

    @property
    def time_h(self) -> Array: ...
    @property
    def passed(self) -> Mapping[str, Array]: ...
    @property
    def expected(self) -> Array: ...
    @property
    def any(self) -> Array: ...


@dataclass(frozen=True, slots=True)
class Surface:
    """What of a mesh is seen: points (N, 3) [mm] of all its nodes, triangles (M, 3) of numbers.

    Triangles run counter-clockwise as seen from outside.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Mesh:
    """A model's mesh: points (N, 3) [mm], cells (E, n) of node numbers, all of one kind, in VTK's
    order of nodes.

    kind  as meshio calls it (`service.export.vtu.CELL_TYPES`)
    own   a user's, of which nothing tells where its rotor's axis is
    """

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    kind: str
    own: bool = False


class Forward(Protocol):
    """A model without a posterior: what it answers for given parameters (see `core.model`).

    names   of the parameters, with `units` and the bounds `low` … `high` of the training runs
    """

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> tuple[str, ...]: ...
    @property
    def low(self) -> tuple[float, ...]: ...
    @property
    def high(self) -> tuple[float, ...]: ...
    def __call__(
        self, x: Sequence[float], times: Sequence[float], node: int | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and the surrogate's own sd at the hours: (T,), for a vector (T, 3) [unit]."""
        ...


@dataclass(frozen=True, slots=True)
class Field:
    """Mean and sd at every node: (N,), for a vector (N, 3); resting on so many particles."""

    mean: NDArray[np.float64]
    sd: NDArray[np.float64]
    particles: int
