"""The online update: one more reading, one new state.

``update`` is a pure function. Sealed (``quick=False``), its result depends on the rotor, the set
of readings that count, the seed and the algorithm alone: late, corrected, retracted, shuffled and
duplicate inspections give the bit-identical state, because nothing in it remembers an order. What
makes it *online* is that almost nothing is computed again: a blade's message depends on that
blade's readings only, and is kept.

Quick (``quick=True``), the shared nodes stay where the previous state has them, the touched blades'
messages are exact at these nodes, and every other blade moves through the weights. That is the
classical particle-filter step; it is refused where too few nodes would carry the weight, and the
state says that it is provisional until a sealed one follows.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.draws import SHARE
from core.calibration.message import BladeMessage, prior_draws
from core.calibration.rotor import Columns, Weighed, node_count, weigh
from core.calibration.state import ALGORITHM, RotorSpec, RotorState, health
from core.calibration.target import (
    BladeRows,
    SharedSpace,
    assemble,
    locals_of,
    nominal,
    shared_space,
)
from core.errors import InputError
from core.model import Model
from core.observation import Inspection, digest_of
from core.rng import seed_of, stream
from core.smc.particles import log_sum_exp

Array = NDArray[np.float64]
QUICK_ESS = 0.1


class Workspace:
    """What is kept between updates of one process; dropping it changes no result."""

    def __init__(self) -> None:
        self.columns = Columns()
        self.rows: OrderedDict[tuple[str, str], BladeRows] = OrderedDict()
        self.draws: OrderedDict[tuple[str, ...], tuple[Array, Array]] = OrderedDict()

    def rows_of(self, model: Model, readings: Sequence[Inspection]) -> BladeRows:
        key = (model.digest, digest_of(readings))
        if key not in self.rows:
            made = assemble(model, readings)
            assert made is not None
            self.rows[key] = made
            while len(self.rows) > 2000:
                self.rows.popitem(last=False)
        return self.rows[key]


def update(
    model: Model,
    rotor: RotorSpec,
    inspections: Sequence[Inspection],
    previous: RotorState | None = None,
    *,
    quick: bool = False,
    workspace: Workspace | None = None,
) -> RotorState:
    """The state after these readings (all that count, in any order).

    previous   the state before; only a quick update looks at it
    Raises InputError for a reading of a blade that the rotor does not have.
    """
    work = workspace or Workspace()
    by_blade: dict[str, list[Inspection]] = {}
    for reading in inspections:
        if reading.blade not in rotor.blades:
            raise InputError(
                "blade", reading.blade, f"is no blade of rotor {rotor.id}", "install it first"
            )
        by_blade.setdefault(reading.blade, []).append(reading)
    rows = {b: work.rows_of(model, by_blade[b]) for b in sorted(by_blade)}
    space = shared_space(model, rows.values())
    known = rotor.known or {}
    messages = {
        b: BladeMessage(model, r, space, nominal(model, known.get(b))) for b, r in rows.items()
    }
    digests = {b: r.digest for b, r in rows.items()}
    if quick and previous is not None:
        step = _quick(rotor, space, messages, digests, previous, work)
        if step is not None:
            return _state(model, rotor, space, step, messages, inspections, previous, work, False)
    weighed = weigh(space, messages, work.columns, seed_of(rotor.seed, rotor.id, "nodes") % 2**63)
    return _state(model, rotor, space, weighed, messages, inspections, previous, work, True)


def _quick(
    rotor: RotorSpec,
    space: SharedSpace,
    messages: Mapping[str, BladeMessage],
    digests: Mapping[str, str],
    previous: RotorState,
    work: Workspace,
) -> Weighed | None:
    """The previous nodes with the touched blades' columns renewed; None where they do not carry."""
    if tuple(previous.meta["shared"]) != space.names or previous.meta["seed"] != rotor.seed:
        return None
    unit = previous.arrays["shared/unit"]
    key = bytes.fromhex(previous.meta["placement"])
    before: Mapping[str, str] = previous.meta["readings"]
    columns = {
        b: previous.arrays[f"column/{b}"]
        if before.get(b) == digests[b]
        else work.columns.of(messages[b], key, unit, "exact")
        for b in messages
    }
    step = Weighed(unit, previous.arrays["shared/log_q"], space.log_prior(unit), columns, key, 0)
    return step if step.ess_ratio >= QUICK_ESS else None


