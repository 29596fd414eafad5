"""The rivals of a set that is not separable, calibrated, and the inspections that would split it.

`diagnose` calibrates the weightiest hypotheses alone and keeps the model and state of the winner.
Here every name of the set gets its best hypothesis, calibrated from the same readings: for those
that `diagnose` had calibrated that gives the same states.
"""

from __future__ import annotations

from core.calibration.online import Workspace, update
from core.diagnosis.adopt import with_effects
from core.diagnosis.diagnose import Case, Diagnosis
from core.diagnosis.separate import Rival, Separation, separate
from core.errors import InputError
from core.planning.ahead import candidates


def rivals_of(found: Diagnosis, case: Case, workspace: Workspace | None = None) -> list[Rival]:
    """The best hypothesis of each name of the set, with its share of the evidence, largest first.

    Each has the effects that were in the model before, and its own. Left out is what the runs have
    no room for.
    """
    model, state = found.before
    kept = {e.cell.name: e.cell for e in found.effects}
    gone = _before(found)
    every = [c for c in case.scan(model, state).cells if c.name not in gone]
    noise = case.noise(model, state)
    rivals: list[Rival] = []
    for one in found.verdict.hypotheses:
        covered = {n for r in rivals for n in r.names}
        new = set(one.names) & set(found.verdict.names) - covered
        if not new or not set(one.names) <= set(found.verdict.names):
            continue
        taken = [*(kept[n] for n in gone), *(every[i] for i in one.cells)]
        if [e.cell for e in found.effects] == taken:
            bigger, made = found.after
        else:
            try:
                bigger = with_effects(model, taken, case.facts, noise)
            except InputError:
                continue
            made = update(bigger, case.spec, case.readings, workspace=workspace)
        rivals.append(Rival(one.names, bigger, made, one.weight))
    return rivals


def _before(found: Diagnosis) -> tuple[str, ...]:
    """Names that were in the model when the verdict's hypotheses were tried."""
    for one in found.verdict.hypotheses:
        for names, _ in reversed(found.tried):
            if names[len(names) - len(one.names) :] == one.names:
                return names[: len(names) - len(one.names)]
    return ()


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
