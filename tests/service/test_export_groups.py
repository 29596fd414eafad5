"""Prior and posterior predictive groups beside the posterior, as ArviZ opens and draws them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import matplotlib
import numpy as np
import pytest

from core.builtin.paper_network import rotor_blade_network
from core.calibration.online import RotorSpec, update
from core.calibration.state import blade_posterior
from core.observation import Inspection
from core.prediction import predict
from core.prior import Population, Prior
from service.handlers import exports
from service.joint import joint_draws
from service.ports import JointDraws
from service.predictive import prior_draws
from service.worker.loop import Worker
from tests.service import reading_back
from tests.service.reading_back import arviz
from tests.service.smooth import formula_science
from tests.service.test_export_readings import SCAN

Post = Callable[..., int]
Reading = Callable[..., Inspection]
ROTOR = "/v1/rotors/r1"


def opened(body: bytes, tmp_path: Path) -> Any:
    """Draws as ArviZ opens them, from a file of their own: it reads what it is asked for, later."""
    folder = tmp_path / f"{len(list(tmp_path.iterdir()))}"
    folder.mkdir()
    return reading_back.opened(body, folder)


@pytest.fixture
def told(api: httpx.Client, rotor: str, worker: Worker) -> httpx.Client:
    """B1 has a reading that counts and one that was replaced, B2 a scan, B3 a CEEQ at a node."""
    one = {"blade": "B1", "quantity": "elongation", "time_h": 30_000.0}
    sent = [
        one | {"id": "a", "value": 0.9}, one | {"id": "b", "value": 0.31, "replaces": "a"},
        SCAN | {"time_h": 20_000.0},
        {"id": "n", "blade": "B3", "quantity": "ceeq", "time_h": 9e3, "values": [0.001],
         "nodes": [17]},
    ]  # fmt: skip
    assert api.post(f"{ROTOR}/inspections", json={"inspections": sent}).status_code == 202
    worker.drain()
    return api


def test_arviz_has_every_group_and_readings_are_those_that_count(
    told: httpx.Client, tmp_path: Path
) -> None:
    body = told.get(f"{ROTOR}/draws?count=500&format=netcdf").content
    found = opened(body, tmp_path)
    assert set(found.groups()) == {
        "posterior", "prior", "posterior_predictive", "observed_data", "constant_data",
    }  # fmt: skip
    observed, again = found.observed_data, found.posterior_predictive
    assert observed["elongation_reading"].values.tolist() == ["b"]
    assert observed["elongation"].values.tolist() == [0.31]
    assert observed["deformation"].values.reshape(-1, 3).tolist() == SCAN["values"]
    assert observed["deformation_reading"].values.tolist() == [
        f"scan[{node}].{axis}" for node in (12, 7) for axis in "xyz"
    ]
    assert observed["ceeq"].attrs["units"] == "1"
    assert again["deformation"].shape == (1, 500, 6)
    assert found.constant_data["elongation_time_h"].values.tolist() == [30_000.0]
    assert found.constant_data["deformation_blade"].values.tolist() == ["B2"] * 6
    assert found.prior["offset"].dims == found.posterior["offset"].dims
    assert found.prior["rate"].attrs["units"] == "mm"
    only = opened(told.get(f"{ROTOR}/blades/B3/draws?format=netcdf").content, tmp_path)
    assert set(only.observed_data.data_vars) == {"ceeq"}, "a blade's file has its own readings"


def test_what_would_be_read_again_has_the_prediction_s_moments(
    told: httpx.Client, tmp_path: Path
) -> None:
    body = told.get(f"{ROTOR}/draws?count=4000&format=netcdf").content
    found = opened(body, tmp_path)
    bands = told.get(f"{ROTOR}/blades/B1/prediction?times=30000").json()
    again = found.posterior_predictive["elongation"].values[0, :, 0]
    sd = bands["sd"]["total"][0]
    assert again.mean() == pytest.approx(bands["mean"][0], abs=0.06 * sd)
    assert again.std() == pytest.approx(sd, rel=0.05)
    rate, offset = found.posterior["rate"].values[0], found.posterior["offset"].values[0, :, 0]
    own = (rate + offset) * 0.6
    assert np.corrcoef(own, again)[0, 1] == pytest.approx(own.std() / again.std(), abs=0.05), (
        "of the very draws beside it"
    )
    prior = found.prior["rate"].values
    assert (prior.mean(), prior.std()) == (pytest.approx(0.5, 1e-3), pytest.approx(0.1, 1e-2))


def test_arviz_draws_its_pictures_from_the_file(told: httpx.Client, tmp_path: Path) -> None:
    matplotlib.use("Agg")
    found = opened(told.get(f"{ROTOR}/draws?format=netcdf").content, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        axes = arviz().plot_ppc(found, var_names=["elongation", "deformation"], num_pp_samples=50)
        assert len(np.ravel(axes)) == 2
        assert all(len(one.lines) > 50 for one in np.ravel(axes))
        pairs = arviz().plot_dist_comparison(found, var_names=["rate"])
        assert np.shape(pairs)[-1] == 3
        plain = told.get(f"{ROTOR}/draws?format=netcdf&groups=posterior").content
        with pytest.raises(TypeError, match="posterior_predictive"):
            arviz().plot_ppc(opened(plain, tmp_path))
    matplotlib.pyplot.close("all")


def test_groups_are_left_out_on_request_and_odd_ones_refused(
    told: httpx.Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    some = opened(told.get(f"{ROTOR}/draws?format=netcdf&groups=prior").content, tmp_path)
    assert set(some.groups()) == {"posterior", "prior"}
    some = opened(told.get(f"{ROTOR}/draws?format=netcdf&groups=particles").content, tmp_path)
    assert set(some.groups()) == {"posterior", "particles"}
    assert some.particles["offset"].shape == (3, 64)
    for query, problem in (
        ("format=netcdf&groups=prior,likelihood", "is no group of the file"),
        ("groups=prior", "is not for format=json"),
    ):
        fault = told.get(f"{ROTOR}/draws?{query}").json()["faults"][0]
        assert (fault["field"], fault["problem"]) == ("groups", problem)
    monkeypatch.setitem(exports.MOST_VALUES, "netcdf", 8 * 100)
    path = f"{ROTOR}/blades/B2/draws?format=netcdf"
    refused = told.get(f"{path}&count=150").json()["faults"][0]
    assert (refused["field"], refused["remedy"]) == (
        "count", "ask for 1 … 133, or leave them out with groups=prior",
    )  # fmt: skip
    assert told.get(f"{path}&count=133").status_code == 200
    assert told.get(f"{path}&count=150&groups=prior").status_code == 200
    assert told.get(f"{path}&count=133&groups=particles").status_code == 200
    monkeypatch.setitem(exports.MOST_VALUES, "netcdf", 7 * 100)
    many = told.get(f"{ROTOR}/draws?format=netcdf&count=100&groups=particles").json()["faults"][0]
    assert (many["value"], many["problem"], many["remedy"]) == (
        "particles", "768 values of 3 blades are more than 700", "ask for the draws of one blade",
    )  # fmt: skip


def test_a_blade_by_formula_is_read_again_as_the_prediction_says() -> None:
    """Noise that is calibrated and noise that is given, on the service's own science."""
    science = formula_science()
    card = science.builtin("rotor-blade")
    given = (("B1", 8e3, 0.11, 0.02), ("B1", 3e4, 0.31, None), ("B2", 8e3, 0.16, None))
    readings = [
        Inspection(f"{b}{t:g}", b, "elongation", t, np.array([v]), sigma=s) for b, t, v, s in given
    ]
    spec = RotorSpec("r1", ("B1", "B2"), 4000, 5)
    model = science.models.of(card)
    state = update(model, spec, readings, None, quick=False)
    get = state.arrays.__getitem__
    drawn = joint_draws(state.meta, get, ("B1", "B2"), 4000)
    for one, again in zip(readings, science.replicated(card, drawn, readings, {}), strict=True):
        own = blade_posterior(state.meta, get, one.blade)
        bands = predict(model, own, "elongation", [one.time_h], sigma=one.sigma)
        sd = float(bands.sd["total"][0])
        assert again.shape == (4000, 1)
        assert again.mean() == pytest.approx(bands.mean[0], abs=0.07 * sd), one.id
        assert again.std() == pytest.approx(sd, rel=0.06), one.id
        without = predict(model, own, "elongation", [one.time_h], noise=False)
        assert again.std() > 1.05 * without.sd["total"][0], "negative control: the noise is in it"
    prior = science.prior_draws(card, drawn)
    assert prior.shared_names == drawn.shared_names
    for j, name in enumerate(prior.shared_names):
        declared = rotor_blade_network().quantity("elongation").sigma_obs
        if name == "t1t_rate":
            declared = rotor_blade_network().parameter(name).prior
        even = declared.quantile((np.arange(4000) + 0.5) / 4000)
        np.testing.assert_allclose(np.sort(prior.shared[:, j]), even, rtol=2e-3)
    ties = np.corrcoef(np.hstack([prior.shared, prior.local.reshape(4000, -1)]).T)
    assert np.abs(ties - np.eye(len(ties))).max() < 0.08, "independent, as declared"


def test_blades_of_a_population_are_drawn_around_its_own_draws() -> None:
    """l_b ~ N(mean, sd²) of the very draw: correlated between blades by the mean."""
    network: Any = rotor_blade_network()
    (own, *rest) = network.parameters
    people = Population(Prior("uniform", 0.8, 1.2), Prior("uniform", 0.005, 0.01))
    object.__setattr__(own, "population", people)
    names = (*own.hyperparameters, "t1t_rate")
    shape = (2000, 2, 1)
    like = JointDraws(names, np.zeros((2000, 3)), (own.name,), ("A", "B"), np.zeros(shape), 1)
    shared = own.hyperparameters | {"t1t_rate": network.parameter("t1t_rate").prior}
    drawn = prior_draws(network, shared, like)
    mean, a, b = drawn.shared[:, 0], drawn.local[:, 0, 0], drawn.local[:, 1, 0]
    assert np.abs(a - mean).max() < 0.05
    assert np.corrcoef(a, b)[0, 1] > 0.98
    assert np.abs(a - b).min() < np.abs(a - b).max(), "and not the same"
    assert rest
