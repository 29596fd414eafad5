"""Two effects that each find room in the runs, and together do not."""

from __future__ import annotations

import numpy as np

from core.calibration.online import RotorSpec, Workspace, update
from core.diagnosis import Case, Facts
from core.diagnosis.adopt import with_effects
from core.diagnosis.diagnose import _Search
from core.diagnosis.grammar import FAMILIES, Cell
from core.model import rotor_blade_wide
from core.observation import Inspection

FAMILY = {f.name: f for f in FAMILIES}
FOULING = Cell(FAMILY["fouling"], "linear", "all")
STEP = Cell(FAMILY["firing temperature step"], "step", "all", step_h=17_500.0)


def test_effects_that_leave_the_runs_together_are_refused_and_the_search_goes_on() -> None:
    """One blade joined late, so that each has a course of its own: nothing is seen before."""
    names = ("B1", "B2")
    data = tuple(
        Inspection(f"{b}-{t}", b, "elongation", t, np.array([0.3 + 1e-6 * t]), sigma=0.02)
        for b in names
        for t in (7e3, 21e3)
    )
    facts = {"B1": Facts(), "B2": Facts(offset_h=14e3)}
    model, spec, work = rotor_blade_wide(), RotorSpec("r", names, 100, 1), Workspace()
    case = Case(spec, data, facts)
    search = _Search(model, update(model, spec, data, workspace=work), case, work, lambda *a: None)
    both = with_effects(model, (FOULING, STEP), facts, {"elongation": 0.02})
    assert len(both.network.drifts) == 2, "nothing is refused before a blade is asked for"
    assert search.calibrated((FOULING, STEP)) is None
    ((effects, why),) = search.refused.items()
    assert effects == ("fouling", "firing temperature step")
    assert "leaves the runs" in why
    alone = search.calibrated((STEP,))
    assert alone is not None
