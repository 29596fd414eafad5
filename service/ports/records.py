"""What the store holds, as plain records."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from service.ports.values import (
    Adopt,
    Diagnose,
    Json,
)


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
    """What is to be known better: a blade's quantity at an hour, or a parameter.

    known   the blade's values of the model's known inputs; it need not run any more
    """

    blade: str | None
    quantity: str | None
    time_h: float | None
    parameter: str | None
    known: Mapping[str, float] | None = None


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
class Policy:
    """What a rotor does by itself since somebody decided so anew.

    at      when that was, in seconds since 1970; digest: of it all, as it was written
    """

    adopt: Adopt
    diagnose: Diagnose
    at: float
    digest: str


@dataclass(frozen=True, slots=True)
class RotorRecord:
    """A rotor with its place in the log and its worker's cursor.

    network   what it varied of the model's network when it was created (`service.variant`); None:
              nothing. What it has now is told by its log (`service.adopted`)
    origin    the id under which its random numbers are drawn, where it was imported under another
    adopt     whether a diagnosis that names an effect is adopted by itself: ``never`` or ``effect``
    diagnose  whether one is asked for by itself: ``never``, on an ``alarm`` of its residuals, or
              with its ``readings`` as well; both as it was created
    policy    what is in force in their place; None: they are
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
    diagnose: Diagnose = "never"
    policy: Policy | None = None
    applied_seq: int = 0
    version: int = 0
    dirty: bool = True
    attempts: int = 0
    blocked: bool = False
    last_error: str | None = None
    last_error_event: str | None = None

    @property
    def adopts(self) -> Adopt:
        """Whether it adopts by itself now."""
        return self.adopt if self.policy is None else self.policy.adopt

    @property
    def asks(self) -> Diagnose:
        """Whether it asks for diagnoses by itself now."""
        return self.diagnose if self.policy is None else self.policy.diagnose


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
class Seen:
    """A rotor as one look found it: nothing came in between its parts.

    blades    all of them, in byte order of their names; of whoever names one, that, if it is there
    changes   entries of its log that adopt effects or back them out (`service.adopted.KINDS`)
    state     its newest version, as of `States.get`
    check     DamagedRotorError: rotor or blades are not what was written
    """

    rotor: RotorRecord
    blades: tuple[BladeRecord, ...]
    changes: int
    state: Callable[[], StateRecord]
    check: Callable[[], None]


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
    """A row of the outbox: its kind (applied, residuals, or one of `service.hooks.KINDS` but
    sealed), and what it tells."""

    id: int
    rotor_id: str
    kind: str
    payload: Json
    at: float
