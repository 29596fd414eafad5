"""What the use cases need from outside, as Protocols and plain records.

`Science` is the calibration and its model; `service.science` wires the blade physics to it and
`service.fake` is a small exact twin in memory, for tests and trials. `Transaction` is one
transaction of the store. Neither knows HTTP, and the use cases know no SQL.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from dataclasses import field as default
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from core.network import Network
from core.observation import Inspection
from service.access import Act, Answers, Audit, Keys
from service.hooks import Webhooks

Array = np.ndarray[Any, np.dtype[Any]]
Json = dict[str, Any]
Get = Callable[[str], Array]
NoiseFrom = Literal["readings", "prior"]
Progress = Callable[[str, int, int], None]
Adopt = Literal["never", "effect"]


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


@dataclass(frozen=True, slots=True)
class Draws:
    """Weighted draws: names (d,), values (n, d), log_w (n,), and how well they mix."""

    names: tuple[str, ...]
    values: NDArray[np.float64]
    log_w: NDArray[np.float64]


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
    """

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    kind: Literal["hexahedron20", "triangle"]


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


class Science(Protocol):
    """The calibration: pure functions of readings, rotor and earlier state."""

    @property
    def builtins(self) -> tuple[str, ...]:
        """Names of the models that come with it; the first is registered without being asked."""
        ...

    def builtin(self, name: str) -> ModelCard: ...
    def vary(self, card: ModelCard, asked: Json | None) -> ModelCard:
        """A registered model under a rotor's own network (`service.variant`), with its own digest.

        None asks for nothing: the card itself.

        Raises FaultsError or InputError for what cannot be asked of it.
        """
        ...

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: RotorState | None,
        *,
        quick: bool,
    ) -> RotorState: ...
    def restore(self, meta: Mapping[str, Any], get: Get) -> RotorState: ...
    def shared_draws(self, meta: Mapping[str, Any], get: Get) -> Draws: ...
    def blade_draws(self, meta: Mapping[str, Any], get: Get, blade: str) -> Draws: ...
    def joint_draws(
        self, meta: Mapping[str, Any], get: Get, blades: Sequence[str], count: int
    ) -> JointDraws:
        """Draws of several blades with the same shared values in each, in random order."""
        ...

    def forward(
        self, card: ModelCard, quantity: str, blade: str | None, known: Mapping[str, float] | None
    ) -> Forward:
        """The model as it is, or as one blade has it, with its effects and known inputs."""
        ...

    def predict(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        quantity: str,
        times: Sequence[float],
        node: int | None,
        probability: float,
        *,
        instrument: str | None,
        known: Mapping[str, float] | None,
    ) -> Prediction: ...
    def plan(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blades: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        target: PlanTarget,
        count: int,
    ) -> Json:
        """By how much inspections would narrow the target (`core.planning.worth`).

        blades     that run; readings: those that count
        Returns `unit`, `mean` and `sd` of the target, `single` readings and the best `set`, each
        with `sd_after` and `narrower`. Raises InputError where there is nothing to inspect.
        """
        ...

    def surface(self, card: ModelCard) -> Surface | None:
        """The surface of the model's mesh; None: it has none that is known."""
        ...

    def mesh(self, card: ModelCard) -> Mesh | None:
        """The mesh of a model's fields; None where it has none."""
        ...

    def field(
        self,
        card: ModelCard,
        meta: Mapping[str, Any],
        get: Get,
        blade: str,
        quantity: str,
        time_h: float,
        *,
        known: Mapping[str, float] | None,
    ) -> Field:
        """Mean and sd of a field or vector of the blade itself at every node, without noise."""
        ...

    def warm(self, card: ModelCard) -> None: ...
    def check_families(self, card: ModelCard, families: Sequence[Json]) -> None:
        """Refuse families of effects (`core.diagnosis.Family`) that the model cannot be asked for.

        Raises InputError.
        """
        ...

    def diagnose(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        families: Sequence[Json],
        compare_h: float | None,
        progress: Progress,
    ) -> Json:
        """What the model lacks, by the readings that count (`core.diagnosis`), as plain JSON.

        families    beside the built-in ones, checked by `check_families`
        compare_h   hour of the forecast before and after [h]; None: no comparison
        progress    called with (what, done, total) before each step; what it raises ends the work

        Raises InputError where there is nothing to diagnose.
        """
        ...

    def residuals(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        progress: Progress,
    ) -> Json:
        """Every reading predicted before it is used, and tests (`service.residuals.told`).

        progress    as of `diagnose`

        Raises InputError where no reading counts.
        """
        ...


@dataclass(frozen=True, slots=True)
class ResidualRecord:
    """What is known of a rotor's residuals.

    version   that they rest on; 0: none were computed yet
    body      ``{"residuals", "tests", "visits", …}``; None: they could not be, see `error`
    """

    version: int
    body: Json | None
    alarms: int
    computed_at: float | None
    error: str | None


