"""The 3-D deformation of `effect_fleet`'s blades: what a scanner sees of effects of physics.

Of rotor `ROTOR`, the one in which every effect of two noises is about as strong as it was run:
deformation, less that at once after loading, of nodes of the outer skin, at a blade's hours at the
visits and at the horizon. Without effects on the mesh ``default``, on which the
surrogate was trained; an effect is the change that it makes on the mesh ``coarse``. The nodes are
those that both meshes have at the same place, so that nothing is interpolated.

    bladetwin study truths --scans
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
from core.validation.effect_fleet import BLADES, EFFECTS, course, design, own_h

Array = NDArray[np.float64]
Nodes = NDArray[np.int64]
SHIPPED = Path(__file__).with_name("effect_scans.npz")
ROTOR, SAME = 1, 1e-9  # mm
UNIT = 1e-4  # mm, in which shapes are kept: a scan's noise is 300 times as large
COURSES = ("default", "sound", *EFFECTS)


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


def run(blade: int, what: str) -> Array:
    """Deformation [mm] at `own_h`, (V + 1, N, 3); ``default``, ``sound`` or an effect."""
    inputs = dict(zip(BOUNDS, map(float, design()[ROTOR, blade]), strict=True))
    times, mesh = np.array([0.0, *own_h(blade)]), "default" if what == "default" else "coarse"
    if what in ("default", "sound"):
        done: BladeRun = simulate(inputs, mesh, time_h=times)
    else:
        changed, bounds = course(what, inputs, blade), {**BOUNDS, **WIDER}
        done = simulate_history(changed, mesh, time_h=times, bounds=bounds)
    at = done.displacement[:, nodes()[mesh]]
    return np.asarray(at[1:] - at[0], dtype=np.float64)


def runs() -> dict[str, tuple[int, str]]:
    """All runs by name: blade, what."""
    return {f"{what}-{b:03d}": (b, what) for what in COURSES for b in range(BLADES)}


def make(
    folder: str | Path,
    out: str | Path = SHIPPED,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """All runs as one small file (to `UNIT`); a cut campaign goes on in `folder`."""
    return packed(kept_runs(Path(folder) / "scans", runs(), run, workers, progress), out)


def packed(done: Mapping[str, Array], out: str | Path = SHIPPED) -> Path:
    """Deformation without effects, and the change by each; InputError where a run is missing."""
    if missing := [name for name in runs() if name not in done]:
        raise InputError("runs", len(missing), "are missing", "run the campaign to its end")
    plain, sound, *changed = (
        np.array([done[f"{what}-{b:03d}"] for b in range(BLADES)]) for what in COURSES
    )
    changes = np.array([one - sound for one in changed])
    kept = [np.round(one / UNIT) for one in (plain, changes)]
    np.savez_compressed(
        out,
        nodes=nodes()["default"].astype(np.int32),
        deformation=kept[0].astype(np.int32),
        change=kept[1].astype(np.int32),
    )
    return Path(out)


def load(path: str | Path = SHIPPED) -> tuple[Nodes, Array, dict[str, Array]]:
    """Nodes (N,), deformation without effects (B, V + 1, N, 3) [mm], and what each effect adds."""
    with np.load(path, allow_pickle=False) as data:
        shape, change = (UNIT * data[name].astype(float) for name in ("deformation", "change"))
        return data["nodes"].astype(np.int64), shape, dict(zip(EFFECTS, change, strict=True))
