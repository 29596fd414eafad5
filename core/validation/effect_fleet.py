"""A hundred blades, each read a few times: truths with and without effects.

    `FIVE_AGES`   two rotors whose blades joined at five different hours, twenty each time, so that
                  one day's readings are of blades of 4,000 to 44,000 h; three visits
    `ONE_AGE`     a rotor whose blades all joined with it, as after a new set: what goes with age,
                  with the calendar and with the visit is told apart by the course in time alone;
                  three visits
    `SIX_VISITS`  another rotor of blades of five ages, six visits over the hours of `FIVE_AGES`

Effects, by the finite-element model with courses in time:

    wear      the coating loses `LOST` of its thickness by 50,000 h of the blade, linearly
    fouling   the gas gets hotter by `FOULED` in 50,000 h of the rotor, linearly
    step      gas hotter by `HOTTER` from an hour of the rotor on, between two visits
    tertiary  creep accelerates with its damage, c = `TERTIARY`
    pulse     gas hotter by `PULSE` for 6,000 h of the rotor between the same, then as before, which
              no family of the grammar says

Elongation without effects is of runs on the mesh ``default``, on which the surrogate was trained.
Effects are shares: elongation with over elongation without, both on the mesh ``coarse``, for the
share hardly knows the mesh. The last instant, `HORIZON_H`, is nobody's reading: it is forecast.

    bladetwin study truths --fleet
    bladetwin study truths --one-age
    bladetwin study truths --six-visits
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.blade import BOUNDS, simulate, simulate_history
from core.blade.kept import kept_runs
from core.builtin.paper_network import rotor_blade_network
from core.builtin.plans import WIDER
from core.errors import InputError
from core.rng import stream

Array = NDArray[np.float64]
SEED, BLADES = 3001, 100
HORIZON_H = 50_000.0
LOST, FOULED, HOTTER, PULSE, TERTIARY = 0.15, 0.012, 0.01, 0.02, 1.5
EFFECTS = ("wear", "fouling", "step", "tertiary", "pulse")


@dataclass(frozen=True, slots=True)
class Fleet:
    """Rotors of `BLADES` blades that differ in their inputs alone.

    file       what ships; drawn: name of the stream of the blades' inputs
    joined_h   the rotor's hours when blades joined, as many at each
    visits_h   the rotor's hours when they are read, (V,)
    step_h     and `pulse_h`: when the gas changes
    gas        place of each rotor's gas in its prior, 0 … 1; none: drawn
    odd        of the visits, that with a campaign's fault and the first with odd blades' fault
    """

    file: str
    drawn: str
    rotors: int
    joined_h: tuple[float, ...]
    visits_h: tuple[float, ...]
    step_h: float
    pulse_h: tuple[float, float]
    gas: tuple[float, ...] | None = None
    odd: tuple[int, int] = (1, 2)

    @property
    def shipped(self) -> Path:
        return Path(__file__).with_name(self.file)

    def late(self, blade: int) -> float:
        """The rotor's hours when a blade joined.

        >>> FIVE_AGES.late(0), FIVE_AGES.late(99), ONE_AGE.late(99)
        (0.0, 20000.0, 0.0)
        """
        return self.joined_h[blade * len(self.joined_h) // BLADES]

    def own_h(self, blade: int) -> Array:
        """A blade's hours at the visits and at the horizon, (V + 1,).

        >>> FIVE_AGES.own_h(99)
        array([ 4000., 14000., 24000., 50000.])
        """
        return np.array([*(v - self.late(blade) for v in self.visits_h), HORIZON_H])

    def design(self, seed: int = SEED) -> Array:
        """Inputs of all blades in the order of `BOUNDS`, (rotors, blades, 4).

        One t1t_rate per rotor, if drawn in one of as many equal slices of the middle half of its
        prior: at its ends an effect would leave the box that the wide model was trained in.
        """

        def place(rotor: int, u: float) -> float:
            if self.gas is not None:
                return self.gas[rotor]
            return 0.25 + 0.5 * (rotor + u) / self.rotors

        each = range(self.rotors)
        return np.stack([drawn(stream(seed, self.drawn, r), partial(place, r)) for r in each])

    def course(self, effect: str, inputs: dict[str, float], blade: int) -> dict[str, Any]:
        """Inputs of a blade with the effect, by its own hours.

        >>> FIVE_AGES.course("step", {"t1t_rate": 0.9}, 99)["t1t_rate"]
        [(0.0, 0.9), (9000.0, 0.9), (9000.0, 0.91)]
        >>> FIVE_AGES.course("fouling", {"t1t_rate": 0.9}, 99)["t1t_rate"]
        [(0.0, 0.9048), (50000.0, 0.9168)]
        """
        gas, late = inputs.get("t1t_rate", 0.0), self.late(blade)
        if effect == "wear":
            coating = inputs["tbc_thickness"]
            return {**inputs, "tbc_thickness": [(0.0, coating), (5e4, (1.0 - LOST) * coating)]}
        if effect == "tertiary":
            return {**inputs, "tertiary": TERTIARY}
        if effect == "fouling":
            hot = gas + FOULED * late / 5e4
            return {**inputs, "t1t_rate": [(0.0, round(hot, 9)), (5e4, round(hot + FOULED, 9))]}
        if effect == "step":
            own = self.step_h - late
            return {**inputs, "t1t_rate": [(0.0, gas), (own, gas), (own, round(gas + HOTTER, 9))]}
        begins, ends = (h - late for h in self.pulse_h)
        hot = round(gas + PULSE, 9)
        return {
            **inputs,
            "t1t_rate": [(0.0, gas), (begins, gas), (begins, hot), (ends, hot), (ends, gas)],
        }


FIVE_AGES = Fleet(
    "effect_fleet.npz",
    "fleet",
    2,
    (0.0, 5_000.0, 10_000.0, 15_000.0, 20_000.0),
    (24_000.0, 34_000.0, 44_000.0),
    29_000.0,
    (26_000.0, 32_000.0),
)
ONE_AGE = Fleet(
    "effect_one_age.npz",
    "one age",
    1,
    (0.0,),
    (12_000.0, 24_000.0, 36_000.0),
    18_000.0,
    (15_000.0, 21_000.0),
    (0.7,),
)
SIX_VISITS = Fleet(
    "effect_six_visits.npz",
    "six visits",
    1,
    FIVE_AGES.joined_h,
    (24_000.0, 28_000.0, 32_000.0, 36_000.0, 40_000.0, 44_000.0),
    30_000.0,
    (26_000.0, 32_000.0),
    odd=(3, 4),
)


def drawn(rng: np.random.Generator, shared: Callable[[float], float]) -> Array:
    """Inputs of a rotor's blades, (blades, 4): local ones from their priors, shared ones at a place
    in theirs, 0 … 1, that `shared` makes of a number drawn from 0 … 1."""
    network, x = rotor_blade_network(), np.empty((BLADES, len(BOUNDS)))
    for j, name in enumerate(BOUNDS):
        parameter = network.parameter(name)
        if parameter.level == "shared":
            place = np.full(BLADES, shared(rng.random()))
        else:
            place = rng.random(BLADES)
        x[:, j] = parameter.prior.quantile(place)
    return x


def run(of: Fleet, rotor: int, blade: int, effect: str | None) -> Array:
    """Elongation [mm] of a blade at `own_h`, (V + 1,); none: without effects, on mesh default."""
    inputs = dict(zip(BOUNDS, map(float, of.design()[rotor, blade]), strict=True))
    times = np.array([0.0, *of.own_h(blade)])
    if effect is None:
        return np.asarray(simulate(inputs, "default", time_h=times).elongation[1:])
    if effect == "sound":
        return np.asarray(simulate(inputs, "coarse", time_h=times).elongation[1:])
    changed, bounds = of.course(effect, inputs, blade), {**BOUNDS, **WIDER}
    return np.asarray(
        simulate_history(changed, "coarse", time_h=times, bounds=bounds).elongation[1:]
    )


def runs(of: Fleet = FIVE_AGES) -> dict[str, tuple[Fleet, int, int, str | None]]:
    """All runs by name: fleet, rotor, blade, effect."""
    return {
        f"{effect}-{rotor}-{blade:03d}": (of, rotor, blade, None if effect == "default" else effect)
        for rotor in range(of.rotors)
        for effect in ("default", "sound", *EFFECTS)
        for blade in range(BLADES)
    }


def make(
    folder: str | Path,
    out: str | Path,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
    of: Fleet = FIVE_AGES,
) -> Path:
    """All runs as one small file; a cut campaign goes on in `folder`."""
    own = Path(folder) / of.drawn.replace(" ", "-")
    return packed(kept_runs(own, runs(of), run, workers, progress), out, of)


def packed(done: Mapping[str, Array], out: str | Path, of: Fleet = FIVE_AGES) -> Path:
    """The whole rotors among these runs as one file; InputError where there is none."""
    every = runs(of)
    names = {
        r: [n for n, (_, rotor, _, _) in every.items() if rotor == r] for r in range(of.rotors)
    }
    whole = [r for r in range(of.rotors) if all(n in done for n in names[r])]
    if not whole:
        raise InputError("runs", len(done), "hold no whole rotor", "run the campaign to its end")

    def rows(effect: str) -> Array:
        return np.array([[done[f"{effect}-{r}-{b:03d}"] for b in range(BLADES)] for r in whole])

    np.savez_compressed(
        out,
        inputs=of.design()[whole],
        elongation=np.round(rows("default"), 7),
        share=np.round([rows(effect) / rows("sound") for effect in EFFECTS], 6),
    )
    return Path(out)
