"""The service at a glance: how many of what, who works, what waits for help.

Each is what one transaction finds: of all rotors together, or of the blades of one of them.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.ports.records import JobRecord, RotorRecord


@dataclass(frozen=True, slots=True)
class Gauges:
    """How the service stands, over all rotors.

    backlog          entries of the log that are not applied
    applied          entries that are; versions and seals: versions written, and the sealed ones
    takeovers        leases taken after they ran out
    least_ess_ratio  of the newest version of any rotor; None: no version says one
    oldest_s         age of the oldest entry that is not applied, s; 0: there is none
    alarms           tests of residuals that alarm
    adoptions        effects of a diagnosis put into a rotor's model; back_outs: taken out again
    diagnosed        diagnoses that are done; undiagnosed: that failed and are not tried again
    outdated         rotors whose newest version is of an algorithm before this release's
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
    deliveries_dropped: int
    alarms: int
    outdated: int
    adoptions: int
    back_outs: int
    diagnosed: int
    undiagnosed: int


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
