"""Which finite-element runs the built-in models of the rotor blade are made of.

``rotor-blade`` (`STANDARD`): 66 training and 34 independent test points, two maximin Latin
hypercubes (`core.design`) over the box of the priors.

``rotor-blade-wide`` (`WIDE`): a wider box, so that coatings may wear and gas may heat up beyond
what is calibrated, with the dormant inputs (`core.blade.inputs`), and to 150,000 h, for a blade
under milder inputs takes long to reach the strain that it has already (`core.surrogate.history`).
Eight inputs make the box too large to be filled, and nobody lives in most of it: a blade has one
lack or two, not four at once, and stays near its prior and what an effect makes of it. So three
fifths of the runs stand near (`Near`), in an inner box where at most two of the dormant inputs are
awake; the others fill the whole.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from core.blade import BOUNDS, DORMANT, output_times
from core.blade.integrate import Tolerance
from core.design import maximin_lhs
from core.rng import seed_of

NAME = "rotor-blade"
SEED = 20230106
TRAINING, TEST = 66, 34
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Near:
    """Runs where blades live.

    share   of a plan's runs
    bounds  inner box of inputs, where it is not the plan's
    asleep  what the other inputs are where they sleep, by name
    awake   which of these are awake, in turn
    """

    share: float
    bounds: Mapping[str, tuple[float, float]]
    asleep: Mapping[str, float]
    awake: Sequence[frozenset[str]]


@dataclass(frozen=True)
class Plan:
    """Which runs a model is made of.

    bounds     box of each input, in order
    time_h     instants, from 0
    tolerance  of the creep's integration
    near       where part of the runs stand closer together
    """

    name: str
    bounds: Mapping[str, tuple[float, float]]
    time_h: Array
    training: int
    test: int
    tolerance: Tolerance = field(default_factory=Tolerance)
    near: Near | None = None

    @property
    def command(self) -> str:
        return f"bladetwin model build {self.name}"


STANDARD = Plan(NAME, BOUNDS, output_times(), TRAINING, TEST)
WIDER = {"tbc_thickness": (0.4, 4 / 3), "t1t_rate": (0.78, 1.045)}
WIDE = Plan(
    f"{NAME}-wide",
    {**BOUNDS, **WIDER, **{name: (one.low, one.high) for name, one in DORMANT.items()}},
    np.concatenate([output_times(), np.linspace(5e4, 1.5e5, 13)[1:]]),
    400,
    40,
    # strains of tens of percent in the hottest corner: 1e-5 of the elongation is lost by it
    Tolerance(ceiling=0.05),
    Near(
        0.6,
        {
            "tbc_thickness": (0.5, 4 / 3),
            "t1t_rate": (0.79, 1.0),
            "creep_transient": (-2.7, 2.7),
            "creep_steady": (-2.7, 2.7),
        },
        {name: one.nominal for name, one in DORMANT.items()},
        (
            frozenset({"tertiary"}),
            frozenset({"cooling_flow"}),
            frozenset(),
            frozenset({"tertiary"}),
            frozenset({"gas_profile_peak"}),
            frozenset({"wall_loss"}),
            frozenset({"tertiary", "cooling_flow"}),
            frozenset(),
        ),
    ),
)
PLANS = {plan.name: plan for plan in (STANDARD, WIDE)}


def design(
    seed: int = SEED,
    training: int | None = None,
    test: int | None = None,
    plan: Plan = STANDARD,
) -> Array:
    """Inputs of all runs, (training + test, d): two independent designs.

    >>> design(training=3, test=2).shape, design(training=6, test=5, plan=WIDE).shape
    ((5, 4), (11, 8))
    """
    training = plan.training if training is None else training
    test = plan.test if test is None else test
    return np.vstack(
        [_part(plan, n, seed_of(seed, plan.name, part))
         for n, part in ((training, "training"), (test, "test"))]
    )  # fmt: skip


def _part(plan: Plan, n: int, seed: int) -> Array:
    """n points (n, d): maximin Latin hypercubes of the whole box and of the inner one."""
    low, high = np.array(list(plan.bounds.values())).T
    if plan.near is None:
        return maximin_lhs(n, low, high, seed)
    near, count = plan.near, round(plan.near.share * n)
    inner = np.array([near.bounds.get(name, box) for name, box in plan.bounds.items()])
    close = maximin_lhs(count, inner[:, 0], inner[:, 1], seed_of(seed, "near"))
    for j, name in enumerate(plan.bounds):
        if name in near.asleep:
            asleep = [name not in near.awake[i % len(near.awake)] for i in range(count)]
            close[asleep, j] = near.asleep[name]
    return np.vstack([maximin_lhs(n - count, low, high, seed), close])
