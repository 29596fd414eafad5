"""The rotor blade by finite elements: geometry, temperature, creep, equilibrium, runs.

    >>> from core.blade import build_mesh, simulate
    >>> point = {"tbc_thickness": 1.0, "t1t_rate": 0.9, "creep_transient": 0.0, "creep_steady": 0.0}
    >>> run = simulate(point, "coarse", time_h=[0.0, 10.0])
    >>> run.displacement.shape
    (2, 1536, 3)

The theory is in the modules: :mod:`~core.blade.properties` (every number), then
:mod:`~core.blade.geometry`, :mod:`~core.blade.thermal`, :mod:`~core.blade.creep`,
:mod:`~core.blade.mechanics`, :mod:`~core.blade.integrate`, :mod:`~core.blade.run`,
:mod:`~core.blade.history` and :mod:`~core.blade.campaign`.
"""

from core.blade.campaign import Campaign, Failure, run_campaign
from core.blade.geometry import MESHES, BladeMesh, build_mesh, interpolate
from core.blade.history import simulate_history
from core.blade.inputs import BOUNDS, DORMANT
from core.blade.properties import Properties
from core.blade.run import BladeRun, on_mesh, output_times, simulate

__all__ = [
    "BOUNDS",
    "DORMANT",
    "MESHES",
    "BladeMesh",
    "BladeRun",
    "Campaign",
    "Failure",
    "Properties",
    "build_mesh",
    "interpolate",
    "on_mesh",
    "output_times",
    "run_campaign",
    "simulate",
    "simulate_history",
]
