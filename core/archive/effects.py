"""Whether the effects that a user's network declares (`families`) could ever be found, and adopted.

A request's families are held against the same rules when a diagnosis is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from core.archive.faults import Findings
from core.family import odd_size
from core.network import Network


def families(network: Network, inputs: Mapping[str, float], found: Findings) -> None:
    """Sizes that cannot be meant, and readings at many nodes, which no effect can be of.

    inputs  the width of each one's bounds; one with faults of its own is not among them
    """
    for f in network.families:
        what = f"the effect {f.name!r}"
        if f.target == "input":
            odd = odd_size(f, inputs[f.of]) if f.of in inputs else None
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


def runs_alone(network: Network, by: Sequence[str], found: Findings) -> None:
    """Effects of an input that only run in time, where nothing can be followed in time."""
    for f in network.families:
        if f.target == "input" and "constant" not in f.shapes:
            problem = "run in time, and there is no creep strain by which an input is followed: it "
            problem += f"needs a field ceeq, and {' or '.join(by)} in the network"
            found.fault(f"shapes of the effect {f.name!r}", [*f.shapes], problem, "use constant")
