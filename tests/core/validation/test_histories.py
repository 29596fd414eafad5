"""Histories of inputs: what is drawn, what is compared, and two of them on the coarse mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.blade import BOUNDS
from core.course import Course
from core.validation import histories as study

SEED = 7
MESH: Any = (8, 1, 6)  # elements: a fifth of what the coarse mesh has


def test_histories_are_inside_the_runs_and_of_every_kind() -> None:
    drawn = [study.history(n, SEED) for n in range(64)]
    for kind, inputs in drawn:
        moving = [n for n, given in inputs.items() if not Course.of(given).constant]
        assert moving
        assert set(moving) <= {"t1t_rate", "tbc_thickness"}
        for name, (low, high) in BOUNDS.items():
            values = Course.of(inputs[name]).values
            assert low <= values.min() <= values.max() <= high
        if kind == "cycle":
            values = Course.of(inputs[moving[0]]).values
            assert values[0] == values[2] != values[1]
    assert {kind for kind, _ in drawn} == set(study.KINDS)
    tertiary = [Course.of(inputs["tertiary"]) for _, inputs in drawn if "tertiary" in inputs]
    assert len(tertiary) == 16
    assert all(c.constant and c.values.min() >= 1.5 for c in tertiary)
    assert study.history(5, SEED) == study.history(5, SEED) != study.history(5, SEED + 1)


@pytest.mark.parametrize(("kind", "hotter"), [("step up", 1), ("step down", -1)])
def test_steps_go_where_they_are_said_to_go(kind: str, hotter: int) -> None:
    for n in range(64):
        found, inputs = study.history(n, SEED)
        if found != kind:
            continue
        for name, sense in (("t1t_rate", 1), ("tbc_thickness", -1)):
            values = Course.of(inputs[name]).values
            if len(values) > 1:
                assert np.sign(values[-1] - values[0]) == hotter * sense


def test_flat_is_the_mean_over_time() -> None:
    given: study.Given = {
        "t1t_rate": [(0.0, 0.9), (1e4, 0.9), (1e4, 1.0)],
        "tbc_thickness": [(0.0, 1.0), (5e4, 0.6)],
        "creep_steady": 0.3,
    }
    found = study.flat(given)
    assert found == pytest.approx({"t1t_rate": 0.98, "tbc_thickness": 0.8, "creep_steady": 0.3})


def test_inputs_that_stay_are_answered_by_the_surrogate_itself() -> None:
    from core.builtin import rotor_blade

    still: study.Given = dict(zip(BOUNDS, (1.0, 0.9, 0.3, -0.4), strict=True))
    surrogate = rotor_blade.load()
    x = np.array([[still[i.name] for i in surrogate.inputs]], dtype=float)
    (mean, _), _ = study.predicted(still)
    assert mean == pytest.approx(surrogate.predict(x, "elongation", study.TIMES_H)[0][0], rel=1e-6)
    (faster, _), _ = study.predicted({**still, "tertiary": 2.5})
    assert np.all(faster > mean)
    assert np.all(np.diff(faster / mean) > 0)


def test_two_histories_on_a_coarse_mesh_follow_and_constant_inputs_do_not(
    tmp_path: Path,
) -> None:
    """The surrogate is of a finer mesh; `rule` leaves what both are off without a history out."""
    steps: list[int] = []
    found = study.run(2, seed=SEED, folder=tmp_path, mesh=MESH,
                      progress=lambda done, _: steps.append(done))  # fmt: skip
    assert steps == [1, 2, 3, 4]
    assert [one["kind"] for one in found] == ["drift", "step up"]
    rule = np.abs([one["rule"] for one in found])
    assert np.median(rule) < 0.01
    assert rule.max() < 0.03
    assert np.max(np.abs([one["flat"] for one in found])) > 5 * rule.max()
    again = study.run(2, seed=SEED, folder=tmp_path, mesh=MESH)
    assert again == found, "finished runs are read, not made"


def test_the_summary_counts_every_instant_of_every_history() -> None:
    def one(kind: str, off: float, tertiary: bool) -> dict[str, object]:
        errors = [[off] * 6, [2 * off] * 6]
        return {"kind": kind, "tertiary": tertiary, "off": errors, "rule": errors, "flat": errors,
                "inside": [off < 0.02] * 6}  # fmt: skip

    told = study.summary([one("drift", 0.01, False), one("cycle", -0.03, True)])
    assert told["all"]["histories"] == 2
    assert told["all"]["off, elongation, median %"] == pytest.approx(2.0)
    assert told["cycle"]["off, mean_ceeq, 95th %"] == pytest.approx(6.0)
    assert told["tertiary"]["inside"] == 1.0
    assert set(told) == {"all", "drift", "cycle", "shipped", "tertiary"}
