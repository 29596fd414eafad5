"""The studies' exact twin, with effects that can be predicted in a line: see `Naming.diagnose`."""

from __future__ import annotations

import json
from collections.abc import Callable, MutableMapping, Sequence
from typing import Any

from core.observation import Inspection
from service.adopted import adopted_at
from service.ports import BladeRecord, Json, ModelCard, Progress, RotorSpec
from service.studies.chaos.check import Version
from service.studies.chaos.twin import Descent
from tests.service.adopting import Offsets

SIZE = 0.05  # mm


class Naming(Offsets, Descent):
    """A diagnosis names the campaign that it is asked for, if it is in the readings that count and
    not in the model; its provisional states tell their parent."""

    def diagnose(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        families: Sequence[Json],
        compare_h: float | None,
        progress: Progress,
        kept: MutableMapping[str, Any],
        heed: Callable[[], None],
    ) -> Json:
        given = (card, rotor, facts, readings, families, compare_h, progress, kept, heed)
        found = Descent.diagnose(self, *given) | {"verdict": "adequate"}
        campaign = families[0]["name"]
        known = {bias.campaign for bias in card.network.biases}
        if campaign in known or all(one.campaign != campaign for one in readings):
            return found
        return found | self.named(card, campaign, SIZE)


def made_again(version: Version) -> str:
    """The digest of a version from the readings and the network of its time
    (`service.studies.chaos.check`)."""
    science, row, quick = Naming(provisional=True), version.row, not version.row.sealed
    with version.store.read() as tx:
        rotor = tx.records.rotor(row.rotor_id)
        network = adopted_at(tx, rotor, row.through_seq).network
    card = science.vary(version.card, network)
    made = science.update(card, version.spec, version.readings, None, quick=quick)
    meta = dict(made.meta)
    if quick:
        meta["parent"] = json.loads(row.meta).get("parent")
    return type(made)(meta, made.arrays).digest
