"""The parameters of a target: shared ones as a unit box, local ones, and those that are known.

The shared nodes live in a unit box: each shared parameter, physical, a noise, or one of a
discrepancy (theta), by the quantile-like coordinate of its prior between the prior's bounds.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from core.discrepancy import parameters
from core.errors import InputError
from core.model import Model
from core.network import Parameter
from core.prior import Prior

Array = NDArray[np.float64]
TAILS = 4
FEW = 24  # numbers that tell a noise below which it has long tails
FEWER = 12  # of every noise, below which all have: what they share spreads as the noise does


class Sighted(Protocol):
    """Rows of readings, by the noises and discrepancies' parameters that they see."""

    @property
    def shared(self) -> frozenset[str]: ...
    @property
    def told(self) -> Mapping[str, int]: ...


class JointPrior(Protocol):
    """A prior of several shared parameters together, in place of their own ones."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def summary(self) -> Mapping[str, Any]: ...
    def log_density(self, unit: Array) -> Array: ...


@dataclass(frozen=True, slots=True)
class SharedSpace:
    """The shared parameters as a unit box: physical ones, noises, theta of the discrepancies.

    joint  prior of several of them together
    tails  64 nodes so many times, at least: a population's sd has a long tail
    heavy  coordinates of the noises that few readings tell, or all of them (`core.smc.proposal`)
    """

    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    joint: JointPrior | None = None
    tails: int = 1
    heavy: tuple[int, ...] = ()

    @property
    def dim(self) -> int:
        return len(self.names)

    def to_x(self, unit: Array) -> Array:
        """Unit box (n, d) → natural values."""
        out = np.empty_like(unit)
        for j, prior in enumerate(self.priors):
            low, high = prior.box
            out[:, j] = prior.to_x(low + unit[:, j] * (high - low))
        return out

    def log_prior(self, unit: Array) -> Array:
        """Log density with respect to the unit box, (n,)."""
        total = np.zeros(len(unit))
        together = () if self.joint is None else self.joint.names
        if self.joint is not None:
            total += self.joint.log_density(unit[:, [self.names.index(n) for n in together]])
        for j, prior in enumerate(self.priors):
            if self.names[j] in together:
                continue
            low, high = prior.box
            total += prior.log_density_u(low + unit[:, j] * (high - low)) + math.log(high - low)
        return total


def shared_priors(model: Model) -> dict[str, Prior]:
    """Declared priors of all shared parameters but the noises of single instruments."""
    found = {p.name: p.prior for p in model.network.of_level("shared")}
    found |= {n: prior for p in locals_of(model) for n, prior in p.hyperparameters.items()}
    found |= {q.sigma_name: q.sigma_obs for q in model.network.quantities}
    return found | {
        n: prior for q in model.network.quantities for n, prior in parameters(model, q).items()
    }


def shared_prior(model: Model, name: str) -> Prior:
    """The declared prior of a shared parameter: physical, a noise, or of a discrepancy."""
    found = shared_priors(model).get(name.split("@")[0])
    if found is None:
        raise InputError(
            "shared parameter", name, "does not exist here", "declare it, with its bounds"
        )
    return found


def shared_space(
    model: Model, rows: Iterable[Sighted], joint: JointPrior | None = None
) -> SharedSpace:
    """Shared parameters that the readings can speak of; what nobody measured keeps its prior.

    Where they can speak of none, the first noise stands in with its prior: nodes need a place.
    """
    rows = list(rows)
    met: set[str] = set(joint.names if joint else ()).union(*(r.shared for r in rows))
    told = Counter[str]()
    for one in rows:
        told.update(one.told)
    quantities = model.network.quantities
    hyper = {n: prior for p in locals_of(model) for n, prior in p.hyperparameters.items()}
    found = {p.name: p.prior for p in model.network.of_level("shared")} | hyper
    for q in quantities:
        of_each = f"{q.sigma_name}@"
        names = sorted(n for n in met if n == q.sigma_name or n.startswith(of_each))
        found |= dict.fromkeys(names, q.sigma_obs)
    for q in quantities:
        found |= {n: prior for n, prior in parameters(model, q).items() if n in met}
    found = found or {quantities[0].sigma_name: quantities[0].sigma_obs}
    together = 0 < max(told.values(), default=0) < FEWER
    heavy = tuple(j for j, name in enumerate(found) if together or 0 < told[name] < FEW)
    return SharedSpace(tuple(found), tuple(found.values()), joint, TAILS if hyper else 1, heavy)


def locals_of(model: Model, names: Sequence[str] | None = None) -> tuple[Parameter, ...]:
    """Local parameters among `names` (default: the surrogate's inputs), in their order."""
    inputs = model.input_names if names is None else names
    found = [model.network.parameter(n) for n in inputs]
    return tuple(p for p in found if p.level == "local")


def nominal(
    model: Model, names: Sequence[str], given: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Values of the inputs `names` that are not calibrated: known ones as given, else nominal."""
    out = {}
    for name in names:
        parameter = model.network.parameter(name)
        if parameter.level in ("known", "dormant"):
            value = (given or {}).get(name, parameter.nominal)
            if value is None:
                raise InputError(name, None, "is known for no blade", "give it with the blade")
            out[name] = value
    return out