@dataclass(frozen=True, slots=True)
class PlanTarget:
    """What is to be known better: a blade's quantity at an hour, or a parameter."""

    blade: str | None
    quantity: str | None
    time_h: float | None
    parameter: str | None


@dataclass(frozen=True, slots=True)
class BladeRecord:
    """A blade of a rotor. `added_seq` 0: there from the beginning.

    known   its values of the model's known inputs, where it has any
    """

    id: str
    slot: str | None = None
    lot: str | None = None
    coating_lot: str | None = None
    installed_at: str | None = None
    time_h0: float | None = None
    added_seq: int = 0
    retired_seq: int | None = None
    known: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True)
class RotorRecord:
    """A rotor with its place in the log and its worker's cursor.

    network   what it varied of the model's network when it was created (`service.variant`); None:
              nothing. What it has now is told by its log (`service.adopted`)
    origin    the id under which its random numbers are drawn, where it was imported under another
    adopt     whether a diagnosis that names an effect is adopted by itself: ``never`` or ``effect``
    """

    id: str
    model_id: str
    model_version: str
    particles: int
    seed: int
    head_seq: int
    digest: str
    created_at: float
    network: Json | None = None
    origin: str | None = None
    adopt: Adopt = "never"
    applied_seq: int = 0
    version: int = 0
    dirty: bool = True
    attempts: int = 0
    blocked: bool = False
    last_error: str | None = None
    last_error_event: str | None = None


@dataclass(frozen=True, slots=True)
class NewEvent:
    """An entry before it has a place in the log; `digest` is that of `body`."""

    event_id: str
    kind: str
    body: str
    digest: str
    replaces: str | None = None
    blade: str | None = None
    time_h: float | None = None


@dataclass(frozen=True, slots=True)
class Event(NewEvent):
    """An entry of the log.

    posted_by   id of the API key that it came with, or by which way else; None: not known
    """

    seq: int = 0
    received_at: float = 0.0
    posted_by: str | None = None


@dataclass(frozen=True, slots=True)
class Appended:
    """Where an entry stands; `new` is False where it had been there before."""

    event_id: str
    seq: int
    new: bool


@dataclass(frozen=True, slots=True)
class StateRecord:
    """A version of a rotor's posterior, without its arrays."""

    rotor_id: str
    version: int
    through_seq: int
    model_id: str
    model_version: str
    algorithm_version: str
    sealed: bool
    digest: str
    events_digest: str
    meta: Json
    created_at: float


@dataclass(frozen=True, slots=True)
class Which:
    """Which version is asked for: by number, by a moment (s since 1970), or the newest."""

    version: int | None = None
    at: float | None = None

    @property
    def newest(self) -> bool:
        return self.version is None and self.at is None


@dataclass(frozen=True, slots=True)
class JobRecord:
    """A piece of work that answers later.

    rotor_id   of a job that belongs to a rotor
    progress   ``{"what", "done", "total", "seconds_left"}`` as its worker told last
    """

    id: str
    kind: str
    status: str
    request: Json
    created_at: float
    result: Json | None = None
    error: str | None = None
    attempts: int = 0
    finished_at: float | None = None
    rotor_id: str | None = None
    progress: Json | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """A row of the outbox: kind applied, blocked, alarm or diagnosed, and what it tells."""

    id: int
    rotor_id: str
    kind: str
    payload: Json
    at: float


@dataclass(frozen=True, slots=True)
class Gauges:
    """How the service stands, over all rotors.

    backlog          entries of the log that are not applied
    applied          entries that are; versions and seals: versions written, and the sealed ones
    takeovers        leases taken after they ran out
    least_ess_ratio  of the newest version of any rotor; None: no version says one
    oldest_s         age of the oldest entry that is not applied, s; 0: there is none
    alarms           tests of residuals that alarm
    """

    rotors: int
    backlog: int
    applied: int
    versions: int
    seals: int
    takeovers: int
    dirty: int
    blocked: int
    provisional: int
    least_ess_ratio: float | None
    oldest_s: float
    jobs: int
    deliveries_pending: int
    deliveries_dead: int
    alarms: int


@dataclass(frozen=True, slots=True)
class BladeReadings:
    """Readings of one blade: how many count, how many were corrected or retracted, the last one.

    last_…   of the one that counts and came last; None where none counts
    """

    counting: int
    overruled: int
    last_id: str | None
    last_time_h: float | None
    last_received_at: float | None


@dataclass(frozen=True, slots=True)
class AtWork:
    """A worker that holds a lease now.

    does      ``applies``, ``seals``, or a job's kind
    lease_s   until the lease runs out, unless the worker renews it, s
    behind    entries of the rotor's log that are not applied
    """

    owner: str
    does: str
    rotor_id: str | None
    lease_s: float
    behind: int | None


