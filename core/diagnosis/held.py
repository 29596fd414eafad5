"""Where runs end, in words: from when on later hours have too little of an effect, and of which
blades; and what to do where an effect has no room at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from core.calibration.state import RotorState, blade_posterior
from core.model import Model
from core.network import Network
from core.runs_end import held_from
from core.surrogate.driven import Driven

WIDENED = ("tbc_thickness", "t1t_rate")  # inputs of which rotor-blade-wide has more


def wider(network: Network, name: str) -> str:
    """What to do where the runs of an input have no room.

    Of the shipped narrow model there is a wide one, for coatings and gas; for no other.

    >>> from core.builtin.paper_network import rotor_blade_network
    >>> wider(rotor_blade_network(), "t1t_rate")
    'use a model whose runs go beyond these: rotor-blade-wide'
    >>> wider(rotor_blade_network(), "creep_steady")
    'use a model whose runs go beyond these, or a narrower prior of creep_steady'
    """
    if network.name == "rotor-blade" and not network.of_level("dormant") and name in WIDENED:
        return "use a model whose runs go beyond these: rotor-blade-wide"
    return f"use a model whose runs go beyond these, or a narrower prior of {name}"


def leaving_runs(
    model: Model,
    state: RotorState,
    blades: Sequence[str],
    known: Mapping[str, Mapping[str, float]] | None = None,
) -> list[str]:
    """One sentence for each input that leaves its runs in some of the blades; hours are theirs.

    known  inputs that are given, by blade
    """
    held, answers = [d for d in model.network.drifts if d.held], model.surrogate
    if not held or not isinstance(answers, Driven):
        return []
    ends: dict[str, list[float]] = {}
    for blade in blades:
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        for name, hour in held_from(model, posterior, blade, (known or {}).get(blade)).items():
            ends.setdefault(name, []).append(hour)
    box = {i.name: i for i in answers.base.inputs}
    return [
        f"from {min(hours):,.0f} h on {' and '.join(d.name for d in held if d.input == name)} "
        f"would take {name} of {len(hours)} of {len(blades)} blades out of the runs, "
        f"{box[name].low:g} … {box[name].high:g}: there it is held at their end, and later hours "
        "have too little of the effect"
        for name, hours in sorted(ends.items())
    ]
