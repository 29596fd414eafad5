"""What effects of physics do to blades, by finite elements: truths of the study of diagnoses.

Four of the rotors of `fe_rotors` (20 blades each, runs on the mesh ``default``), and of each

    wear      eight blades, their coating lot: 40 % of the coating lost by 50,000 h, linearly
    step      all: gas hotter by 0.02 from 17,500 h of the rotor on
    tertiary  all: creep accelerates with damage, c = 3
    pulse     all: gas hotter by 0.03 from 8,000 to 15,000 h of the rotor, then as before, which no
              family of the grammar says

The last six blades joined at 14,000 h of the rotor. As shares: elongation with the effect over
elongation without, both on the mesh ``coarse``, for the share hardly knows the mesh.

    bladetwin study truths
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.blade import BOUNDS, simulate, simulate_history
from core.blade.kept import kept_runs
from core.builtin.plans import WIDER
from core.validation import fe_rotors

Array = NDArray[np.float64]
SHIPPED = Path(__file__).with_name("effect_truths.npz")
ROTORS = (0, 3, 4, 7)
JOINED, JOINED_H = tuple(range(14, 20)), 14_000.0
WORN = tuple(range(9, 17))
VISITS_H = tuple(7_000.0 * k for k in range(1, 8))
LOST, HOTTER, PULSE, TERTIARY = 0.4, 0.02, 0.03, 3.0
STEP_H, PULSE_H = 17_500.0, (8_000.0, 15_000.0)
EFFECTS = ("wear", "step", "tertiary", "pulse")


def offset_h(blade: int) -> float:
    """The rotor's hours when a blade joined."""
    return JOINED_H if blade in JOINED else 0.0


def course(effect: str, inputs: dict[str, float], blade: int) -> dict[str, Any]:
    """Inputs of a blade with the effect, by its own hours.

    >>> course("step", {"t1t_rate": 0.9}, 15)["t1t_rate"]
    [(0.0, 0.9), (3500.0, 0.9), (3500.0, 0.92)]
    """
    gas, late = inputs.get("t1t_rate", 0.0), offset_h(blade)
    if effect == "wear":
        coating = inputs["tbc_thickness"]
        return {**inputs, "tbc_thickness": [(0.0, coating), (5e4, (1.0 - LOST) * coating)]}
    if effect == "tertiary":
        return {**inputs, "tertiary": TERTIARY}
    if effect == "step":
        own = STEP_H - late
        return {**inputs, "t1t_rate": [(0.0, gas), (own, gas), (own, round(gas + HOTTER, 9))]}
    begins, ends = (max(0.0, h - late) for h in PULSE_H)
    hot = gas + PULSE
    points = [(begins, hot), (ends, hot), (ends, gas)]
    return {**inputs, "t1t_rate": points if begins == 0 else [(0.0, gas), (begins, gas), *points]}


def run(rotor: int, blade: int, effect: str) -> Array:
    """Elongation of a blade at `VISITS_H` of its own, with an effect over without, (V,)."""
    x = fe_rotors.load().inputs[rotor, blade]
    inputs = dict(zip(BOUNDS, map(float, x), strict=True))
    times, bounds = np.array([0.0, *VISITS_H]), {**BOUNDS, **WIDER}
    changed = course(effect, inputs, blade)
    with_ = simulate_history(changed, "coarse", time_h=times, bounds=bounds).elongation
    sound = simulate(inputs, "coarse", time_h=times).elongation
    return np.asarray(with_[1:] / sound[1:])


def concerned(effect: str) -> tuple[int, ...]:
    """Blades that have the effect."""
    return WORN if effect == "wear" else tuple(range(fe_rotors.BLADES))


def runs() -> dict[str, tuple[int, int, str]]:
    """All runs by name: rotor, blade, effect."""
    return {
        f"{effect}-{rotor:02d}-{blade:02d}": (rotor, blade, effect)
        for rotor in ROTORS
        for effect in EFFECTS
        for blade in concerned(effect)
    }


def make(
    folder: str | Path,
    out: str | Path = SHIPPED,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """All shares as one small file; a cut campaign goes on in `folder`."""
    done = kept_runs(folder, runs(), run, workers, progress)
    shares = np.ones((len(ROTORS), len(EFFECTS), fe_rotors.BLADES, len(VISITS_H)))
    for name, share in done.items():
        effect, rotor, blade = name.split("-")
        shares[ROTORS.index(int(rotor)), EFFECTS.index(effect), int(blade)] = share
    np.savez_compressed(out, share=np.round(shares, 6))
    return Path(out)


def share(rotor: int, effect: str) -> Array:
    """By how much an effect makes a rotor's blades longer, at `VISITS_H` of their own, (B, V)."""
    with np.load(SHIPPED, allow_pickle=False) as data:
        return np.asarray(data["share"][ROTORS.index(rotor), EFFECTS.index(effect)])
