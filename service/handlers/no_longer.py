"""Which of the readings that a diagnosis rests on count no longer.

What is retracted or corrected before an adoption forbids it (`service.handlers.adoptable`). What is
so afterwards leaves the effect in the model, where its amplitude is calibrated from what counts:
whether it is still to be had somebody has to decide, who is told.
"""

from __future__ import annotations

from collections.abc import Iterable

from core.log import replaced
from service.ports import Event, Transaction


def no_longer(tx: Transaction, rotor_id: str, through: int, head: int) -> list[str]:
    """Ids of readings that counted as of entry `through` and do not as of `head`, in byte order.

    Only the corrections and retractions in between are looked at, and what hangs together with
    those: of most logs there are none.
    """
    named = set(tx.log.named_since(rotor_id, through, head))
    above = named
    while above:  # where what is named is retracted, the next one up its chain is meant
        chain = tx.log.replaced(rotor_id, sorted(above)).values()
        above = {one for one in chain if one is not None} - named
        named |= above
    if not named:
        return []
    over = tx.log.overruled(rotor_id, sorted(named))
    now = out_of(event for event in over if event.seq <= head)
    then = out_of(event for event in over if event.seq <= through)
    lost = sorted((named & now) - then)
    return [one for one in lost if _known(tx, rotor_id, one, through)]


def out_of(overruling: Iterable[Event]) -> set[str]:
    """The readings that these retractions and corrections leave out."""
    named = [(e.kind, e.event_id, e.replaces) for e in overruling if e.replaces is not None]
    gone = {target for kind, _, target in named if kind == "retraction"}
    return gone | replaced({own: to for kind, own, to in named if kind == "inspection"}, gone)


def _known(tx: Transaction, rotor_id: str, reading: str, through: int) -> bool:
    event = tx.log.find(rotor_id, reading)
    return event is not None and event.kind == "inspection" and event.seq <= through
