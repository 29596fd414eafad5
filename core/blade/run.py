"""One finite-element run: inputs in, fields at every node and instant out.

    simulate({"tbc_thickness": 1.0, "t1t_rate": 0.9, "creep_transient": 0.0, "creep_steady": 0.0})

temperature → stiffness → creep in time → fields at nodes. Instants: t = 0 (loaded and hot, before
any creep), 15 logarithmic in 1 … 1000 h, 38 linear to 50,000 h.

Measured by ``tests/benchmarks/bench_blade.py`` on a busy two-core EPYC, one thread: seconds of one
run, and elongation after 50,000 h against the mesh "fine" (12,048 nodes) at the centre and at the
hottest (2/3, 1, 3, 3), coolest (4/3, 0.8, -3, -3) and two mixed corners of the box.

    ========  ======  ========  ==============  =======================
    mesh      nodes   seconds   error, centre   largest error, corners
    ========  ======  ========  ==============  =======================
    coarse     1,536  1.2 - 4.6   -0.67 %          2.2 %
    default    5,600  7 - 22       0.06 %          0.26 %
    fine      12,048  22 - 72
    ========  ======  ========  ==============  =======================

The default mesh takes 360 MB. CEEQ and damage at a node are means over the Gauss points around it
(:mod:`core.blade.projection`), so that they depend on the mesh where they fall steeply through the
wall. CEEQ of default and fine differs at "critical" by 1 - 2 % from 25,000 h and by up to 10 %
before 1000 h (damage: 3 - 7 and 20 %), at the leading edge by 5 - 30 %.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.blade.creep import DAMAGE, EPS_P, EPS_S, STATE, coefficients
from core.blade.element import Array
from core.blade.geometry import BladeMesh, build_mesh, interpolate
from core.blade.inputs import check_inputs, declared
from core.blade.integrate import Tolerance, Work, advance
from core.blade.mechanics import Solver, Structure
from core.blade.projection import Projection
from core.blade.properties import Properties
from core.blade.thermal import metal_temperature
from core.errors import InputError

FIELDS = ("ceeq", "creep_damage", "mises", "displacement")


def output_times() -> Array:
    """The 54 instants in h.

    >>> t = output_times()
    >>> len(t), t[0], t[1], t[15], t[53]
    (54, np.float64(0.0), np.float64(1.0), np.float64(1000.0), np.float64(50000.0))
    """
    times = np.concatenate([[0.0], np.logspace(0, 3, 15), np.linspace(1000.0, 50000.0, 39)[1:]])
    times[15] = 1000.0
    return times


@dataclass(frozen=True, slots=True, eq=False)
class BladeRun:
    """The result of one run, arrays read-only; T instants, N nodes.

    time_h        (T,) h
    ceeq          (T, N) equivalent creep strain
    creep_damage  (T, N) Robinson's life fraction, uncapped
    mises         (T, N) MPa
    displacement  (T, N, 3) mm, total: elastic, thermal and creep
    elongation    (T,) mm, permanent: u_z(t) - u_z(0) at the node "tip"
    temperature   (N,) K
    """

    inputs: dict[str, float]
    mesh: str
    time_h: Array
    ceeq: NDArray[np.floating]
    creep_damage: NDArray[np.floating]
    mises: NDArray[np.floating]
    displacement: NDArray[np.floating]
    elongation: Array
    temperature: NDArray[np.floating]

    def __post_init__(self) -> None:
        for name in ("time_h", *FIELDS, "elongation", "temperature"):
            getattr(self, name).setflags(write=False)

    @property
    def deformation(self) -> NDArray[np.floating]:
        """(T, N, 3) mm, permanent: displacement(t) - displacement(0)."""
        return np.asarray(self.displacement - self.displacement[0])


def check_times(time_h: Array) -> Array:
    """Output instants: at least two, finite, increasing, from 0."""
    times = np.array(time_h, dtype=np.float64)
    if times.ndim != 1 or len(times) < 2 or not np.all(np.isfinite(times)):
        raise InputError("time_h", times.tolist(), "is no list of instants", "give finite hours")
    if times[0] != 0 or np.any(np.diff(times) <= 0):
        raise InputError(
            "time_h", times.tolist(), "does not increase from 0", "start at 0 and sort"
        )
    return times


def simulate(
    inputs: Mapping[str, float],
    mesh: str | BladeMesh = "default",
    properties: Properties | None = None,
    progress: Callable[[float], None] | None = None,
    *,
    time_h: Array | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    tolerance: Tolerance | None = None,
    solver: Solver = "splu",
    dtype: type[np.float32] | type[np.float64] = np.float32,
    work: Work | None = None,
) -> BladeRun:
    """Simulate one blade.

    inputs      the four of :data:`core.blade.inputs.BOUNDS`, and dormant ones that are not at
                their nominal value; `bounds` widens or narrows boxes by name
    mesh        a name of :data:`core.blade.geometry.MESHES`, or a mesh of the blade as it is
    properties  material, geometry, cooling; none: the declared ones
    progress    called with the finished fraction of the instants
    time_h      instants; none: :func:`output_times`
    dtype       of the stored fields; the computation is float64
    work        filled with the numbers of steps and evaluations

    Raises InputError and RangeError for inputs, ModelError if the creep rate explodes.
    """
    checked = check_inputs(inputs, bounds)
    times = check_times(output_times() if time_h is None else time_h)
    properties = declared(properties or Properties(), checked)
    grid = build_mesh(mesh, properties.geometry) if isinstance(mesh, str) else mesh
    temperature = metal_temperature(grid, checked["tbc_thickness"], checked["t1t_rate"], properties)
    structure = Structure(grid, temperature, properties, solver=solver)
    law = coefficients(properties.creep, checked["creep_transient"], checked["creep_steady"])
    out = Recorder(grid, structure, times, dtype)
    u = np.empty(0)

    def rates(state: Array) -> tuple[Array, float]:
        nonlocal u
        u = structure.displacement(state)
        return structure.rates(u, state, law)

    states = advance(
        rates,
        np.zeros((structure.points, STATE)),
        times,
        tolerance or Tolerance(),
        work,
    )
    for i, state in enumerate(states):  # the last rates taken are those of this state: so is u
        out.record(i, u, structure.stress(u, state), state)
        if progress is not None:
            progress((i + 1) / len(times))
    return out.run(checked, temperature)


class Recorder:
    """Fields at nodes, instant by instant."""

    def __init__(
        self, grid: BladeMesh, structure: Structure, times: Array, dtype: type[np.floating[Any]]
    ) -> None:
        self._grid, self._times, self._dtype = grid, times, dtype
        self._project = Projection(grid, structure.volume, structure.order)
        n = len(grid.points)
        self._fields = {name: np.empty((len(times), n), dtype=dtype) for name in FIELDS[:3]}
        self._displacement = np.empty((len(times), n, 3), dtype=dtype)
        self._tip_z = np.empty(len(times))

    def record(self, i: int, u: Array, stress: Array, state: Array) -> None:
        """Instant `i`: displacement (3N,), stress (G, 6) and creep state (G, 9)."""
        strain = np.stack([state[:, EPS_P] + state[:, EPS_S], state[:, DAMAGE]], axis=1)
        fields = self._fields
        fields["ceeq"][i], fields["creep_damage"][i] = self._project.positive(strain).T
        fields["mises"][i] = von_mises(self._project.consistent(stress))
        self._displacement[i] = u.reshape(-1, 3)
        self._tip_z[i] = u[3 * self._grid.named["tip"] + 2]

    def run(self, inputs: Mapping[str, float], temperature: Array) -> BladeRun:
        """What was recorded, as a run."""
        return BladeRun(
            inputs=dict(inputs),
            mesh=self._grid.name,
            time_h=self._times,
            displacement=self._displacement,
            elongation=self._tip_z - self._tip_z[0],
            temperature=temperature.astype(self._dtype),
            **self._fields,
        )


def von_mises(stress: Array) -> Array:
    """q (…,) of stresses (…, 6) xx, yy, zz, yz, xz, xy.

    >>> float(von_mises(np.array([0.0, 0.0, -165.0, 0.0, 0.0, 0.0])))
    165.0
    """
    deviator = stress[..., :3] - stress[..., :3].mean(axis=-1, keepdims=True)
    square = 1.5 * (deviator**2).sum(axis=-1) + 3 * (stress[..., 3:] ** 2).sum(axis=-1)
    return np.asarray(np.sqrt(square))


def on_mesh(run: BladeRun, mesh_from: BladeMesh, mesh_to: BladeMesh) -> BladeRun:
    """The same run with its fields at the nodes of another mesh (truth on a finer mesh).

    Elongation is kept: the tip is the same point. CEEQ and damage are linear along element edges,
    so that the element's functions reduce to the trilinear ones and keep them positive.
    """

    def moved(values: NDArray[np.floating]) -> NDArray[np.floating]:
        first = np.moveaxis(np.asarray(values, dtype=np.float64), 1, 0)
        there = np.moveaxis(interpolate(mesh_from, first, mesh_to), 0, 1)
        return np.ascontiguousarray(there, dtype=values.dtype)

    temperature = interpolate(mesh_from, np.asarray(run.temperature, np.float64), mesh_to)
    return BladeRun(
        inputs=run.inputs,
        mesh=mesh_to.name,
        time_h=run.time_h,
        ceeq=moved(run.ceeq),
        creep_damage=moved(run.creep_damage),
        mises=moved(run.mises),
        displacement=moved(run.displacement),
        elongation=run.elongation,
        temperature=temperature.astype(run.temperature.dtype),
    )
