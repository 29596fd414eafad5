"""The online update: one more reading, one new state.

``update`` is a pure function. Sealed (``quick=False``), its result depends on the rotor, the set
of readings that count, the seed and the algorithm alone: late, corrected, retracted, shuffled and
duplicate inspections give the bit-identical state, because nothing in it remembers an order. What
makes it *online* is that almost nothing is computed again: a blade's message depends on that
blade's readings only, and is kept.

Quick (``quick=True``), the shared nodes stay where the previous state has them, the touched
blades' messages are known there to a few hundredths of a nat, every other blade moves through the
weights. That is the classical particle-filter step. Where too few nodes would carry the weight it
is tempered, so that the shared parameters are rather too wide than too sharp; where even that
would not do, the nodes are placed anew at once. The state says that it is provisional until a
sealed one follows, how far it is tempered, and which blades carry fewer draws until then. It reads
and writes the touched blades' arrays only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from core.calibration.quick import provisional, reweighted
from core.calibration.responses import prepare
from core.calibration.space import shared_space
from core.calibration.start import Start
from core.calibration.state import ALGORITHM, RotorSpec, RotorState
from core.calibration.step import Step
from core.calibration.stored import StoredPosterior
from core.calibration.weighed import node_count
from core.calibration.workspace import Workspace
from core.errors import InputError, RangeError
from core.model import Model
from core.observation import Inspection
from core.readings import digest_of


def update(
    model: Model,
    rotor: RotorSpec,
    inspections: Sequence[Inspection],
    previous: RotorState | None = None,
    *,
    quick: bool = False,
    workspace: Workspace | None = None,
    prior: StoredPosterior | None = None,
    start: Start | None = None,
) -> RotorState:
    """The state after these readings (all that count, in any order).

    previous   the state before; only a quick update looks at it, and a sealed one of the same
               readings is the answer
    prior      of shared parameters, from the posterior of another network (`stored`)
    start      where the posterior is expected (`start`); its nodes then depend on that as well, so
               that such a state is one to compare with others, and none to keep
    Raises InputError for a reading of a blade that the rotor does not have, or that the prior has
    seen, and RangeError for one at an hour that the model of its quantity does not cover.
    """
    if previous is not None and previous.meta["algorithm_version"] != ALGORITHM:
        previous = None
    made = begun(model, rotor, inspections, workspace=workspace, prior=prior, start=start)
    if previous is not None and start is None and made.told_by(previous):
        return replace(previous, fresh=frozenset())
    if quick and previous is not None:
        found = reweighted(made, previous)
        if found is not None:
            return provisional(made, previous, found)
    return made.sealed(previous)


def begun(
    model: Model,
    rotor: RotorSpec,
    inspections: Sequence[Inspection],
    *,
    workspace: Workspace | None = None,
    prior: StoredPosterior | None = None,
    start: Start | None = None,
) -> Step:
    """An update that has its messages, and computes what it is asked for; as `update`."""
    work = workspace or Workspace()
    by_blade: dict[str, list[Inspection]] = {}
    for reading in inspections:
        if reading.blade not in rotor.blades:
            raise InputError(
                "blade", reading.blade, f"is no blade of rotor {rotor.id}", "install it first"
            )
        if not 0 <= reading.time_h <= (last := model.part(reading.quantity).horizon_h):
            raise RangeError(
                f"time_h of reading {reading.id}",
                reading.time_h,
                f"lies outside 0 … {last:g} h, which the model of {reading.quantity} covers",
                "give the blade's operating hours at the inspection",
            )
        by_blade.setdefault(reading.blade, []).append(reading)
    prepare(model, inspections)
    rows = {b: work.rows_of(model, by_blade[b]) for b in sorted(by_blade)}
    space = shared_space(model, rows.values(), prior)
    messages = work.messages_of(model, rows, space, rotor.known or {})
    if prior is not None:
        prior.check(model, rotor.id, {b: m.digest for b, m in messages.items()})
    digest = digest_of(inspections)
    return Step(model, rotor, space, messages, work, digest, len(inspections), start)


__all__ = ["RotorSpec", "RotorState", "Workspace", "begun", "node_count", "update"]
