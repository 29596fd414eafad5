"""Truths of the study of adaptive designs: what a run gives, and where runs are kept.

A truth maps inputs (n, d) to courses (n, 2, T): tip elongation [mm] and mean CEEQ.
`finite_elements` runs the blade on the mesh ``coarse``; `formula` is a closed form of the same
kind, for tests. Runs of finite elements are kept by the digest of their inputs, so that a study
that was cut goes on, and designs that ask for the same point share its run.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive, Input, Mesh, Quantity, Run
from core.blade import BOUNDS, output_times, simulate
from core.blade.kept import kept_runs
from core.builtin.rotor_blade import blade_digest
from core.rng import stream
from core.validation.fe_rotors import load

Array = NDArray[np.float64]
Truth = Callable[[Array], Array]
Rotor = Callable[[int], Array]
Progress = Callable[[int, int], None]
MESH = "coarse"
OUTAGES_H = (8_000.0, 16_000.0, 24_000.0)
TIME_H = np.union1d(output_times(), OUTAGES_H)
LOW, HIGH = (np.array(side) for side in zip(*BOUNDS.values(), strict=True))
QUANTITIES = (Quantity("ceeq", "1", "field"), Quantity("elongation", "mm", "scalar"))


def run_blade(*point: float) -> Array:
    """One finite-element run: elongation and mean CEEQ at `TIME_H`, (2, T)."""
    run = simulate(dict(zip(BOUNDS, point, strict=True)), MESH, time_h=TIME_H)
    return np.stack([run.elongation, run.ceeq.mean(axis=1)])


def finite_elements(
    folder: str | Path, workers: int = 1, progress: Progress | None = None
) -> Truth:
    """The blade's runs, those that `folder` lacks in `workers` processes (1: in this one)."""
    own = place(folder)

    def truth(x: Array) -> Array:
        todo = {name_of(point): tuple(map(float, point)) for point in x}
        if workers > 1:
            found: Mapping[str, Array] = kept_runs(own, todo, run_blade, workers, progress)
        else:
            found = {}
            for done, (name, point) in enumerate(todo.items(), 1):
                found[name] = kept_run(own, name, point)
                if progress is not None:
                    progress(done, len(todo))
        return np.array([found[name_of(point)] for point in x])

    return truth


def place(folder: str | Path) -> Path:
    """Where the runs of this mesh, these instants and this code lie inside `folder`."""
    text = f"{MESH} {blade_digest()}".encode() + TIME_H.tobytes()
    return Path(folder) / f"runs-{sha256(text).hexdigest()[:12]}"


def name_of(point: Array) -> str:
    """A run's name: the digest of its inputs to the last bit."""
    return sha256(np.ascontiguousarray(point, dtype=np.float64).tobytes()).hexdigest()[:16]


def kept_run(own: Path, name: str, point: Sequence[float]) -> Array:
    """A run that is kept, or made and kept now; it appears whole or not at all."""
    file = own / f"{name}.npy"
    if not file.exists():
        own.mkdir(parents=True, exist_ok=True)
        part = own / f".{name}.{os.getpid()}.npy"
        np.save(part, run_blade(*point))
        os.replace(part, file)
    return np.asarray(np.load(file, allow_pickle=False))


def formula(x: Array) -> Array:
    """A blade in closed form: metal temperature, primary and secondary creep, thermal pattern.

    >>> y = formula(np.array([[1.0, 0.9, 0.0, 0.0], [0.8, 0.9, 0.0, 0.0]]))
    >>> bool(y[1, 0, -1] > y[0, 0, -1] > 0.0)
    True
    """
    coating, rate, transient, steady = x.T[:, :, None]
    hot = 1185.0 - 600.0 * (1.0 - rate)
    metal = 500.0 + (hot - 500.0) / (1.0 + 0.55 * coating**0.8) + 273.15
    secondary = 3.4e-8 * np.exp(0.35 * steady + 31_000.0 * (1.0 / 1060.0 - 1.0 / metal))
    primary = 3e-4 * np.exp(0.35 * transient + 4_000.0 * (1.0 / 1060.0 - 1.0 / metal))
    ceeq = primary * -np.expm1(-TIME_H * secondary / 1e-4) + secondary * TIME_H
    length = 180.0 * (1.0 + 0.25 * np.tanh((metal - 1060.0) / 60.0) * coating)
    pattern = 1.0 + 0.12 * np.log1p(ceeq / 1e-3)
    return np.stack([ceeq * length * pattern, ceeq], axis=1)


def blade_rotor(number: int) -> Array:
    """Elongation of the blades of a finite-element rotor at the outages, (blades, outages) [mm].

    Of the 14 rotors that `core.validation.fe_rotors` keeps (mesh ``default``, finer than that of
    the runs) every third by gas temperature, from the second coolest on.
    """
    kept = load()
    order = np.argsort(kept.inputs[:, 0, list(BOUNDS).index("t1t_rate")])
    rotor = int(order[(1 + 3 * number) % len(order)])
    return np.stack([kept.at("elongation", rotor, hours) for hours in OUTAGES_H], axis=1)


def formula_rotor(number: int, blades: int = 20, seed: int = 7) -> Array:
    """The same of a rotor whose blades are the formula's."""
    rng = stream(seed, "adaptive study", "rotor", number)
    x = LOW + rng.random((blades, len(LOW))) * (HIGH - LOW)
    x[:, 1] = LOW[1] + (number % 5 + rng.random()) / 5 * (HIGH[1] - LOW[1])
    return formula(x)[:, 0, np.searchsorted(TIME_H, OUTAGES_H)]


def archive_of(folder: str | Path, seed: int) -> Archive:
    """An archive of courses: elongation, and mean CEEQ as the field of one node."""
    return Archive.create(
        folder,
        inputs=[Input(name, low, high) for name, (low, high) in BOUNDS.items()],
        time_h=TIME_H,
        mesh=Mesh("mean", np.zeros((1, 3)), np.zeros((0, 0), np.int64), np.zeros((1, 3)), {}),
        seed=seed,
        command="bladetwin study adaptive",
        quantities=QUANTITIES,
    )


def write(archive: Archive, first: int, x: Array, courses: Array) -> None:
    """Runs with the indices first, first + 1, …"""
    for k, (point, (elongation, ceeq)) in enumerate(zip(x, courses, strict=True), first):
        inputs = dict(zip(BOUNDS, map(float, point), strict=True))
        archive.write(k, Run(inputs, {"elongation": elongation, "ceeq": ceeq[:, None]}))
