"""Measured creep of a superalloy: what each network makes of it, and of specimens it has not seen.

The kept results (`make_specimens.py`) hold for the model of this release, which their digest tells;
the data are needed only to make them again. Two calibrations are made here: of the specimens at the
two middle stresses, to show that the kept ones come out of this code.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.claims import make_specimens
from tests.claims.make_specimens import FREED, OUT, calibrated, errors, kept, model
from tests.claims.specimen_data import EVERY, LARGEST, specimens


def rmse(network: str, which: str, *stresses: float) -> float:
    return make_specimens.rmse(kept(network), which, *stresses)


def noise(network: str) -> float:
    return float(kept(network)["shared"]["sigma_obs.creep_strain"][0])


def evidence(network: str) -> float:
    return float(kept(network)["log_evidence"])


@pytest.mark.parametrize("network", FREED)
def test_what_is_kept_is_of_this_releases_model_and_counts_every_reading(network: str) -> None:
    found = kept(network)
    assert found["model"] == model(network).digest
    assert found["freed"] == FREED[network]
    assert (found["delivered"], found["up_to_largest"], found["used"]) == (1428, 1359, 276)
    assert [len(found[which]) for which in ("fit", "new_specimen", "new_stress")] == [12, 12, 12]
    assert found["health"]["status"] == "ok"
    assert {one["health"] for k in ("new_specimen", "new_stress") for one in found[k]} == {"ok"}
    names = {one["specimen"] for one in found["fit"]}
    assert names == {one["specimen"] for one in found["new_specimen"]}


def test_the_table_is_that_of_the_kept_results() -> None:
    assert (OUT / "table.md").read_text() == make_specimens.table()


def test_the_data_are_those_that_were_delivered() -> None:
    every = specimens()
    assert len(every) == 12
    assert sum(one.delivered for one in every) == kept("norton")["delivered"]
    assert sum(len(one.strain) for one in every) == kept("norton")["up_to_largest"]
    assert sum(len(one.readings) for one in every) == kept("norton")["used"]
    assert max(one.strain.max() for one in every) <= LARGEST
    assert (kept("norton")["every"], kept("norton")["largest_pct"]) == (EVERY, LARGEST)


def test_nortons_law_alone_misses_by_a_hundred_times_the_gauges_noise() -> None:
    assert 0.7 < rmse("norton", "fit") < 0.9
    assert noise("norton") == pytest.approx(rmse("norton", "fit"), rel=0.1)


def test_primary_creep_alone_gains_nothing_tertiary_much_and_both_by_far_the_most() -> None:
    gained = {name: evidence(name) - evidence("norton") for name in FREED}
    assert gained["primary"] < 1.0
    assert gained["tertiary"] > 300.0
    assert gained["both"] > gained["tertiary"] + 150.0
    assert noise("both") < 0.5 * noise("tertiary") < 0.25 * noise("norton")
    assert rmse("both", "fit") < 0.11


@pytest.mark.parametrize("which", ["new_specimen", "new_stress"])
def test_up_to_200_mpa_what_was_not_seen_is_forecast_better_by_both(which: str) -> None:
    for stress in (140.0, 170.0, 200.0):
        assert rmse("both", which, stress) < 0.85 * rmse("norton", which, stress)


def test_at_230_mpa_both_forecasts_worse_than_norton_alone() -> None:
    """Not to be hidden: n falls from 8 to 6 between 140 and 230 MPa, one n for all is 0.2 off in
    ln r at the end, and where exp(c x) is 1,000 that is a factor of three in strain."""
    for which in ("new_specimen", "new_stress"):
        assert rmse("both", which, 230.0) > 2 * rmse("norton", which, 230.0)


def test_a_curve_whose_first_half_is_known_goes_on_nearer_by_both_at_every_stress() -> None:
    """With every reading the fit misses the 0.10 % asked for all the same: contradicted."""
    found = json.loads(make_specimens.WHOLE.read_text())
    norton, both = found["norton"], found["both"]
    for one in (norton, both):
        assert one["used"] == 1359
        assert one["model"] == model("both" if one is both else "norton").digest
        assert [own["health"] for own in one["continued"]] == ["ok"] * 12
    for stress in make_specimens.STRESSES:
        nearer = make_specimens.rmse(both, "continued", stress)
        assert nearer < 0.5 * make_specimens.rmse(norton, "continued", stress)
    assert 0.10 < make_specimens.rmse(both, "fit") < 0.11
    assert both["health"]["status"] == "contradicted"


def test_the_kept_results_come_out_of_this_code_on_the_middle_stresses() -> None:
    """Six specimens, Norton's law and with tertiary creep: noise and evidence move the same way,
    and a specimen's error is that of its kept fit within a factor."""
    middle = [one for one in specimens() if one.stress in (170.0, 200.0)]
    found = {}
    for network in ("norton", "tertiary"):
        of = model(network)
        state = calibrated(of, middle, particles=512)
        assert state.meta["health"]["status"] == "ok"
        own = errors(of, state, middle[0])
        before = next(o for o in kept(network)["fit"] if o["specimen"] == middle[0].name)
        assert own["readings"] == before["readings"] == len(middle[0].strain)
        assert 0.3 < np.sqrt(own["mean_square"] / before["mean_square"]) < 1.5
        found[network] = state.meta["log_evidence"]
    assert found["tertiary"] > found["norton"] + 100.0
