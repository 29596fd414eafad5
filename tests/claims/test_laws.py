"""What laws of creep can do at best on the measured curves (`make_laws`), kept and made again."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from core.builtin import creep_specimens as built
from tests.claims import make_laws, make_specimens
from tests.claims.make_laws import LAWS, OUT
from tests.claims.specimen_data import specimens


def kept() -> dict[str, Any]:
    found: dict[str, Any] = json.loads((OUT / "laws.json").read_text())
    return found


def test_the_table_is_that_of_the_kept_results() -> None:
    assert list(kept()) == list(LAWS)
    assert (OUT / "laws.md").read_text() == make_laws.table(kept())


def test_calibration_reaches_the_laws_least_squares_which_miss_a_tenth() -> None:
    """So the 0.10 % asked for are out of this law's reach: missed by the law, not by the filter."""
    best = kept()["shipped"]["fit"]
    calibrated = make_specimens.rmse(json.loads(make_specimens.WHOLE.read_text())["both"], "fit")
    assert best > 0.10
    assert best * 0.999 < calibrated < best * 1.01


def test_amplitudes_of_their_own_fit_better_and_forecast_new_stresses_worse() -> None:
    """A freedom that is to be refused: it explains what was seen and not what comes."""
    one, own = kept()["shipped"], kept()["own amplitude"]
    assert own["fit"] < 0.10 < one["fit"]
    for place in (1, 2):  # 170 and 200 MPa, between stresses that are known
        assert own["new_stress"][place] > 1.5 * one["new_stress"][place]


def test_no_law_here_forecasts_a_new_stress_to_what_was_asked() -> None:
    for law in kept().values():
        assert max(law["new_stress"][1:3]) > 0.45


def test_the_shipped_laws_least_squares_come_out_of_this_code() -> None:
    law, every = LAWS["shipped"], specimens()
    p, rate, off = make_laws.fitted(law, every)
    assert make_laws.rms(off) == pytest.approx(kept()["shipped"]["fit"], abs=2e-4)
    one = every[0]
    inputs = np.array([rate[0], 0.0, *np.exp(p[0]), built.STRESS0])
    assert off[0] + one.strain == pytest.approx(built.strain(inputs, one.time_h), rel=1e-12)


def test_a_law_that_made_the_curves_is_found_again() -> None:
    """Curves by Kachanov's law, exact: its own least squares find it, the shipped law's do not."""
    law, p = LAWS["Kachanov"], np.log([0.24, 0.036, 1.0, 2.0])
    every = tuple(
        make_laws.Specimen(str(i), 140.0, 60, t, law.strain(0.0015 * i * t, p))
        for i, t in ((i, np.linspace(0.0, 560.0 / i, 60)) for i in (1, 2, 3))
    )
    found, rate, off = make_laws.fitted(law, every)
    assert make_laws.rms(off) < 1e-6
    assert np.exp(found[0]) == pytest.approx(np.exp(p), rel=1e-3)
    assert np.exp(rate) == pytest.approx([0.0015, 0.003, 0.0045], rel=1e-3)
    assert make_laws.rms(make_laws.fitted(LAWS["shipped"], every)[2]) > 0.005
