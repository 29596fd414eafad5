"""What a search begins with: blades of each kind, and noises that a scan's remainder names."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from core.calibration.lead import PANEL, panel, start_of
from core.calibration.scans import Dense
from core.prior import Prior

NOISE = 0.05


def message(*sigma: str | float, dense: tuple[Dense, ...] = ()) -> Any:
    return SimpleNamespace(rows=SimpleNamespace(sigma=sigma, dense=dense))


def test_blades_whose_readings_state_their_noise_are_of_one_kind() -> None:
    """A panel of them stands for all, as of blades that share a noise."""
    own = {f"b{i:02d}": message(0.001 * (i + 1), 0.002 * (i + 1)) for i in range(40)}
    found = panel(own)
    assert len(found) == PANEL
    assert sum(found.values()) == pytest.approx(40)
    named = {f"c{i:02d}": message("sigma_obs.y@a", 0.001 * (i + 1)) for i in range(40)}
    both = panel(own | named)
    assert len(both) == 2 * PANEL, "negative control: another noise makes another kind"
    assert sum(weight for blade, weight in both.items() if blade < "c") == pytest.approx(40)


@pytest.mark.parametrize("kind", ["log_uniform", "uniform", "normal"])
def test_a_scan_names_its_noise_on_the_scale_of_the_noise_s_prior(kind: Any) -> None:
    prior = Prior(kind, 0.01, 0.5, 0.1, 0.1)
    dof = 800
    space: Any = SimpleNamespace(dim=1, names=("s",), priors=(prior,), heavy=())
    scan = Dense("s", rss=dof * NOISE**2, dof=dof)
    begun = start_of(space, {"b": message("s", dense=(scan,))})
    low, high = prior.box
    assert begun.chol is not None
    assert prior.to_x(low + begun.mean * (high - low)) == pytest.approx(NOISE, rel=1e-9)
    ends = low + (begun.mean + np.array([-1.0, 1.0]) * begun.chol[0, 0]) * (high - low)
    wide = np.diff(prior.to_x(ends))[0] / (2 * NOISE)
    assert wide == pytest.approx(6 / np.sqrt(2 * dof), rel=0.05)
