"""Which blades that join a rotor an effect in its model concerns, and which are not told.

An effect of a lot concerns the blades of that lot; where it grows with a blade's own hours they
join it (`by_lot`; what is in force, and the entries: `service.adopted`). An effect that runs by the
rotor's hours is not told so (where the new blade's hours began is not known to it), nor one of an
event, which the blade did not see. A blade that would have to be told is told of in answers as
`untold`.
"""

from __future__ import annotations

from collections.abc import Iterable

from service.ports import BladeRecord, Json

LOTS = ("lot", "coating_lot")


def untold(effect: Json, blades: Iterable[BladeRecord]) -> list[str]:
    """Blades that joined after an effect in force (`Adopted.effects`), and that it concerns.

    The model takes such a blade for one that the effect leaves alone, or that began with the rotor.
    Those that joined the effect (`JOINING`) are told.

    >>> wear = {"seq": 7, "whom": "lot", "value": "L1", "clock": "blade", "shape": "linear"}
    >>> untold(wear, [BladeRecord(f"B{n}", lot="L1", added_seq=n) for n in (0, 6, 8)])
    ['B8']
    """
    told = effect.get("joined", ())
    late = (b for b in blades if b.added_seq > effect["seq"] and b.id not in told)
    return [b.id for b in late if concerns(effect, b)]


def concerns(effect: Json, blade: BladeRecord) -> bool:
    """Whether a blade that joined has to be told about an effect: of its lot, or of a day.

    An event's, which was before it joined, it did not see.
    """
    whom = effect.get("whom")
    if effect.get("clock") == "event":
        return False
    if whom in LOTS:
        return _of_lot(effect, blade)
    runs = effect.get("clock") == "rotor" and effect.get("shape") != "constant"
    return bool(runs and whom in ("all", "instrument", "campaign"))


def _of_lot(effect: Json, blade: BladeRecord) -> bool:
    own = {"lot": blade.lot, "coating_lot": blade.coating_lot}
    return effect.get("value") is not None and bool(own[effect["whom"]] == effect["value"])


def by_lot(effect: Json, blade: BladeRecord) -> bool:
    """Whether an effect is of the blade's lot and grows with the blade's own hours."""
    own = effect.get("clock") == "blade" and effect.get("whom") in LOTS
    return own and _of_lot(effect, blade)
