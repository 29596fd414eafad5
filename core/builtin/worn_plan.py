"""The inspection plan with two effects in it that no model was told of.

The same rotor as `inspection_plan`, but for

    a coating lot that wears   blades of lot C2 lose `LOST` of their coating by 50,000 h, linearly:
                               finite-element histories; each blade's elongation on the mesh
                               ``fine`` grows by the share that its wear adds on ``coarse``
    a scanner set to zero      all elongations of outage 2 read `OFFSET` mm too much
      anew

Neither is declared anywhere: the blades carry the names of their coating lots, the readings that
of their campaign, as any rotor's do. Held out are the readings of a fourth outage and, of the worn
lot, the elongation at 50,000 h. `make` writes the small file that ships:

    bladetwin model readings rotor-blade-worn
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.blade import BOUNDS, simulate, simulate_history
from core.blade.kept import kept_runs
from core.builtin import inspection_plan
from core.builtin.inspection_plan import Plan, blades, times
from core.builtin.plans import WIDER

Array = NDArray[np.float64]
SHIPPED = Path(__file__).with_name("worn_plan.npz")
COMMAND = "bladetwin model readings rotor-blade-worn"
MESH = "coarse"  # a share hardly knows the mesh; a worn blade on ``fine`` takes long
LOTS = ("C1", "C2", "C3")
LOST, LOST_BY_H = 0.40, 50_000.0
OFFSET, CAMPAIGN = 0.02, "outage-2"
WORN = tuple(range(34, 58))  # B035 … B058


def coating_lot(blade: str) -> str:
    """Which lot a blade's coating is of.

    >>> coating_lot("B001"), coating_lot("B040"), coating_lot("B099-2")
    ('C1', 'C2', 'C3')
    """
    number = int(blade[1:4]) - 1
    return LOTS[0] if number < WORN[0] else LOTS[1] if number in WORN else LOTS[2]


def course(inputs: dict[str, float]) -> dict[str, Any]:
    """Inputs of a blade of the worn lot."""
    coating = inputs["tbc_thickness"]
    return {**inputs, "tbc_thickness": [(0.0, coating), (LOST_BY_H, (1.0 - LOST) * coating)]}


def run(number: int) -> Array:
    """Elongation of a blade that wears over that of the same blade that does not, (T,)."""
    inputs = dict(zip(BOUNDS, map(float, inspection_plan.truth_inputs()[number]), strict=True))
    bounds = {**BOUNDS, **WIDER}
    worn = simulate_history(course(inputs), MESH, time_h=times(), bounds=bounds).elongation
    sound = simulate(inputs, MESH, time_h=times()).elongation
    return np.where(sound > 0, worn / np.where(sound > 0, sound, 1.0), 1.0)


def simulate_all(
    folder: str | Path, workers: int = 2, progress: Callable[[int, int], None] | None = None
) -> dict[int, Array]:
    """The worn blades' runs in small files of `folder`; a cut campaign goes on where it was."""
    done = kept_runs(folder, {str(n): (n,) for n in WORN}, run, workers, progress)
    return {int(name): share for name, share in done.items()}


def make(runs: dict[int, Array], out: str | Path = SHIPPED) -> Plan:
    """The worn blades' shares as one small file."""
    arrays: dict[str, Any] = {
        "numbers": np.array(sorted(runs)),
        "share": np.stack([runs[n] for n in sorted(runs)]),
    }
    np.savez_compressed(out, **arrays)
    return load(out)


def load(path: str | Path = SHIPPED) -> Plan:
    """The plan with both effects; its `elongation` holds the worn blades' curves."""
    plan = inspection_plan.load()
    with np.load(path, allow_pickle=False) as data:
        shares = dict(zip(data["numbers"].tolist(), data["share"], strict=True))
    elongation = plan.elongation.copy()
    names = list(blades())
    moved: dict[str, Array] = {}
    for number, share in shares.items():
        moved[names[number]] = elongation[number] * (share - 1.0)
        elongation[number] = elongation[number] * share

    def added(blade: str, own_h: float) -> float:
        return float(np.interp(own_h, plan.time_h, moved[blade])) if blade in moved else 0.0

    found = []
    for body in plan.inspections:
        changed = dict(body)
        if body["quantity"] == "elongation":
            value = body["value"] + added(body["blade"], body["time_h"])
            value += OFFSET if body["campaign"] == CAMPAIGN else 0.0
            changed["value"] = round(value, 4)
        found.append(changed)
    held = {b: (h, round(y + added(b, h), 4)) for b, (h, y) in plan.held_out.items()}
    return Plan(plan.time_h, plan.inputs, elongation, plan.ceeq, tuple(found), held)
