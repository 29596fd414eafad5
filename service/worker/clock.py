"""What has passed by the database's clock: leases, pauses, and waiting, of whatever is claimed.

Rotors, jobs, residuals and webhooks are claimed under leases that these conditions look at. A lease
that ran out because the database was restarted (`outlived`) is no death of its worker: the claim
that follows it is not counted as an attempt.

The database's clock may be set back, and what was written before lies in its future then. A lease
that ends later than any could that was given now (`AHEAD` times the caller's own) is over, and what
began in the future began long ago: a rotor does not stand still until the clock has caught up. The
fence makes that safe. The pause after a failed update alone may last longer; `retry` ends it.

Every condition is one function, so that a test can take it away and see the loss noticed.
"""

from __future__ import annotations

from sqlalchemy import ColumnElement, and_, case, or_

from service.store.engine import begun_s, now_s

AHEAD = 10.0
SLACK_S = 60.0  # that clocks of machines may differ by
LONGEST_S = 3600.0  # of a pause, where nobody says otherwise


def passed(since: ColumnElement[float], seconds: float) -> ColumnElement[bool]:
    """So many seconds have passed since a moment; one in the future is from another clock."""
    return or_(since <= now_s() - seconds, since > now_s() + 1.0)


def over(until: ColumnElement[float], lease_s: float) -> ColumnElement[bool]:
    """A lease has run out, or is longer than one that is given now."""
    return or_(until <= now_s(), until > now_s() + AHEAD * lease_s)


def rested(until: ColumnElement[float], longest_s: float) -> ColumnElement[bool]:
    """A pause is over, or is longer than any that is given now: it is from another clock."""
    return or_(until.is_(None), until <= now_s(), until > now_s() + longest_s + SLACK_S)


def outlived(until: ColumnElement[float], lease_s: float) -> ColumnElement[bool]:
    """A lease ran out while the database was away: its server was started after the last beat.

    Whoever held it could not prolong it, however well the work went.
    """
    return and_(over(until, lease_s), until - lease_s < begun_s())


def counted(until: ColumnElement[float], lease_s: float) -> ColumnElement[int]:
    """What a claim adds to the attempts: nothing where the lease before it was outlived."""
    return case((outlived(until, lease_s), 0), else_=1)
