"""The exact twin with one effect that can be adopted: a campaign whose readings are off.

`diagnose` names the campaign that lies farthest from the blades' lines, if the chi-square says that
something is missing, and `update` takes the offset, as large as it was named, from its readings.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, MutableMapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from core.course import Course
from core.drift import Bias
from core.network import Network, Parameter
from core.observation import Inspection
from core.prior import Prior
from core.readings import digest_of
from service.fake import FakeScience, FakeState, questions
from service.ports import BladeRecord, Json, ModelCard, Progress, RotorSpec
from service.variant import effects_between, vary


def digest(network: Network) -> str:
    return hashlib.sha256(json.dumps(network.to_json()).encode()).hexdigest()


def corrected(network: Network, readings: Sequence[Inspection]) -> list[Inspection]:
    """The readings less the offsets that the network knows."""
    return [
        replace(r, values=r.values - sum(_offset(network, one, r) for one in network.biases))
        for r in readings
    ]


def _offset(network: Network, one: Bias, reading: Inspection) -> float:
    if one.blades is not None and reading.blade not in one.blades:
        return 0.0
    size = network.parameter(one.name).prior.mean
    assert size is not None
    return size * one.share(reading.time_h, reading.instrument, reading.campaign)


class Offsets(FakeScience):
    """The twin whose campaigns may read too much."""

    def vary(self, card: ModelCard, asked: Json | None) -> ModelCard:
        if asked is None:
            return card
        network = vary(card.network, card.horizon_h, asked)
        return replace(card, network=network, digest=digest(network))

    def update(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        readings: Sequence[Inspection],
        previous: Any,
        *,
        quick: bool,
    ) -> FakeState:
        own = corrected(card.network, readings)
        state = super().update(card, rotor, own, previous, quick=quick)
        meta = {**state.meta, "events_digest": digest_of(readings), "model": card.digest}
        return FakeState(meta, state.arrays)

    def residuals(
        self,
        card: ModelCard,
        rotor: RotorSpec,
        facts: Sequence[BladeRecord],
        readings: Sequence[Inspection],
        progress: Progress,
    ) -> Json:
        own = corrected(card.network, readings)
        update = lambda before: super(Offsets, self).update(  # noqa: E731
            card, rotor, before, None, quick=False
        )
        return questions.residuals_of(update, rotor, facts, own, progress)

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
        own = corrected(card.network, readings)
        asked = (card, rotor, facts, own, families, compare_h)
        found = super().diagnose(*asked, progress, kept, heed)
        if found["verdict"] == "adequate":
            return found
        off = self._off(own)
        campaign = max(off, key=lambda name: abs(off[name]))
        return found | self.named(card, campaign, off[campaign])

    def named(self, card: ModelCard, campaign: str, size: float) -> Json:
        """What a diagnosis says that found a campaign's offset of this size [mm]."""
        name = f"campaign offset (campaign {campaign})"
        more = self._with(card.network, name, campaign, size)
        cell = {"name": name, "words": name, "family": "campaign offset", "kind": "sensor"}
        cell |= {"target": "elongation", "how": "plus", "shape": "constant", "whom": "campaign"}
        amplitude = {"mean": size, "sd": 0.01, "of": "added to elongation", "unit": "mm"}
        effect = cell | {"value": campaign, "clock": "rotor", "step_h": None}
        return {
            "verdict": "effect",
            "names": [name],
            "claimed": True,
            "effects": [effect | {"amplitude": amplitude}],
            "models": {"before": card.digest, "after": digest(more)},
            "adds": effects_between(card.network, more),
        }

    @staticmethod
    def _off(readings: Sequence[Inspection]) -> dict[str, float]:
        """Mean distance of each campaign from the lines through the readings of the others."""
        found = {}
        for campaign in {r.campaign for r in readings if r.campaign is not None}:
            rest = [r for r in readings if r.campaign != campaign]
            away = []
            for one in (r for r in readings if r.campaign == campaign):
                own = [(r.time_h, float(r.values[0])) for r in rest if r.blade == one.blade]
                h, y = np.array(own).T
                away.append(float(one.values[0]) - (h @ y) / (h @ h) * one.time_h)
            found[campaign] = float(np.mean(away))
        return found

    @staticmethod
    def _with(network: Network, name: str, campaign: str, size: float) -> Network:
        amplitude = Parameter(name, "shared", Prior("normal", -1.0, 1.0, size, 0.01), nominal=0.0)
        bias = Bias(name, "elongation", Course.of(1.0), campaign=campaign)
        return replace(
            network,
            parameters=(*network.parameters, amplitude),
            biases=(*network.biases, bias),
        )


class Doubtful(Offsets):
    """The twin that does not tell which of two campaigns is off, the one it would name or c3."""

    OTHER, OTHER_SIZE = "c3", 0.03

    def named(self, card: ModelCard, campaign: str, size: float) -> Json:
        each = [
            super(Doubtful, self).named(card, *one)
            for one in ((campaign, size), (self.OTHER, self.OTHER_SIZE))
        ]
        names = [one["names"][0] for one in each]
        return {
            "verdict": "not separable",
            "names": names,
            "effects": each[0]["effects"],
            "models": {"before": card.digest, "after": card.digest},
            "alternatives": {
                "quantity": "elongation",
                "time_h": 50_000.0,
                "blades": ["B1", "B2", "B3"],
                "before": {"mean": 0.7, "sd": 0.05},
                "together": {"mean": 0.6, "sd": 0.06},
                "each": [
                    {
                        "effects": [{"name": name, "shape": "constant", "step_h": None}],
                        "share": share,
                        "mean": 0.6,
                        "sd": 0.05,
                        "number": number,
                        "adoption": {
                            "model": one["models"]["after"],
                            "effects": one["effects"],
                            "adds": one["adds"],
                        },
                    }
                    for number, (one, name, share) in enumerate(
                        zip(each, names, (0.6, 0.4), strict=True), start=1
                    )
                ],
            },
        }


class Lots(Offsets):
    """The twin whose lot L1 may be longer than it creeps; then campaigns are looked at."""

    SIZE = 0.1

    def named(self, card: ModelCard, campaign: str, size: float) -> Json:
        if any(one.blades is not None for one in card.network.biases):
            return super().named(card, campaign, size)
        name = "long tips (lot L1)"
        amplitude = Parameter(
            name, "shared", Prior("normal", -1.0, 1.0, self.SIZE, 0.01), nominal=0.0
        )
        bias = Bias(name, "elongation", Course.of(1.0), blades=("B1", "B2"), lasting=True)
        network = card.network
        more = replace(
            network,
            parameters=(*network.parameters, amplitude),
            biases=(*network.biases, bias),
        )
        effect = {
            "name": name,
            "words": name,
            "family": "long tips",
            "kind": "geometry",
            "target": "elongation",
            "how": "plus",
            "shape": "constant",
            "whom": "lot",
            "value": "L1",
            "clock": "blade",
            "step_h": None,
            "amplitude": {"mean": self.SIZE, "sd": 0.01, "of": "added to elongation"},
        }
        return {
            "verdict": "effect",
            "names": [name],
            "claimed": True,
            "effects": [effect],
            "models": {"before": card.digest, "after": digest(more)},
            "adds": effects_between(network, more),
        }
