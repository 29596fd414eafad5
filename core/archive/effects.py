"""Whether the effects that a user's network declares (`families`) could ever be found, and adopted.

A request's families are held against the same rules when a diagnosis is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from core.archive.declaration import Input
from core.archive.faults import Findings
from core.family import Family, odd_size
from core.network import Network
from core.parameter import Parameter

LEAST_ROOM = 1e-6  # of the runs' bounds


def families(network: Network, inputs: Mapping[str, Input], found: Findings) -> None:
    """Sizes that cannot be meant, and readings at many nodes, which no effect can be of.

    inputs  with their bounds; one with faults of its own is not among them
    """
    for f in network.families:
        what = f"the effect {f.name!r}"
        if f.target == "input":
            one = inputs.get(f.of)
            odd = None if one is None else odd_size(f, one.high - one.low)
            if one is not None and odd is None:
                _room(f, network.parameter(f.of), one, found)
        else:
            read = network.quantity(f.of)
            odd = odd_size(f, read.high - read.low, read.sigma_obs.low)
            if read.kind == "vector":
                problem = "is read at many nodes: what is off there cannot enter the model"
                scalar = [q.name for q in network.quantities if q.kind != "vector"]
                remedy = f"use {', '.join(scalar)}" if scalar else "take the effect out"
                found.fault(f"of, of {what}", f.of, problem, remedy)
        if odd is not None:
            found.fault(f"size of {what}", f.size, *odd)


def _room(f: Family, p: Parameter, runs: Input, found: Findings) -> None:
    """Warn where the prior of what an effect moves reaches the end of the runs, that way.

    A diagnosis notices such an effect and can never calibrate it (`core.diagnosis.room`).
    """
    slack = LEAST_ROOM * (runs.high - runs.low)
    below, above = p.prior.low - runs.low > slack, runs.high - p.prior.high > slack
    if f.how == "times" and p.prior.high <= 0:
        below, above = above, below
    room = {1: above, -1: below, 0: below or above}[f.sign]
    if room or p.level not in ("local", "shared"):
        return
    problem = f"finds no room: the prior of {p.name}, {p.prior.low:g} … {p.prior.high:g} {p.unit}, "
    problem += f"reaches to the end of the runs, {runs.low:g} … {runs.high:g}: a diagnosis may "
    problem += "notice the effect, and no model can have it"
    found.warn(f"the effect {f.name!r}", f.of, problem, "narrow the prior, or add runs beyond it")


def runs_alone(network: Network, by: Sequence[str], found: Findings) -> None:
    """Effects of an input that only run in time, where nothing can be followed in time."""
    for f in network.families:
        if f.target == "input" and "constant" not in f.shapes:
            problem = "run in time, and there is no creep strain by which an input is followed: it "
            problem += f"needs a field ceeq, and {' or '.join(by)} in the network"
            found.fault(f"shapes of the effect {f.name!r}", [*f.shapes], problem, "use constant")
