"""Webhooks: what happens to rotors, sent to a URL.

A webhook is told of events of some or all rotors. What is to be told is written in the transaction
in which it happens, one delivery for each webhook that asks for it, so that nothing is lost between
the two; a worker sends it, and it counts as delivered when that was answered with 2xx.

===================  ===========================================================================
sealed               a rotor has a new sealed version
blocked              a rotor is blocked; its error, and the entry that stops it
alarm                a sealed version is not to be trusted, and the one before was (health)
diagnosed            a diagnosis is done; its verdict, and why the rotor did not adopt it by itself
diagnosis-failed     a diagnosis failed and is not tried again; its error
diagnosis-cancelled  somebody cancelled a diagnosis that had not ended
adopted              effects are put into a rotor's model: of which diagnosis, and whether unasked
backed-out           they are taken out again
gap                  some of a rotor's were dropped, for too many waited; told unasked
===================  ===========================================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, get_args

Kind = Literal[
    "sealed",
    "blocked",
    "alarm",
    "diagnosed",
    "diagnosis-failed",
    "diagnosis-cancelled",
    "adopted",
    "backed-out",
]
KINDS: tuple[Kind, ...] = get_args(Kind)
GAP = "gap"
Status = Literal["pending", "delivered", "dead"]
STATUSES: tuple[Status, ...] = get_args(Status)


@dataclass(frozen=True, slots=True)
class WebhookRecord:
    """A webhook without its secret, which is not kept (`service.signing`).

    rotors        the only rotors that it is told of; None: all
    salt          from which, with the key file and the id, its secret is made again
    fingerprint   SHA-256 of the secret, hexadecimal
    """

    id: str
    url: str
    events: tuple[str, ...]
    rotors: tuple[str, ...] | None
    salt: str
    fingerprint: str
    created_at: float = 0.0

    def same(self, other: WebhookRecord) -> bool:
        """Whether both ask for the same, whatever their secrets."""
        return (self.url, self.events, self.rotors) == (other.url, other.events, other.rotors)


@dataclass(frozen=True, slots=True)
class DeliveryRecord:
    """One event for one webhook. `message_id` is the same however often it is sent.

    event        one of `KINDS`, or `GAP`
    number       its place in the order in which a rotor's events are sent
    attempts     sendings that were answered with anything but 2xx, or not at all, and the last
    not_before   when a pending one is sent at the earliest, s since 1970
    """

    number: int
    message_id: str
    webhook_id: str
    rotor_id: str
    event: str
    body: str
    status: str
    attempts: int
    created_at: float
    not_before: float | None
    tried_at: float | None
    last_error: str | None


def kind_of(note: str, payload: dict[str, Any]) -> Kind | None:
    """The event that a note of the outbox is for webhooks; None: it is none.

    >>> kind_of("applied", {"sealed": True}), kind_of("applied", {"sealed": False})
    ('sealed', None)
    """
    if note == "applied":
        return "sealed" if payload["sealed"] else None
    return next((kind for kind in KINDS if kind == note), None)


class Webhooks(Protocol):
    """Webhooks and what they are told."""

    def put(self, webhook: WebhookRecord) -> WebhookRecord | None:
        """Write a new one; the one that is there, if its id is taken, and nothing is written."""
        ...

    def find(self, webhook_id: str) -> WebhookRecord | None: ...
    def page(self, after: str, limit: int) -> list[WebhookRecord]: ...
    def counts(self, ids: Sequence[str]) -> dict[str, dict[str, int]]:
        """Deliveries of each webhook by status; `dropped`: those that are not sent any more."""
        ...

    def delete(self, webhook_id: str) -> bool:
        """The webhook and everything that it was still to be told; whether it was there."""
        ...

    def deliveries(
        self, webhook_id: str, status: str | None, before: int | None, limit: int
    ) -> list[DeliveryRecord]:
        """The newest first, older than one."""
        ...

    def delivery(self, webhook_id: str, message_id: str) -> DeliveryRecord | None: ...
    def revive(self, webhook_id: str, message_id: str) -> None:
        """A dead delivery is tried again from the beginning; others stay as they are."""
        ...
