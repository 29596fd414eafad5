"""A run whose inputs change in time: coatings that wear, gas that heats up, coolant that fails.

    simulate_history({"tbc_thickness": [(0.0, 1.0), (50_000.0, 0.4)], "t1t_rate": 0.9, …})

Each input is a constant or a course (`core.course`). The blade goes from piece to piece with its
creep strains; on a piece temperature, stiffness and creep law are those of the inputs' mean there.

What an inspection measures is cold: elongation and deformation are those of the creep strains
alone, on the structure as it was at the start, so that no thermal growth counts as permanent. With
constant inputs nothing differs from `core.blade.run.simulate`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from core.blade.creep import STATE, coefficients
from core.blade.element import Array
from core.blade.geometry import build_mesh
from core.blade.inputs import IN_TIME, check_inputs, declared
from core.blade.integrate import Tolerance, advance
from core.blade.mechanics import Solver, Structure
from core.blade.properties import Properties
from core.blade.run import BladeRun, Recorder, check_times, output_times
from core.blade.thermal import metal_temperature
from core.course import Course, pieces
from core.errors import InputError

PIECES = 24
Given = Mapping[str, float | Sequence[tuple[float, float]] | Course]


def courses_of(
    inputs: Given, bounds: Mapping[str, tuple[float, float]] | None = None
) -> dict[str, Course]:
    """Every input as a course inside its box; InputError and RangeError say which is not."""
    courses = {name: Course.of(given) for name, given in inputs.items()}
    for which in (np.min, np.max):
        check_inputs({name: float(which(c.values)) for name, c in courses.items()}, bounds)
    for name, course in courses.items():
        if name not in IN_TIME and not course.constant:
            raise InputError(
                name, course.points, "cannot change in time", f"these can: {', '.join(IN_TIME)}"
            )
    return courses


def simulate_history(
    inputs: Given,
    mesh: str = "default",
    properties: Properties | None = None,
    *,
    time_h: Array | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    tolerance: Tolerance | None = None,
    solver: Solver = "splu",
    dtype: type[np.floating[Any]] = np.float32,
    parts: int = PIECES,
    progress: Callable[[float], None] | None = None,
) -> BladeRun:
    """Simulate one blade through the courses of its inputs.

    parts   pieces at most for the whole change of an input

    The result's `inputs` are those at the start; displacement and temperature, too, are of the
    blade as it was then. Raises as `core.blade.run.simulate`.
    """
    courses = courses_of(inputs, bounds)
    times = check_times(output_times() if time_h is None else time_h)
    base = properties or Properties()
    start = {name: float(course.at(0.0)) for name, course in courses.items()}
    grid = build_mesh(mesh, declared(base, start).geometry)

    def blade(now: Mapping[str, float]) -> tuple[Structure, Array, Array]:
        """Structure, creep law and temperature of the blade under these inputs."""
        own = declared(base, now)
        temperature = metal_temperature(grid, now["tbc_thickness"], now["t1t_rate"], own)
        law = coefficients(own.creep, now["creep_transient"], now["creep_steady"])
        return Structure(grid, temperature, own, solver=solver), law, temperature

    cold, law, temperature = blade(start)
    out = Recorder(grid, cold, times, dtype)
    state, structure, held, done = np.zeros((cold.points, STATE)), cold, start, 0
    for begin, end in pieces(courses, float(times[-1]), parts):
        now = {name: course.mean(begin, end) for name, course in courses.items()}
        if now != held:
            structure, law, _ = blade(now)
            held = now

        def rates(y: Array, s: Structure = structure, law: Array = law) -> tuple[Array, float]:
            return s.rates(s.displacement(y), y, law)

        inside = times[(times > begin) & (times < end)]
        instants = np.concatenate([[begin], inside, [end]])
        states = advance(rates, state, instants, tolerance or Tolerance())
        for hour, reached in zip(instants, states, strict=True):
            state = reached
            if done < len(times) and hour == times[done]:
                stress = structure.stress(structure.displacement(state), state)
                out.record(done, cold.displacement(state), stress, state)
                done += 1
                if progress is not None:
                    progress(done / len(times))
    return out.run(start, temperature)
