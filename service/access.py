"""Who may do what, and who did: records of keys, of state-changing requests, of first answers.

The three scopes are independent: a key has those that it was given and no other.

=========  ========================================================================
read       everything that GET answers, but for the audit trail
ingest     readings: posted, corrected, retracted
operate    rotors, blades, models, webhooks come and go; policies; retry; the audit trail
=========  ========================================================================

An `Act` is one state-changing request on its way through the service. A store that acts for it
(`Store.acting_for`) writes its row of the audit trail in the transaction of the change itself, so
that there is no change without its row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, get_args

Scope = Literal["read", "ingest", "operate"]
SCOPES: tuple[Scope, ...] = get_args(Scope)
LOOPBACK = "loopback"
COMMAND = "command line"
EXPECTED = 202  # status of a change's row; corrected where the answer turns out another


@dataclass(frozen=True, slots=True)
class KeyRecord:
    """An API key without its secret; times in seconds since 1970.

    digest   SHA-256 of the whole token, hexadecimal
    rotors   the only rotors that it knows; None: all
    """

    id: str
    name: str
    digest: str
    scopes: tuple[Scope, ...]
    rotors: tuple[str, ...] | None
    created_at: float
    expires_at: float | None = None
    revoked_at: float | None = None

    def status(self, now: float) -> str:
        """``usable``, ``revoked`` or ``expired`` at a moment.

        >>> KeyRecord("a", "n", "", ("read",), None, 0.0, expires_at=5.0).status(5.0)
        'expired'
        """
        if self.revoked_at is not None:
            return "revoked"
        over = self.expires_at is not None and self.expires_at <= now
        return "expired" if over else "usable"

    def knows(self, rotor: str) -> bool:
        """Whether a rotor of this name is there at all for the key."""
        return self.rotors is None or rotor in self.rotors


@dataclass(slots=True)
class Act:
    """A state-changing request, or a command, as the audit trail tells it.

    key_id      None: without a key, by the loopback or the command line, as `who` says
    what        method and route, e.g. ``POST /v1/rotors/{r}/retry``
    path        the path that was asked for
    row         its row of the audit trail, once a transaction with it is committed
    """

    key_id: str | None
    who: str
    address: str | None
    request_id: str
    what: str
    path: str
    rotor: str | None = None
    row: int | None = None

    @property
    def poster(self) -> str:
        """What an entry of the log keeps of who posted it: the key's id, or by which way."""
        return self.key_id or self.who


@dataclass(frozen=True, slots=True)
class AuditRecord:
    """A row of the audit trail.

    first_seq, last_seq   the entries of the rotor's log that it appended, if any
    status                of the answer (HTTP); 202 for a command
    problem               kind of the problem where it was refused
    """

    id: int
    at: float
    key_id: str | None
    who: str
    address: str | None
    request_id: str
    what: str
    path: str
    rotor_id: str | None
    first_seq: int | None
    last_seq: int | None
    status: int
    problem: str | None


@dataclass(frozen=True, slots=True)
class FirstAnswer:
    """What a request with an Idempotency-Key was answered; status None: it is being answered.

    fingerprint   SHA-256 of the request, hexadecimal
    age_s         since it began, s
    """

    fingerprint: str
    status: int | None
    headers: tuple[tuple[str, str], ...]
    body: bytes
    age_s: float


class Keys(Protocol):
    """API keys."""

    def put(self, key: KeyRecord, lifetime_s: float | None) -> KeyRecord: ...
    def find(self, key_id: str) -> tuple[KeyRecord, float] | None: ...
    def all(self) -> tuple[list[KeyRecord], float]: ...
    def revoke(self, key_id: str) -> bool: ...


class Audit(Protocol):
    """The audit trail; rows are never dropped."""

    def note(
        self,
        act: Act,
        status: int,
        problem: str | None = None,
        entries: tuple[int, int] | None = None,
    ) -> int: ...
    def correct(self, row: int, status: int, problem: str | None) -> None: ...
    def page(
        self,
        before: int | None,
        limit: int,
        rotor: str | None = None,
        key_id: str | None = None,
        only: Sequence[str] | None = None,
    ) -> list[AuditRecord]: ...


class Answers(Protocol):
    """First answers by owner and Idempotency-Key."""

    def begin(
        self, owner: str, key: str, fingerprint: str, keep_s: float, stale_s: float
    ) -> FirstAnswer | None: ...
    def finish(
        self,
        owner: str,
        key: str,
        fingerprint: str,
        status: int,
        headers: Sequence[tuple[str, str]],
        body: bytes,
    ) -> None: ...
    def forget(self, owner: str, key: str, fingerprint: str) -> None: ...
