"""Draws as netCDF, read back by ArviZ and xarray."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import xarray

from core.calibration.online import RotorSpec, update
from core.calibration.state import blade_posterior, shared_posterior
from core.observation import Inspection
from core.rng import stream
from service.export.netcdf import inference_data
from service.handlers.rotors import create_rotor
from service.joint import joint_draws, within
from service.ports import BladeRecord, JointDraws
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.service.reading_back import arviz, opened
from tests.service.smooth import formula_science

Json = dict[str, Any]
Post = Callable[..., int]
Reading = Callable[..., Inspection]
ROTOR = "/v1/rotors/r1"


@pytest.fixture
def told(rotor: str, post: Post, reading: Reading, worker: Worker) -> str:
    """B1 has two readings, B2 one, B3 none."""
    post(rotor, reading("i1"), reading("i2", time_h=16_000.0, value=0.2))
    post(rotor, reading("i3", blade="B2", time_h=9000.0, value=0.07))
    worker.drain()
    return rotor


def test_arviz_opens_a_blade_s_draws_and_finds_what_the_api_says(
    api: httpx.Client, told: str, tmp_path: Path
) -> None:
    path = f"{ROTOR}/blades/B1/draws?count=640"
    answer = api.get(f"{path}&format=netcdf")
    assert answer.headers["content-type"] == "application/x-netcdf"
    version = api.get(ROTOR).json()["version"]
    saved = f'attachment; filename="r1-B1-draws-v{version}.nc"'
    assert answer.headers["content-disposition"] == saved
    found, said = opened(answer.content, tmp_path), api.get(path).json()
    posterior = found.posterior
    assert posterior["offset"].dims == ("chain", "draw", "blade")
    assert posterior["rate"].dims == ("chain", "draw")
    assert posterior["blade"].values.tolist() == ["B1"]
    for i, name in enumerate(said["names"]):
        values = posterior[name].values.reshape(-1)
        assert values.tolist() == [row[i] for row in said["values"]]
    assert (posterior["offset"].attrs["units"], posterior["offset"].attrs["level"]) == (
        "mm",
        "local",
    )
    # 64 particles drawn ten times each: in their order they would look like a chain that is stuck
    rate = posterior["rate"].values[0]
    assert abs(np.corrcoef(rate[1:], rate[:-1])[0, 1]) < 4 / np.sqrt(640)
    assert np.corrcoef(np.sort(rate)[1:], np.sort(rate)[:-1])[0, 1] > 0.9, "negative control"
    attributes = posterior.attrs
    for name in ("rotor", "version", "state_digest", "model_digest", "model_version"):
        assert attributes[name] == said["rests_on"][name]
    assert attributes["sealed"] == "true"
    assert json.loads(attributes["health"]) == said["health"]


def test_the_summary_of_arviz_is_the_posterior_of_the_api(
    api: httpx.Client, told: str, tmp_path: Path
) -> None:
    body = api.get(f"{ROTOR}/blades/B1/draws?count=4000&format=netcdf").content
    summary = arviz().summary(opened(body, tmp_path), kind="stats", round_to=9)
    own = api.get(f"{ROTOR}/blades/B1/posterior").json()["parameters"]
    for row, name in (("rate", "rate"), ("offset[B1]", "offset")):
        assert summary.loc[row, "mean"] == pytest.approx(
            own[name]["mean"], abs=0.01 * own[name]["sd"]
        )
        assert summary.loc[row, "sd"] == pytest.approx(own[name]["sd"], rel=0.01)


def test_a_rotor_s_draws_are_joint_and_its_json_says_the_same(
    api: httpx.Client, told: str, tmp_path: Path
) -> None:
    said = api.get(f"{ROTOR}/draws?count=3000").json()
    body = api.get(f"{ROTOR}/draws?count=3000&format=netcdf").content
    posterior = opened(body, tmp_path).posterior
    assert said["blades"] == posterior["blade"].values.tolist() == ["B1", "B2", "B3"]
    assert posterior["rate"].values[0].tolist() == [row[0] for row in said["shared"]["values"]]
    assert posterior["offset"].values[0].tolist() == [
        [blade[0] for blade in row] for row in said["local"]["values"]
    ]
    total = (posterior["offset"] + posterior["rate"]).values[0]
    # what B1 and B2 were read at ties their offsets to the rate, and so to each other
    between = np.corrcoef(posterior["offset"].values[0].T)[0, 1]
    assert between > 0.3
    assert abs(np.corrcoef(total.T)[0, 1]) < 0.1, "their own elongations are known apart"
    shuffled = stream(5, "control").permutation(3000)
    apart = posterior["offset"].values[0].copy()
    apart[:, 1] = apart[shuffled, 1]
    assert abs(np.corrcoef(apart.T)[0, 1]) < 0.1, "negative control: draws side by side have none"


def test_too_many_draws_for_an_answer_are_refused_with_the_number_that_is_not(
    api: httpx.Client, store: SqlStore, worker: Worker
) -> None:
    create_rotor(store, "r9", "rotor-blade", [BladeRecord(f"B{i}") for i in range(400)], 64, 7)
    worker.drain()
    fault = api.get("/v1/rotors/r9/draws?count=1001").json()["faults"][0]
    assert (fault["field"], fault["value"]) == ("count", 1001)
    assert fault["remedy"] == "ask for 1 … 1000, or take format=netcdf"
    assert api.get("/v1/rotors/r9/draws?count=1000").status_code == 200
    assert api.get("/v1/rotors/r9/draws?count=1001&format=netcdf").status_code == 200
    assert api.get(f"{ROTOR}/draws?format=xlsx").status_code == 422


def test_files_are_asked_for_again_by_their_tag(
    api: httpx.Client, told: str, post: Post, reading: Reading, worker: Worker
) -> None:
    for path in ("draws?format=netcdf", "blades/B1/draws?format=netcdf", "inspections?format=csv",
                 "inspections?format=parquet", "blades/B1/prediction?format=csv",
                 "inspections?format=sensorthings", "blades/B1/field?times=5&format=npz",
                 "blades/B1/field?times=5&format=arrow",
                 "blades/B1/field?format=vtu"):  # fmt: skip
        tag = api.get(f"{ROTOR}/{path}").headers["etag"]
        plain = api.get(f"{ROTOR}/{path.partition('?')[0]}").headers["etag"]
        assert tag != plain, "another representation"
        again = api.get(f"{ROTOR}/{path}", headers={"If-None-Match": tag})
        assert (again.status_code, again.content) == (304, b"")
        post(told, reading(path.replace("/", ".").replace("?", ".").replace("=", "."), blade="B3"))
        worker.drain()
        assert api.get(f"{ROTOR}/{path}", headers={"If-None-Match": tag}).status_code == 200


@pytest.fixture(scope="module")
def state() -> Any:
    """Three blades on a formula: B1 and B2 read twice, B3 once."""
    science = formula_science()
    card = science.builtin("rotor-blade")
    readings = [
        Inspection(f"{b}{t}", b, "elongation", t, np.array([v]), sigma=0.02)
        for b, t, v in (
            ("B1", 8000.0, 0.11), ("B1", 30_000.0, 0.31), ("B2", 8000.0, 0.16),
            ("B2", 30_000.0, 0.42), ("B3", 16_000.0, 0.2),
        )
    ]  # fmt: skip
    spec = RotorSpec("r1", ("B1", "B2", "B3"), 4000, 5)
    return update(science.models.of(card), spec, readings, None, quick=False)


def test_joint_draws_have_each_blade_s_own_moments(state: Any) -> None:
    get = state.arrays.__getitem__
    drawn = joint_draws(state.meta, get, ("B1", "B2", "B3"), 4000)
    shared = shared_posterior(state.meta, get)
    for j, name in enumerate(drawn.shared_names):
        sd = np.sqrt(shared.particles.covariance[j, j])
        assert drawn.shared[:, j].mean() == pytest.approx(
            shared.particles.mean[j], abs=0.01 * sd
        ), name
    for i, blade in enumerate(drawn.blades):
        own = blade_posterior(state.meta, get, blade)
        for j, name in enumerate(drawn.local_names):
            column = own.column(name)
            mean = own.particles.w @ column
            sd = np.sqrt(own.particles.w @ (column - mean) ** 2)
            assert drawn.local[:, i, j].mean() == pytest.approx(mean, abs=0.04 * sd), (blade, name)
            assert drawn.local[:, i, j].std() == pytest.approx(sd, rel=0.03), (blade, name)
            # with the shared temperature as the particles have it
            k, t1t = list(drawn.shared_names).index("t1t_rate"), own.column("t1t_rate")
            centre = own.particles.w @ t1t
            spread = np.sqrt(own.particles.w @ (t1t - centre) ** 2)
            tie = own.particles.w @ ((column - mean) * (t1t - centre)) / sd / spread
            found = np.corrcoef(drawn.local[:, i, j], drawn.shared[:, k])[0, 1]
            assert found == pytest.approx(tie, abs=0.05), (blade, name)


def test_weighted_particles_stand_beside_their_draws(state: Any, tmp_path: Path) -> None:
    get, blades = state.arrays.__getitem__, ("B1", "B3")
    drawn = joint_draws(state.meta, get, blades, 4000)
    own = [formula_science().blade_draws(state.meta, get, blade) for blade in blades]
    units = dict.fromkeys((*drawn.shared_names, *drawn.local_names), "1")
    found = opened(inference_data(drawn, units, {}, {"rotor": "r1"}, particles=own), tmp_path)
    weighted = found.particles
    assert weighted["log_weight"].dims == ("blade", "particle")
    for blade in blades:
        posterior = blade_posterior(state.meta, get, blade)
        one = weighted.sel(blade=blade)
        w = np.exp(one["log_weight"].values)
        assert w.sum() == pytest.approx(1, rel=1e-12)
        assert len(np.unique(w)) > 100, "they are weighted"
        for name in posterior.names:
            values, draws = one[name].values, found.posterior[name].values[0]
            assert values.tolist() == posterior.column(name).tolist()
            draws = draws[:, blades.index(blade)] if draws.ndim == 2 else draws
            mean, sd = w @ values, np.sqrt(w @ (values - w @ values) ** 2)
            assert draws.mean() == pytest.approx(mean, abs=0.05 * sd), name
        level = {name: one[name].attrs["level"] for name in posterior.names}
        assert {n for n in level if level[n] == "local"} == set(drawn.local_names)
        assert {n for n in level if level[n] == "shared"} == set(drawn.shared_names)
        # particles of one node have its shared values
        node = one["node"].values
        assert len(np.unique(node)) == len(get("shared/log_w"))
        rate = one["t1t_rate"].values
        assert all(np.ptp(rate[node == k]) == 0 for k in np.unique(node)[:20])


def test_blades_are_tied_by_the_shared_parameters_alone(state: Any) -> None:
    """At one node they are independent: neither order within it nor order of nodes ties them."""
    get = state.arrays.__getitem__
    drawn = joint_draws(state.meta, get, ("B1", "B2"), 4000)
    node = np.unique(drawn.shared[:, 0], return_inverse=True)[1]
    held = np.flatnonzero(np.bincount(node) > 40)
    assert len(held) > 20
    ties = []
    for k in held:
        one = drawn.local[node == k]
        ties.append([np.corrcoef(one[:, 0, j], one[:, 1, j])[0, 1] for j in range(one.shape[2])])
    assert np.abs(np.mean(ties, axis=0)).max() < 4 / np.sqrt(40 * len(held))
    lags = np.corrcoef(drawn.local[1:, 0, 0], drawn.local[:-1, 0, 0])[0, 1]
    assert abs(lags) < 4 / np.sqrt(4000)
    again = joint_draws(state.meta, get, ("B1", "B2"), 4000)
    assert again.local.tobytes() == drawn.local.tobytes()


def test_a_value_without_weight_is_not_drawn_and_a_node_without_draws_is_no_trouble() -> None:
    log_w = np.array([[-np.inf, 0.0, -np.inf], [-np.inf] * 3, [0.0, -np.inf, 0.0]])
    drawn = within(np.array([0, 0, 2, 2, 2, 2]), log_w, np.random.default_rng(1))
    assert drawn[:2].tolist() == [1, 1]
    assert sorted(drawn[2:].tolist()) == [0, 0, 2, 2]


def test_odd_names_units_and_known_inputs_come_through(tmp_path: Path) -> None:
    drawn = JointDraws(
        ("sigma_obs.elongation@gauge 3/b",), np.array([[0.02], [0.03]]), ("draw",), ("B:1", "B-2"),
        np.array([[[1.0], [2.0]], [[3.0], [4.0]]]), 7,
    )  # fmt: skip
    units = {"sigma_obs.elongation@gauge 3/b": "mm", "draw": "µm", "stress": "MPa"}
    body = inference_data(drawn, units, {"stress": [170.0, np.nan]}, {"rotor": "r/1", "version": 3})
    found = opened(body, tmp_path)
    sigma = found.posterior["sigma_obs.elongation@gauge 3_b"]
    assert sigma.attrs["long_name"] == "sigma_obs.elongation@gauge 3/b"
    assert found.posterior["draw_"].sel(blade="B-2").values.tolist() == [[2.0, 4.0]]
    assert found.posterior["draw_"].attrs["units"] == "µm"
    assert found.constant_data["stress"].sel(blade="B:1").item() == 170.0
    assert np.isnan(found.constant_data["stress"].sel(blade="B-2").item())
    tree = xarray.open_datatree(tmp_path / "draws.nc", engine="h5netcdf")  # as ArviZ 1.0 does
    assert tree["posterior"].attrs["version"] == 3
    assert set(tree.children) == {"posterior", "constant_data"}
    tree.close()
