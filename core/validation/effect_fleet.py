"""A hundred blades of different ages, each read three times: truths with and without effects.

`ROTORS` rotors of 100 blades; blades joined at `JOINED_H` of the rotor's hours, twenty each time,
and are read at `VISITS_H`, so that one day's readings are of blades of 4,000 to 44,000 h. Effects,
by the finite-element model with courses in time:

    wear      the coating loses `LOST` of its thickness by 50,000 h of the blade, linearly
    fouling   the gas gets hotter by `FOULED` in 50,000 h of the rotor, linearly
    step      gas hotter by `HOTTER` from 29,000 h of the rotor on, between the first two visits
    tertiary  creep accelerates with its damage, c = `TERTIARY`
    pulse     gas hotter by `PULSE` from 26,000 to 32,000 h of the rotor, then as before, which no
              family of the grammar says

Elongation without effects is of runs on the mesh ``default``, on which the surrogate was trained.
Effects are shares: elongation with over elongation without, both on the mesh ``coarse``, for the
share hardly knows the mesh. The last instant, `HORIZON_H`, is nobody's reading: it is forecast.

    bladetwin study truths --fleet
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
SHIPPED = Path(__file__).with_name("effect_fleet.npz")
SEED, ROTORS, BLADES = 3001, 2, 100
JOINED_H = (0.0, 5_000.0, 10_000.0, 15_000.0, 20_000.0)
VISITS_H = (24_000.0, 34_000.0, 44_000.0)
HORIZON_H = 50_000.0
LOST, FOULED, HOTTER, PULSE, TERTIARY = 0.15, 0.012, 0.01, 0.02, 1.5
STEP_H, PULSE_H = 29_000.0, (26_000.0, 32_000.0)
EFFECTS = ("wear", "fouling", "step", "tertiary", "pulse")


def joined_h(blade: int) -> float:
    """The rotor's hours when a blade joined.

    >>> joined_h(0), joined_h(99)
    (0.0, 20000.0)
    """
    return JOINED_H[blade * len(JOINED_H) // BLADES]


def own_h(blade: int) -> Array:
    """A blade's hours at the visits and at the horizon, (V + 1,).

    >>> own_h(99)
    array([ 4000., 14000., 24000., 50000.])
    """
    return np.array([*(v - joined_h(blade) for v in VISITS_H), HORIZON_H])


def design(seed: int = SEED) -> Array:
    """Inputs of all blades in the order of `BOUNDS`, (rotors, blades, 4).

    One t1t_rate per rotor, in one of `ROTORS` equal slices of the middle half of its prior: at its
    ends an effect would leave the box that the wide model was trained in.
    """

    def of(rotor: int) -> Array:
        return drawn(stream(seed, "fleet", rotor), lambda u: 0.25 + 0.5 * (rotor + u) / ROTORS)

    return np.stack([of(r) for r in range(ROTORS)])


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


def course(effect: str, inputs: dict[str, float], blade: int) -> dict[str, Any]:
    """Inputs of a blade with the effect, by its own hours.

    >>> course("step", {"t1t_rate": 0.9}, 99)["t1t_rate"]
    [(0.0, 0.9), (9000.0, 0.9), (9000.0, 0.91)]
    >>> course("fouling", {"t1t_rate": 0.9}, 99)["t1t_rate"]
    [(0.0, 0.9048), (50000.0, 0.9168)]
    """
    gas, late = inputs.get("t1t_rate", 0.0), joined_h(blade)
    if effect == "wear":
        coating = inputs["tbc_thickness"]
        return {**inputs, "tbc_thickness": [(0.0, coating), (5e4, (1.0 - LOST) * coating)]}
    if effect == "tertiary":
        return {**inputs, "tertiary": TERTIARY}
    if effect == "fouling":
        hot = gas + FOULED * late / 5e4
        return {**inputs, "t1t_rate": [(0.0, round(hot, 9)), (5e4, round(hot + FOULED, 9))]}
    if effect == "step":
        own = STEP_H - late
        return {**inputs, "t1t_rate": [(0.0, gas), (own, gas), (own, round(gas + HOTTER, 9))]}
    begins, ends = (h - late for h in PULSE_H)
    hot = round(gas + PULSE, 9)
    return {
        **inputs,
        "t1t_rate": [(0.0, gas), (begins, gas), (begins, hot), (ends, hot), (ends, gas)],
    }


def run(rotor: int, blade: int, effect: str | None) -> Array:
    """Elongation [mm] of a blade at `own_h`, (V + 1,); none: without effects, on mesh default."""
    inputs = dict(zip(BOUNDS, map(float, design()[rotor, blade]), strict=True))
    times = np.array([0.0, *own_h(blade)])
    if effect is None:
        return np.asarray(simulate(inputs, "default", time_h=times).elongation[1:])
    if effect == "sound":
        return np.asarray(simulate(inputs, "coarse", time_h=times).elongation[1:])
    changed, bounds = course(effect, inputs, blade), {**BOUNDS, **WIDER}
    return np.asarray(
        simulate_history(changed, "coarse", time_h=times, bounds=bounds).elongation[1:]
    )


def runs() -> dict[str, tuple[int, int, str | None]]:
    """All runs by name: rotor, blade, effect."""
    return {
        f"{effect}-{rotor}-{blade:03d}": (rotor, blade, None if effect == "default" else effect)
        for rotor in range(ROTORS)
        for effect in ("default", "sound", *EFFECTS)
        for blade in range(BLADES)
    }


def make(
    folder: str | Path,
    out: str | Path = SHIPPED,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """All runs as one small file; a cut campaign goes on in `folder`."""
    done = kept_runs(folder, runs(), run, workers, progress)
    return packed(done, out)


def packed(done: Mapping[str, Array], out: str | Path = SHIPPED) -> Path:
    """The whole rotors among these runs as one file; InputError where there is none."""
    names = {r: [n for n, (rotor, _, _) in runs().items() if rotor == r] for r in range(ROTORS)}
    whole = [r for r in range(ROTORS) if all(n in done for n in names[r])]
    if not whole:
        raise InputError("runs", len(done), "hold no whole rotor", "run the campaign to its end")

    def of(effect: str) -> Array:
        rows = [[done[f"{effect}-{r}-{b:03d}"] for b in range(BLADES)] for r in whole]
        return np.array(rows)

    np.savez_compressed(
        out,
        inputs=design()[whole],
        elongation=np.round(of("default"), 7),
        share=np.round([of(effect) / of("sound") for effect in EFFECTS], 6),
    )
    return Path(out)
