"""One parameter of a network: its level, its prior and, of blades that are alike, a population."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from core.errors import InputError
from core.prior import Population, Prior

Level = Literal["local", "shared", "known", "dormant"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """An input of the model and its place in the network.

    `nominal` is the value used while the parameter is dormant, or known and not given. With a
    `population`, a local parameter's `prior` gives its bounds only.
    """

    name: str
    level: Level
    prior: Prior
    unit: str = "1"
    symbol: str = ""
    nominal: float | None = None
    population: Population | None = None

    @property
    def hyperparameters(self) -> dict[str, Prior]:
        """Shared parameters of the population, by name."""
        if self.population is None:
            return {}
        return {f"mean.{self.name}": self.population.mean, f"sd.{self.name}": self.population.sd}

    def __post_init__(self) -> None:
        if self.population is not None:
            mean, own = self.population.mean, self.prior
            if self.level != "local" or own.kind != "uniform":
                raise InputError(
                    f"population of {self.name}",
                    (self.level, own.kind),
                    "does not belong there",
                    "give it to a local parameter with a uniform prior, its bounds",
                )
            if mean.low < own.low or mean.high > own.high:
                raise InputError(
                    f"population mean of {self.name}",
                    (mean.low, mean.high),
                    f"leaves the bounds {own.low:g} … {own.high:g}",
                    "narrow it",
                )
        if self.level not in ("local", "shared", "known", "dormant"):
            raise InputError(
                f"level of {self.name}", self.level, "is not known", "local, shared, known, dormant"
            )
        if self.level == "dormant" and self.nominal is None:
            raise InputError(
                f"nominal of {self.name}", None, "is missing", "a dormant parameter needs a value"
            )

    @staticmethod
    def from_json(told: Mapping[str, Any]) -> Parameter:
        """From what `dataclasses.asdict` makes of it."""
        own = {**told, "prior": Prior(**told["prior"])}
        if told.get("population") is not None:
            own["population"] = Population(**{k: Prior(**v) for k, v in told["population"].items()})
        return Parameter(**own)
