"""How large an effect on an input may be, for the simulation's runs end.

A drift moves an input by an amplitude a times its shape s(t), from where the blade's own prior has
it. A model has room for it if the whole prior stays inside the runs, until each blade's last
reading, for a good part of the size that is expected.

If so, and the input is each blade's own, the amplitudes that are asked for are those by which the
middle half of its prior, from quartile to quartile, stays inside: the thinnest coating that a prior
allows used to bound what all blades may have lost (0.44, where 0.38 ± 0.04 was found: the effect
leaned on an end that no blade had reached). What begins further out is held at the runs' end
(`core.surrogate.reach`); whether blades are, while they are read, is asked of the posterior
(`core.diagnosis.held.while_read`).

Where the blades' hours are not known, the whole prior stays inside to the runs' last hour.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from core.archive import Input
from core.diagnosis.held import wider
from core.drift import Drift
from core.errors import InputError
from core.model import Model
from core.surrogate import Surrogate
from core.surrogate.driven import Driven

LEAST_ROOM = 0.2  # of the expected size, or the runs cannot hold the effect
OUTSIDE = 0.25  # of a blade's own prior, at either end, may leave the runs while it is read
Bounds = tuple[float, float]


def room(
    model: Model,
    drift: Drift,
    low: float,
    high: float,
    size: float,
    read_h: Mapping[str, float] | None = None,
) -> Bounds:
    """The amplitudes between low and high that the runs have room for.

    size    what is expected of it
    read_h  hours of the blades at which each was read last

    Raises InputError where that is less than `LEAST_ROOM` of the size, or there are no runs.
    """
    base = model.surrogate.base if isinstance(model.surrogate, Driven) else model.surrogate
    if not isinstance(base, Surrogate):
        raise InputError(
            f"effect {drift.name}", drift.input, "needs simulation runs", "train a surrogate"
        )
    box = {i.name: i for i in base.inputs}
    if drift.input not in box:
        raise InputError(
            f"effect {drift.name}", drift.input, "is no input of the runs", f"one of {[*box]}"
        )
    parameter = model.network.parameter(drift.input)
    own, zeros, last = box[drift.input], dict(drift.since), base.horizon_h
    until = {(zero, last) for zero in (0.0, *zeros.values())}
    if read_h is not None:
        whose = read_h if drift.blades is None else drift.blades
        until = {(zeros.get(b, 0.0), min(read_h.get(b, 0.0), last)) for b in whose}
    s = np.concatenate([drift.shape.over(zero, zero + hour) for zero, hour in until])
    asleep, prior = parameter.level == "dormant", parameter.prior
    assert not asleep or parameter.nominal is not None
    ends = [float(parameter.nominal or 0.0)] if asleep else [prior.low, prior.high]
    least, most = _inside(own, drift, s, ends, (low, high))
    if most - max(least, 0.0) < LEAST_ROOM * size:
        raise InputError(
            f"effect {drift.name}",
            drift.input,
            f"finds no room: its runs, {own.low:g} … {own.high:g}, hold amplitudes of "
            f"{least:z.3g} … {max(least, most):z.3g}, where {size:.3g} is expected",
            wider(model.network, drift.input),
        )
    if parameter.level != "local" or read_h is None:
        return least, most
    middle = prior.quantile(np.array([OUTSIDE, 1.0 - OUTSIDE])).tolist()
    return _inside(own, drift, s, middle, (low, high))


def _inside(
    own: Input, drift: Drift, s: NDArray[np.float64], starts: Sequence[float], bounds: Bounds
) -> Bounds:
    """The amplitudes by which the input stays inside its runs, from each of where it starts."""
    low, high = bounds
    for x in starts:
        for v in (float(s.min()), float(s.max())):
            slope = v if drift.how == "plus" else float(x) * v
            if slope:
                ends = sorted(((own.low - x) / slope, (own.high - x) / slope))
                low, high = max(low, float(ends[0])), min(high, float(ends[1]))
    return low, high
