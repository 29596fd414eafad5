"""What each alternative of a diagnosis would put into the rotor's network, were it chosen.

Imported with `service.effects`, of which it is a part.
"""

from __future__ import annotations

from core.diagnosis import Diagnosis
from core.diagnosis.tell import effect_json
from service.ports import Json
from service.variant import effects_between


def with_adoptions(told: Json, found: Diagnosis) -> Json:
    """Alternatives as told, each with its `number` and its `adoption`: the digest of the `model`
    that was calibrated, its `effects` with their amplitudes, and what it `adds`.

    found  whose rivals they are, in the same order
    """
    before = found.before[0]
    each = [
        one
        | {
            "number": number,
            "adoption": {
                "model": rival.model.digest,
                "effects": [effect_json(e, before) for e in found.effects_of(rival)],
                "adds": effects_between(before.network, rival.model.network),
            },
        }
        for number, (one, (rival, _)) in enumerate(
            zip(told["each"], found.rivals, strict=True), start=1
        )
    ]
    return told | {"each": each}
