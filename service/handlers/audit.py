"""The audit trail: who changed what, when and from where."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from service.access import EXPECTED, Act, AuditRecord
from service.errors import StoreAwayError
from service.ports import Store

log = logging.getLogger("bladetwin.audit")


def list_audit(
    store: Store,
    before: int | None,
    limit: int,
    rotor: str | None = None,
    key_id: str | None = None,
    only: Sequence[str] | None = None,
) -> list[AuditRecord]:
    """Rows below an id, the newest first; `only` names the rotors that may be seen."""
    with store.read() as tx:
        return tx.audit.page(before, limit, rotor, key_id, only)


def noted(act: Act, status: int) -> bool:
    """Whether a request has its row, and was answered as that says."""
    return act.row is not None and status == EXPECTED


def conclude(store: Store, act: Act, status: int, problem: str | None) -> None:
    """The row of a request that was answered: written if none is there, corrected if it differs.

    A change has its row since its own transaction; what is written here is the row of a request
    that was refused. Where the database is away it was refused for that, and the log tells it.
    """
    if noted(act, status):
        return
    try:
        with store.write() as tx:
            if act.row is None:
                act.row = tx.audit.note(act, status, problem)
            else:
                tx.audit.correct(act.row, status, problem)
    except StoreAwayError as error:
        log.error("no audit row for request %s: %s", act.request_id, error)
