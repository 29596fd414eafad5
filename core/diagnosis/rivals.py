"""The rivals of a set that is not separable, calibrated, and the inspections that would split it.

`diagnose` keeps the model and state of the winner alone. The others are calibrated again from the
same readings, which gives the same states.
"""

from __future__ import annotations

from core.calibration.online import Workspace, update
from core.diagnosis.adopt import with_effects
from core.diagnosis.ahead import candidates
from core.diagnosis.diagnose import Case, Diagnosis
from core.diagnosis.separate import Rival, Separation, separate


def rivals_of(found: Diagnosis, case: Case, workspace: Workspace | None = None) -> list[Rival]:
    """Calibrated hypotheses of the verdict with their shares of the evidence, largest first.

    Each has the effects that were in the model before, and its own.
    """
    model, state = found.before
    every = case.scan(model, state).cells
    noise = case.noise(model, state)
    kept = {e.cell.name: e.cell for e in found.effects}
    calibrated = {names for names, _ in found.tried}
    rivals: list[Rival] = []
    for one in found.verdict.hypotheses:
        full = next((n for n in calibrated if n[len(n) - len(one.names) :] == one.names), None)
        if full is None or any(r.names == one.names for r in rivals):
            continue
        gone = full[: len(full) - len(one.names)]
        left = [c for c in every if c.name not in gone]
        if one.cells and max(one.cells) >= len(left):
            continue
        own = [left[i] for i in one.cells]
        if tuple(c.name for c in own) != one.names or not all(n in kept for n in gone):
            continue
        taken = [*(kept[n] for n in gone), *own]
        if [e.cell for e in found.effects] == taken:
            bigger, made = found.after
        else:
            bigger = with_effects(model, taken, case.facts, noise)
            made = update(bigger, case.spec, case.readings, workspace=workspace)
        rivals.append(Rival(one.names, bigger, made, one.weight))
    return rivals


def splitting(
    found: Diagnosis, case: Case, workspace: Workspace | None = None
) -> Separation | None:
    """Inspections that would split a set that is not separable.

    None for every other verdict, where fewer than two of the set could be calibrated, and where no
    blade has hours left in the model.
    """
    if found.verdict.word != "not separable":
        return None
    rivals = rivals_of(found, case, workspace)
    asked = candidates(found.before[0], case.spec.blades, case.readings)
    if len(rivals) < 2 or not asked:
        return None
    return separate(rivals, asked, case.spec.known)
