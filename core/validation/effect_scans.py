"""The 3-D deformation of fleets' blades: what a scanner sees of effects of physics.

    first   rotor `ROTOR` of `effect_fleet`, the one in which every effect of two noises is about
            as strong as it was run; its elongation is there
    second  a rotor of its own, other blades and hotter by a hundredth (`GAS`): what is found of
            the first need not be its peculiarity

Deformation, less that at once after loading, of nodes of the outer skin, at a blade's hours at the
visits and at the horizon. Without effects on the mesh ``default``, on which the
surrogate was trained; an effect is the change that it makes on the mesh ``coarse``. The nodes are
those that both meshes have at the same place, so that nothing is interpolated.

    bladetwin study truths --scans [--rotor second]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from core.blade import BOUNDS, BladeRun, build_mesh, simulate, simulate_history
from core.blade.kept import kept_runs
from core.builtin.inspection_plan import scanned_nodes
from core.builtin.plans import WIDER
from core.errors import InputError
from core.rng import stream
from core.validation import effect_fleet as fleet
from core.validation.effect_fleet import BLADES, EFFECTS, FIVE_AGES

Array = NDArray[np.float64]
Nodes = NDArray[np.int64]
FIRST, SECOND = "first", "second"
FILES = {FIRST: "effect_scans.npz", SECOND: "effect_scans_second.npz"}
ROTOR, SAME = 1, 1e-9  # mm
GAS = 0.7  # place of the second rotor's gas in its prior, 0.94 of the nominal
UNIT = 1e-4  # mm, in which shapes are kept: a scan's noise is 300 times as large
COURSES = ("default", "sound", *EFFECTS)


def shipped(rotor: str = FIRST) -> Path:
    """The file of a rotor; InputError where there is none of the name."""
    if rotor not in FILES:
        raise InputError("rotor", rotor, "is unknown", f"use {', '.join(FILES)}")
    return Path(__file__).with_name(FILES[rotor])


@cache
def nodes() -> dict[str, Nodes]:
    """The nodes by mesh, (N,) each: on the outer skin, those that are in both.

    >>> [len(own) for own in nodes().values()]
    [96, 96]
    """
    fine, coarse = build_mesh("default"), build_mesh("coarse")
    skin = scanned_nodes()
    apart, there = cKDTree(coarse.points).query(fine.points[skin])
    both = np.flatnonzero(apart < SAME)
    return {"default": skin[both], "coarse": there[both]}


@cache
def design(rotor: str = FIRST) -> Array:
    """Inputs of all blades in the order of `BOUNDS`, (B, 4)."""
    if rotor == FIRST:
        return np.asarray(FIVE_AGES.design()[ROTOR])
    return fleet.drawn(stream(fleet.SEED, "scanned fleet", 1), lambda _: GAS)


def run(rotor: str, blade: int, what: str) -> Array:
    """Elongation and deformation [mm] at `Fleet.own_h`, (V + 1, 1 + 3 N); ``default``, ``sound`` or
    an effect."""
    inputs = dict(zip(BOUNDS, map(float, design(rotor)[blade]), strict=True))
    times, mesh = (
        np.array([0.0, *FIVE_AGES.own_h(blade)]),
        "default" if what == "default" else "coarse",
    )
    if what in ("default", "sound"):
        done: BladeRun = simulate(inputs, mesh, time_h=times)
    else:
        changed, bounds = FIVE_AGES.course(what, inputs, blade), {**BOUNDS, **WIDER}
        done = simulate_history(changed, mesh, time_h=times, bounds=bounds)
    at = done.displacement[:, nodes()[mesh]]
    return np.column_stack([done.elongation[1:], (at[1:] - at[0]).reshape(len(times) - 1, -1)])


def runs(rotor: str = FIRST) -> dict[str, tuple[str, int, str]]:
    """All runs by name: rotor, blade, what."""
    return {f"{what}-{b:03d}": (rotor, b, what) for what in COURSES for b in range(BLADES)}


def make(
    folder: str | Path,
    out: str | Path,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
    rotor: str = FIRST,
) -> Path:
    """All runs as one small file (to `UNIT`); a cut campaign goes on in `folder`."""
    own = Path(folder) / f"scans-{rotor}"
    return packed(kept_runs(own, runs(rotor), run, workers, progress), out)


def packed(done: Mapping[str, Array], out: str | Path) -> Path:
    """What is without effects, and the change by each; InputError where a run is missing."""
    if missing := [name for name in runs() if name not in done]:
        raise InputError("runs", len(missing), "are missing", "run the campaign to its end")
    plain, sound, *changed = (
        np.array([done[f"{what}-{b:03d}"] for b in range(BLADES)]) for what in COURSES
    )
    shape = (*plain.shape[:2], -1, 3)
    changes = np.array([(one - sound)[..., 1:].reshape(shape) for one in changed])
    kept = [np.round(one / UNIT) for one in (plain[..., 1:].reshape(shape), changes)]
    np.savez_compressed(
        out,
        nodes=nodes()["default"].astype(np.int32),
        deformation=kept[0].astype(np.int32),
        change=kept[1].astype(np.int32),
        elongation=np.round(plain[..., 0], 7),
        share=np.round([one[..., 0] / sound[..., 0] for one in changed], 6),
    )
    return Path(out)


@dataclass(frozen=True)
class Truths:
    """Of a rotor's B blades at V visits and the horizon.

    nodes       (N,); shape: deformation without effects [mm], (B, V + 1, N, 3)
    change      by effect, what it adds to the shape
    elongation  without effects [mm], (B, V + 1); shares: by effect, with it over that without
    """

    nodes: Nodes
    shape: Array
    change: Mapping[str, Array]
    elongation: Array
    shares: Mapping[str, Array]


def load(rotor: str = FIRST) -> Truths:
    """What ships of a rotor."""
    with np.load(shipped(rotor), allow_pickle=False) as data:
        kept = dict(data)
    if rotor == FIRST:  # elongations are with those of its fleet
        with np.load(FIVE_AGES.shipped, allow_pickle=False) as data:
            kept |= {"elongation": data["elongation"][ROTOR], "share": data["share"][:, ROTOR]}
    change, share = (dict(zip(EFFECTS, kept[name], strict=True)) for name in ("change", "share"))
    return Truths(
        kept["nodes"].astype(np.int64),
        UNIT * kept["deformation"].astype(float),
        {effect: UNIT * one.astype(float) for effect, one in change.items()},
        kept["elongation"],
        share,
    )
