"""A model: the network that is calibrated and the surrogate that answers for the physics."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from core.answers import Answers, Stacked
from core.builtin.paper_network import rotor_blade_network
from core.drift import ITSELF, Drift
from core.errors import InputError, ModelError
from core.network import Network
from core.response import Response
from core.surrogate import Surrogate
from core.surrogate.anchor import Anchor
from core.surrogate.driven import Driven
from core.surrogate.targets import MEAN_CEEQ

Array = NDArray[np.float64]
MOST_LOCAL = 10  # local parameters of a component; the polynomials of its rows grow too large


def _of_all(drift: Drift) -> bool:
    """Whether it runs alike in every blade."""
    return drift.blades is None and (not drift.since or drift.since == ((ITSELF, 0.0),))


@dataclass(frozen=True)
class Model:
    """Network + surrogate. `version` names the pair in every answer (64 bits of its digest).

    Where the network has inputs that run in time, make it with `Model.of`.
    """

    network: Network
    surrogate: Answers | Stacked
    _rows: dict[object, Response] = field(default_factory=dict, repr=False, compare=False)
    _blades: dict[object, Model] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        known = {p.name: p for p in self.network.parameters}
        answered = {i.name for i in self.surrogate.inputs}
        for drift in self.network.drifts:
            asleep = known[drift.name].level == "dormant"
            if drift.name not in answered and _of_all(drift) and not asleep:
                raise ModelError(
                    f"the surrogate knows no amplitude {drift.name!r}: inputs that run in time "
                    "need a driven surrogate; use Model.of"
                )
        for i in self.surrogate.inputs:
            if i.name not in known:
                raise ModelError(
                    f"the surrogate's input {i.name!r} is not a parameter of the network "
                    f"{self.network.name!r}; declare it (dormant, if it is not to be calibrated)"
                )
            prior = known[i.name].prior
            slack = 1e-9 * (i.high - i.low)
            if prior.low < i.low - slack or prior.high > i.high + slack:
                raise ModelError(
                    f"the prior of {i.name!r}, {prior.low:g} … {prior.high:g}, leaves the range of "
                    f"the training runs, {i.low:g} … {i.high:g}; narrow it or add runs"
                )
        for quantity in self.network.quantities:
            self.few_locals([i.name for i in self.part(quantity.name).inputs], quantity.name)

    @staticmethod
    def of(network: Network, surrogate: Answers | Stacked, anchor: Anchor | None = None) -> Model:
        """The network on a surrogate that is driven by the network's drifts, if there are any.

        anchor  of a wide surrogate (`core.surrogate.anchor`); that of a driven one is kept
        Raises ModelError where the drifts cannot go through this surrogate, InputError where an
        input would leave its runs.
        """
        if isinstance(surrogate, Driven):
            anchor, surrogate = surrogate.anchor, surrogate.base
        asleep = {p.name: p.nominal for p in network.of_level("dormant") if p.nominal is not None}
        if isinstance(surrogate, Surrogate):
            inputs = {i.name for i in surrogate.inputs}
            fixed = {name: value for name, value in asleep.items() if name in inputs}
        if not network.drifts and not (isinstance(surrogate, Surrogate) and fixed):
            return Model(network, surrogate)
        creeps = isinstance(surrogate, Surrogate) and MEAN_CEEQ in surrogate.parts
        if not isinstance(surrogate, Surrogate) or not creeps:
            names = ", ".join([*(d.name for d in network.drifts)] or [*asleep])
            raise ModelError(
                f"inputs that run in time or sleep ({names}) need one surrogate of simulation "
                "runs with mean CEEQ; this model's is none"
            )
        drifts = tuple(d for d in network.drifts if _of_all(d) and d.name not in asleep)
        free = (inputs - fixed.keys()) | {d.name for d in drifts}
        ranges = {p.name: (p.prior.low, p.prior.high) for p in network.parameters if p.name in free}
        return Model(network, Driven(surrogate, drifts, ranges, fixed, anchor))

    def for_blade(self, blade: str) -> Model:
        """The model as one blade has it; itself where no effect is of some blades only."""
        network = self.network.for_blade(blade)
        if network is self.network:
            return self
        key = (network.drifts, network.biases)
        if key not in self._blades:
            plain = isinstance(self.surrogate, Stacked) or not self.network.drifts
            made = Model(network, self.surrogate) if plain else Model.of(network, self.surrogate)
            self._blades[key] = made
        return self._blades[key]

    def part(self, quantity: str) -> Answers:
        """The surrogate that answers for `quantity`."""
        return (
            self.surrogate.part(quantity) if isinstance(self.surrogate, Stacked) else self.surrogate
        )

    def few_locals(self, names: Sequence[str], what: str) -> None:
        """Refuse inputs with more local parameters than a message integrates over."""
        local = [n for n in names if self.network.parameter(n).level == "local"]
        if len(local) > MOST_LOCAL:
            raise InputError(
                f"local parameters of {what}",
                local,
                f"are more than {MOST_LOCAL}",
                "declare some as shared, known or dormant",
            )

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the declaration and the surrogate's own digest.

        Effects that the model may lack (`families`) are no part of it: no posterior knows them.
        """
        declared = {k: v for k, v in self.network.to_json().items() if k != "families"}
        text = json.dumps(declared, sort_keys=True) + self.surrogate.digest
        return sha256(text.encode()).hexdigest()

    @property
    def version(self) -> str:
        return self.digest[:16]

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(i.name for i in self.surrogate.inputs)


def rotor_blade() -> Model:
    """The model that ships: the paper's network on the built-in surrogate."""
    from core.builtin import rotor_blade as builtin

    return Model(rotor_blade_network(), builtin.load())


def rotor_blade_wide() -> Model:
    """The model of the wide plan, in which effects find room; dormant inputs are asleep.

    Where there is no effect it answers as `rotor_blade` does (`core.surrogate.anchor`).
    """
    from core.builtin import rotor_blade as builtin

    network = builtin.wide_network()
    asleep = {p.name: p.nominal for p in network.of_level("dormant") if p.nominal is not None}
    return Model.of(network, builtin.load_wide(), Anchor(builtin.load(), asleep))
