"""Six local parameters by tempered particles: the kept study (`study coverage six-locals`).

`test_coverage` holds the study to its own verdict as well.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.validation.variants import model_of, plan

RESULT = Path(__file__).with_name("results") / "six-locals" / "result.json"
LOCAL = [p.name for p in model_of(plan("six-locals")).network.of_level("local")]


@pytest.fixture(scope="module")
def kept() -> dict[str, Any]:
    return json.loads(RESULT.read_text())  # type: ignore[no-any-return]


def test_intervals_of_the_local_parameters_cover(kept: dict[str, Any]) -> None:
    """All six together; every rotor counts."""
    assert len(LOCAL) == 6
    assert kept["failed"] == {}
    rows = [kept["table"][name] for name in LOCAL]
    assert all(row["truths"] == kept["rotors"] * kept["blades"] for row in rows)
    assert abs(np.mean([row["inside_68"] for row in rows]) - 0.68) < 0.05
    assert abs(np.mean([row["inside_95"] for row in rows]) - 0.95) < 0.03


def test_ranks_lie_in_their_bands_and_those_of_wrong_samplers_do_not(kept: dict[str, Any]) -> None:
    assert kept["outside_band"] == []
    assert set(kept["table"]) == {"rate", "sigma_obs.elongation", *LOCAL, "held-out elongation"}
    for control in ("narrow", "shifted"):
        assert set(kept["controls_caught"][control]) & set(LOCAL), control
