"""What a request that creates a rotor may hold: its blades, and what it varies of the network."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, FiniteFloat, model_validator
from pydantic.config import JsonValue

from core.network import Kind
from service.api.schemas import Body, Id, Moment, Text
from service.ports import Adopt, BladeRecord, Diagnose, Json

SHARPEST, BLUNTEST = 1e-3, 1e3  # sd of a normal prior, in widths of its interval
Positive = Annotated[FiniteFloat, Field(gt=0)]


class PriorIn(Body):
    """A prior on low … high; a normal one has `mean` and `sd` and is cut there."""

    kind: Literal["uniform", "log_uniform", "normal"]
    low: FiniteFloat
    high: FiniteFloat
    mean: FiniteFloat | None = None
    sd: Positive | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        normal = self.kind == "normal"
        if normal != (self.mean is not None) or normal != (self.sd is not None):
            raise ValueError("`mean` and `sd` belong to a normal prior, which needs both")
        if self.mean is not None and self.sd is not None:
            width = self.high - self.low
            if not self.low <= self.mean <= self.high:
                raise ValueError(f"the mean {self.mean:g} lies outside low … high")
            if not SHARPEST * width <= self.sd <= BLUNTEST * width:
                raise ValueError(f"sd is not within {SHARPEST:g} … {BLUNTEST:g} of high - low")
        return self


class DiscrepancyIn(Body):
    """What the model gets wrong of a quantity (`core.network.Discrepancy`)."""

    kind: Kind
    sd: Positive | None = None
    prior: PriorIn | None = None
    psi: Id | None = None
    sigma: Annotated[FiniteFloat, Field(ge=0)] | None = None
    length_h: Positive | None = None


class QuantityIn(Body):
    """What a rotor varies of a quantity."""

    discrepancy: DiscrepancyIn | None = None
    by_instrument: bool | None = None


class PopulationIn(Body):
    """Priors of the mean and sd of a local parameter over the rotor's blades."""

    mean: PriorIn
    sd: PriorIn


class ParameterIn(Body):
    """What a rotor varies of a local parameter."""

    population: PopulationIn | None = None


class NetworkIn(Body):
    """What a rotor varies of its model's network; what is left out stays as the model has it."""

    quantities: dict[Id, QuantityIn] | None = None
    parameters: dict[Id, ParameterIn] | None = None
    forgetting_h: FiniteFloat | None = None


class BladeIn(Body):
    """A blade that a rotor has, or that joins it."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"id": "B07", "slot": "7", "lot": "L3", "time_h0": 0.0}]}
    )

    id: Id
    slot: Text | None = None
    lot: Text | None = None
    coating_lot: Text | None = None
    installed_at: Moment | None = None
    time_h0: Annotated[FiniteFloat, Field(ge=0)] | None = None
    known: dict[Id, FiniteFloat] | None = None

    def record(self) -> BladeRecord:
        return BladeRecord(**self.model_dump() | {"known": self.known or None})


EXAMPLES: list[JsonValue] = [
    {
        "id": "r1",
        "model": "rotor-blade",
        "blades": [{"id": "B01", "slot": "1"}, {"id": "B02"}],
        "network": {
            "quantities": {
                "elongation": {
                    "discrepancy": {"kind": "constant", "sd": 0.02},
                    "by_instrument": True,
                }
            },
            "forgetting_h": 20000,
        },
    },
    {
        "id": "r2",
        "model": "rotor-blade",
        "blades": [{"id": "B01"}, {"id": "B02"}],
        "network": {
            "parameters": {
                "tbc_thickness": {
                    "population": {
                        "mean": {"kind": "uniform", "low": 0.7, "high": 1.3},
                        "sd": {"kind": "log_uniform", "low": 0.01, "high": 0.3},
                    }
                }
            }
        },
    },
]


class RotorIn(Body):
    """A new rotor."""

    model_config = ConfigDict(json_schema_extra={"examples": EXAMPLES})

    id: Id
    model: Id
    blades: Annotated[list[BladeIn], Field(max_length=2000)]
    particles: Annotated[int, Field(ge=16, le=1_000_000)] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    network: NetworkIn | None = None
    adopt: Adopt = "never"
    diagnose: Diagnose = "never"

    def asked_network(self) -> Json | None:
        """What the rotor varies, without what it leaves out; None: nothing."""
        told: Json = {} if self.network is None else self.network.model_dump(exclude_none=True)
        return told or None


class PolicyIn(Body):
    """What a rotor does by itself from now on; what is left out stays as it is."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"diagnose": "alarm"}]})

    adopt: Adopt | None = None
    diagnose: Diagnose | None = None

    @model_validator(mode="after")
    def _says(self) -> Self:
        if self.adopt is None and self.diagnose is None:
            raise ValueError("nothing is decided: give `adopt`, `diagnose` or both")
        return self