def _state(
    model: Model,
    rotor: RotorSpec,
    space: SharedSpace,
    weighed: Weighed,
    messages: Mapping[str, BladeMessage],
    inspections: Sequence[Inspection],
    previous: RotorState | None,
    work: Workspace,
    sealed: bool,
) -> RotorState:
    k = len(weighed.unit)
    per_node = SHARE * -(
        -rotor.particles // (k * SHARE)
    )  # whole groups: every stratum counts alike
    log_w = weighed.log_w
    log_evidence = log_sum_exp(log_w) - float(np.log(k))
    arrays: dict[str, Array] = {
        "shared/unit": weighed.unit,
        "shared/x": space.to_x(weighed.unit),
        "shared/log_q": weighed.log_q,
        "shared/log_w": log_w - log_sum_exp(log_w),
    }
    readings = {b: m.rows.digest for b, m in messages.items()}
    for blade in rotor.blades:
        key = (
            model.digest,
            rotor.id,
            str(rotor.seed),
            blade,
            readings.get(blade, ""),
            str(per_node),
            weighed.key.hex() + "/".join(space.names),
        )
        if key not in work.draws and previous is not None:
            same = {"model": model.digest, "rotor": rotor.id, "seed": rotor.seed}
            same |= {"particles": per_node * k, "placement": weighed.key.hex()}
            same |= {"shared": list(space.names), "algorithm_version": ALGORITHM}
            unread = previous.meta["readings"].get(blade) == readings.get(blade)
            known = unread and blade in previous.meta["blades"]
            if known and all(previous.meta.get(n) == value for n, value in same.items()):
                names = (f"blade/{blade}/local", f"blade/{blade}/log_w")
                work.draws[key] = (previous.arrays[names[0]], previous.arrays[names[1]])
        if key not in work.draws:
            rng = stream(rotor.seed, ALGORITHM, *key)
            if blade in messages:
                work.draws[key] = messages[blade].draws(
                    weighed.unit, per_node, rng, weighed.columns[blade]
                )
            else:
                prior_key = (*key[:-1], str(k))
                rng = stream(rotor.seed, ALGORITHM, *prior_key)
                work.draws[key] = prior_draws(model, k, per_node, rng)
            while len(work.draws) > 3 * len(rotor.blades) + 100:
                work.draws.popitem(last=False)
        else:
            work.draws.move_to_end(key)
        arrays[f"blade/{blade}/local"], arrays[f"blade/{blade}/log_w"] = work.draws[key]
        if blade in messages:
            arrays[f"column/{blade}"] = weighed.columns[blade]
    for value in arrays.values():
        value.flags.writeable = False
    meta: dict[str, Any] = {
        "algorithm_version": ALGORITHM,
        "model": model.digest,
        "rotor": rotor.id,
        "seed": rotor.seed,
        "particles": per_node * k,
        "sealed": sealed,
        "events_digest": digest_of(inspections),
        "events": len(inspections),
        "readings": readings,
        "placement": weighed.key.hex(),
        "shared": list(space.names),
        "local": [p.name for p in locals_of(model)],
        "blades": list(rotor.blades),
        "log_evidence": log_evidence,
        "health": health(log_w, 0.003 * float(np.sqrt(max(len(messages), 1)))),
        "arrays": sorted(arrays),
    }
    return RotorState(meta, arrays)


__all__ = ["RotorSpec", "RotorState", "Workspace", "node_count", "update"]
