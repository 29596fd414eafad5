"""That later hours have too little of an effect, in words: from when on, and of which blades."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from core.calibration.state import RotorState, blade_posterior
from core.model import Model
from core.runs_end import held_from
from core.surrogate.driven import Driven


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