@dataclass(frozen=True, slots=True)
class Operations:
    """The service at one moment: gauges, who works, jobs that go on, rotors that wait for help."""

    gauges: Gauges
    work: tuple[AtWork, ...]
    jobs: tuple[JobRecord, ...]
    blocked: tuple[RotorRecord, ...]


class Records(Protocol):
    """Models, jobs, rotors and blades."""

    def put_model(self, card: ModelCard, source: Json) -> None: ...
    def model(self, model_id: str, version: str | None = None) -> ModelCard: ...
    def models(self, after: str, limit: int) -> list[ModelCard]: ...
    def put_job(
        self, job_id: str, kind: str, request: Json, rotor_id: str | None = None
    ) -> JobRecord: ...
    def job(self, job_id: str) -> JobRecord: ...
    def jobs_of(
        self, rotor_id: str, kind: str, before: str | None, limit: int
    ) -> list[JobRecord]: ...
    def unfinished(self, rotor_id: str, kind: str) -> list[JobRecord]: ...
    def residuals(self, rotor_id: str) -> ResidualRecord: ...
    def cancel_job(self, job_id: str) -> None: ...
    def put_rotor(self, rotor: RotorRecord, blades: Sequence[BladeRecord]) -> bool: ...
    def rotor(self, rotor_id: str) -> RotorRecord: ...
    def rotors(
        self, after: str, limit: int, only: Sequence[str] | None = None
    ) -> list[RotorRecord]: ...
    def blades(self, rotor_id: str) -> list[BladeRecord]: ...
    def blade(self, rotor_id: str, blade_id: str) -> BladeRecord | None: ...
    def put_blade(self, rotor_id: str, blade: BladeRecord) -> None: ...
    def retire_blade(self, rotor_id: str, blade_id: str, seq: int) -> None: ...


class Log(Protocol):
    """The inspection log, which is the queue."""

    def lock(self, rotor_id: str) -> int: ...
    def append(self, rotor_id: str, events: Sequence[NewEvent]) -> list[Appended]: ...
    def free(self, rotor_id: str) -> None: ...
    def find(self, rotor_id: str, event_id: str) -> Event | None: ...
    def page(
        self,
        rotor_id: str,
        kind: str,
        after: int | None,
        limit: int,
        blade: str | None = None,
        newest: bool = False,
    ) -> list[Event]: ...
    def changes(self, rotor_id: str, after: int, limit: int) -> list[Event]:
        """Entries after one that adopt effects or back them out (`service.adopted`)."""
        ...

    def overruled(self, rotor_id: str, ids: Sequence[str]) -> list[Event]: ...
    def entries(self, rotor_id: str, after: int, through: int, limit: int) -> list[Event]: ...
    def restore(self, rotor_id: str, events: Sequence[Event]) -> None:
        """Append entries of another database to a new rotor, with their own numbers and times."""
        ...


class States(Protocol):
    """Versions of posteriors."""

    def get(self, rotor_id: str, version: int | None = None) -> StateRecord: ...
    def page(self, rotor_id: str, before: int | None, limit: int) -> list[StateRecord]: ...
    def as_of(self, rotor_id: str, at: float) -> StateRecord: ...
    def reader(self, state: StateRecord) -> Get: ...


class Outbox(Protocol):
    """Notes of what was committed."""

    def after(self, rotor_id: str, number: int, limit: int) -> list[Note]:
        """Notes with a greater number, in order."""
        ...

    def newest(self, rotor_ids: Sequence[str]) -> dict[str, int]:
        """The number of the newest note of each rotor that has one."""
        ...

    def missing(self, rotor_id: str, number: int) -> bool:
        """Whether notes after this number are no longer kept, or it was never given."""
        ...


class Transaction(Protocol):
    """One transaction: all of it is written, or nothing."""

    @property
    def records(self) -> Records: ...
    @property
    def log(self) -> Log: ...
    @property
    def states(self) -> States: ...
    @property
    def keys(self) -> Keys: ...
    @property
    def audit(self) -> Audit: ...
    @property
    def answers(self) -> Answers: ...
    @property
    def outbox(self) -> Outbox: ...
    @property
    def webhooks(self) -> Webhooks: ...
    def gauges(self) -> Gauges: ...
    def blade_readings(self, rotor_id: str) -> dict[str, BladeReadings]: ...
    def operations(self, limit: int) -> Operations: ...


Guard = Callable[[Transaction], None]


class Store(Protocol):
    """Opens transactions."""

    def read(self) -> AbstractContextManager[Transaction]: ...
    def write(self) -> AbstractContextManager[Transaction]: ...
    def acting_for(self, act: Act, guard: Guard | None = None) -> Store:
        """The store for one state-changing request.

        Its writing transactions begin with the guard, which raises where they must not go on, and
        end with the request's row of the audit trail.
        """
        ...
