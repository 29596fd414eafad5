"""Whether a quantity changes between runs, is of a reading's magnitude, and can have its
discrepancy over the runs' hours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from core.archive.faults import Findings
from core.archive.unfit import too_large, too_small
from core.errors import InputError
from core.expansion import modes_over
from core.network import Network, Quantity

Array = NDArray[np.float64]
CONSTANT = 1e-9  # relative
BURIED, BROUGHT = 0.1, 0.25  # of the least noise: spread between runs, error of interpolating
MOST = 10  # runs that are named
FACTORS = (1e3, 1e-3, 1e6, 1e-6, 1e2, 1e-2)


@dataclass(slots=True)
class Seen:
    """What all runs together show of a quantity: sums over runs of each value, and extremes, also
    of each run by its label (`ends`)."""

    count: int = 0
    mean: Array | None = None
    square: Array | None = None
    low: float = np.inf
    high: float = -np.inf
    brought: float = 0.0
    ends: list[tuple[str, float, float]] = field(default_factory=list)

    def add(self, values: Array, label: str) -> None:
        """One more run (Welford's recurrence)."""
        self.count += 1
        if self.mean is None or self.square is None:
            self.mean, self.square = values.copy(), np.zeros_like(values)
        else:
            step = values - self.mean
            self.mean += step / self.count
            self.square += step * (values - self.mean)
        self.low, self.high = min(self.low, values.min()), max(self.high, values.max())
        self.ends.append((label, float(values.min()), float(values.max())))

    @property
    def between(self) -> float:
        """The largest standard deviation between runs, over instants and nodes."""
        assert self.square is not None
        return float(np.sqrt(self.square.max() / max(self.count - 1, 1)))


def declared_faults(network: Network, horizon_h: float) -> Iterator[InputError]:
    """What of a network no runs of these hours could serve, known without a run: a ``gp`` that
    cannot be calibrated over them, and noises and priors of no usable size."""
    for q in network.quantities:
        if q.discrepancy.kind == "gp":
            try:
                modes_over(q, horizon_h)
            except InputError as error:
                yield error
    sizes = [(f"sigma_obs of {q.name}", q.sigma_obs, q.sigma_obs.low) for q in network.quantities]
    sizes += [
        (f"prior of {p.name}", p.prior, max(abs(p.prior.low), abs(p.prior.high)))
        for p in network.parameters
    ]
    for what, prior, size in sizes:
        odd = too_large(what, np.array([prior.low, prior.high])) or too_small(what, size)
        if odd is not None:
            yield odd


def check_changes(
    seen: Mapping[str, Seen], network: Network, horizon_h: float, found: Findings
) -> None:
    """Quantities that never change, that leave what readings may be, or drown in their noise; and
    whose discrepancy does not go with the runs' hours."""
    for error in declared_faults(network, horizon_h):
        found.add(error)
    by_name = {q.name: q for q in network.quantities}
    if "displacement" in seen and "deformation" in by_name:
        by_name["displacement"] = by_name["deformation"]
    for name, one in seen.items():
        if not one.count:
            continue
        largest = float(max(abs(one.low), abs(one.high)))
        if (small := too_small(f"quantity {name}", largest)) is not None:
            found.add(small)
        elif one.between <= CONSTANT * max(largest, np.finfo(float).tiny):
            problem = "is the same in every run: no input moves it, and nothing is learnt"
            remedy = "check what the runs write, or take it out of the network"
            found.fault(f"quantity {name}", float(largest), problem, remedy)
        elif name in by_name:
            _check_magnitude(name, one, by_name[name], found)


def _check_magnitude(name: str, one: Seen, q: Quantity, found: Findings) -> None:
    """Warn of numbers that readings cannot have or cannot tell, with a factor that would fit."""
    what, least = f"quantity {name}", q.sigma_obs.low
    if one.brought > BROUGHT * least:
        problem = "is what interpolating in time may miss, against the least noise "
        problem += f"{least:g} {q.unit}"
        found.warn(what, one.brought, problem, "write all runs at the same instants")
    outside = one.high > q.high or one.low < q.low
    if not outside and one.between >= BURIED * least:
        return
    fits = [
        f
        for f in FACTORS
        if f * one.high <= q.high and f * one.low >= q.low and f * one.between > least
    ]
    problem = f"leaves what readings may be, {q.low:g} … {q.high:g}"
    if not outside:
        problem = f"differs between runs by {one.between:.3g} at most, a tenth of the least noise "
        problem += f"({least:g}) or less: readings tell nothing"
    remedy = "check the unit"
    beyond = [label for label, low, high in one.ends if low < q.low or high > q.high]
    if outside and 2 * len(beyond) < one.count:
        many = f" and {len(beyond) - MOST} more" if len(beyond) > MOST else ""
        problem += f", in {len(beyond)} of {one.count} runs: {', '.join(beyond[:MOST])}{many}"
        remedy = "look at these: leave out what diverged, or widen the quantity's low and high"
    elif fits:
        remedy += f": times {fits[0]:g} it would fit, as if the runs were written in another"
    found.warn(what, f"{one.low:.4g} … {one.high:.4g} {q.unit}", problem, remedy)
