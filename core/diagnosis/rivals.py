"""The rivals of a set that is not separable, calibrated, and the inspections that would split it.

`diagnose` calibrates the weightiest hypotheses of a turn alone. Here every name of the set gets its
best hypothesis, calibrated from the same readings. Where some names are sure and a single one
beside them is open, it is that against nothing more: the rivals are those that forecast
(`alternatives`). Where more names share the evidence than are an answer, nothing is claimed, but
what to read next is a question all the more: the `MOST` weightiest stand for them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from core.calibration.message import POOL
from core.calibration.online import Workspace, update
from core.diagnosis.adopt import with_effects
from core.diagnosis.case import Case
from core.diagnosis.diagnose import Diagnosis
from core.diagnosis.of_all import of_all
from core.diagnosis.separate import Rival, Separation, separate
from core.errors import InputError
from core.planning.campaigns import campaigns, compiled_for
from core.planning.candidates import candidates

MOST = 6  # rivals for names that are too many to be an answer


def rivals_of(
    found: Diagnosis,
    case: Case,
    workspace: Workspace | None = None,
    say: Callable[[str], None] = lambda what: None,
) -> list[Rival]:
    """The best hypothesis of each name of the set, with its share of the evidence, largest first;
    of names that are too many to be an answer the `MOST` weightiest.

    Each has the effects that were in the model before, and its own. Left out is what the runs have
    no room for.
    """
    model, state = found.before
    if (turn := found.open) is None:
        return []
    noise, allowed = case.noise(model, state), set(_open(found))
    most = len(turn.hypotheses) if found.verdict.names else MOST
    rivals: list[Rival] = []
    for one in turn.hypotheses:
        if len(rivals) == most:
            break
        covered = {n for r in rivals for n in r.names}
        said = tuple(n if n in allowed else turn.called(n) for n in one.names)
        if not set(one.names) - covered or not set(said) <= allowed:
            continue
        if (known := turn.rivals.get(one.names)) is not None:
            rivals.append(Rival(one.names, known.model, known.state, one.weight, said))
            continue
        say(f"{' and '.join(one.names)}, which is not told apart")
        try:
            more = (*turn.before, *(turn.cells[i] for i in one.cells))
            bigger = with_effects(model, more, case.facts, noise, case.read_h)
            made = update(bigger, case.spec, case.readings, workspace=workspace)
        except InputError:
            continue
        rivals.append(Rival(one.names, bigger, made, one.weight, said))
    return rivals


def splitting(
    found: Diagnosis,
    case: Case,
    workspace: Workspace | None = None,
    say: Callable[[str], None] = lambda what: None,
) -> Separation | None:
    """Inspections that would split a set that is not separable, or names too many for an answer.

    None for every other verdict, where fewer than two of the set could be calibrated, and where no
    blade has hours left in the model.
    """
    if not _open(found):
        return None
    rivals = rivals_of(found, case, workspace, say)
    if len(rivals) < 2 and found.verdict.beside:
        rivals = _or_nothing_more(found)
    model = found.before[0]
    asked = candidates(model, case.present, case.readings)
    if len(rivals) < 2 or not asked:
        return None
    say("what one reading would tell")
    whole = campaigns(model, case.present, case.readings)
    list(POOL.map(lambda r: compiled_for(r.model, r.state, asked, whole), rivals))
    apart = separate(rivals, asked, case.spec.known)
    return replace(apart, campaigns=of_all(rivals, whole, case.spec.known, say))


def _or_nothing_more(found: Diagnosis) -> list[Rival]:
    """The sets that forecast, the sure effects alone among them."""
    told = ((tuple(c.name for c in one.effects), one, share) for one, share in found.rivals)
    return [Rival(names, one.model, one.state, share, names) for names, one, share in told]


def _open(found: Diagnosis) -> tuple[str, ...]:
    """Names that share the evidence."""
    verdict = found.verdict
    return verdict.names if verdict.word == "not separable" else verdict.several
