"""Where runs and courses end, in words: from when on later hours have too little of an effect, and
of which blades; and what to do where an effect has no room at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from core.calibration.state import RotorState, blade_posterior
from core.model import Model
from core.network import Network
from core.runs_end import courses_end, held_by, held_from
from core.surrogate.driven import Driven

WHILE_READ = 0.05  # of the concerned blades, on average: more that are held is an end
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


def ending(model: Model, blades: Sequence[str]) -> list[str]:
    """One sentence for each effect that still grows where its course ends, before the model's last
    hour; hours are the blades' own."""
    ends: dict[str, list[float]] = {}
    for blade in blades:
        for name, hour in courses_end(model.network, blade, model.surrogate.horizon_h).items():
            ends.setdefault(name, []).append(hour)
    return [
        f"how {name} goes on from {min(hours):,.0f} h on is not known: it stays as it is by then, "
        "and later hours have too little of the effect"
        for name, hours in sorted(ends.items())
    ]


def while_read(
    name: str,
    model: Model,
    state: RotorState,
    read_h: Mapping[str, float],
    known: Mapping[str, Mapping[str, float]] | None = None,
) -> str | None:
    """That a drift takes blades to the end of the runs before their last reading, in words; None:
    hardly any of them (`WHILE_READ`).

    read_h  hours of the blades at which each was read last
    known   inputs that are given, by blade
    """
    drift = next((d for d in model.network.drifts if d.name == name), None)
    blades = [b for b in read_h if drift is not None and drift.of_blade(b) is not None]
    if drift is None or not blades:
        return None
    held = 0.0
    for blade in blades:
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        given = (known or {}).get(blade)
        held += held_by(model, posterior, blade, drift.input, read_h[blade], given)
    if held <= WHILE_READ * len(blades):
        return None
    return (
        f"{name} takes {held:.1f} of {len(blades)} blades to the end of the runs before their last "
        "reading, no room: the runs end there"
    )
