from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from core.archive import Archive, Input, Mesh, Quantity, Run
from core.errors import InputError, ModelError, RangeError
from core.surrogate import Surrogate, train
from core.surrogate.artefact import digest_of
from core.surrogate.part import Part
from core.surrogate.report import errors

Array = NDArray[np.float64]
X = np.array([[0.81, 0.93, 1.3, -0.7], [1.2, 0.86, -2.1, 2.2]])


@pytest.fixture(scope="module")
def report(model: Surrogate, archive: Archive) -> dict[str, Any]:
    return errors(model, archive, range(66, 100))


def test_elongation_of_34_unseen_runs_is_within_half_a_per_cent(report: dict[str, Any]) -> None:
    assert report["elongation"]["from_1000_h"]["median_percent"] <= 0.5
    assert report["elongation"]["from_1000_h"]["p95_percent"] <= 2.5


def test_fields_of_34_unseen_runs_are_within_their_bounds(report: dict[str, Any]) -> None:
    assert report["ceeq"]["worst_node_from_1000_h"]["median_percent"] <= 1.0
    assert report["ceeq"]["worst_node_from_1000_h"]["p95_percent"] <= 4.0
    assert report["deformation"]["rmse_mm"] <= 0.01
    assert report["mises"]["worst_node_from_1000_h"]["p95_percent"] <= 1.0


def test_its_own_95_per_cent_intervals_cover_and_intervals_of_half_the_width_do_not(
    model: Surrogate, archive: Archive
) -> None:
    x = archive.inputs(range(66, 100))
    true = archive.stack("elongation", range(66, 100))[:, 1:]
    mean, sd = model.predict(x, "elongation", model.time_h[1:])
    wide = np.mean(np.abs(true - mean) <= 1.96 * sd)
    narrow = np.mean(np.abs(true - mean) <= 0.1 * 1.96 * sd)
    assert wide >= 0.90
    assert narrow < 0.75


@pytest.mark.parametrize("time_h", [12_345.0, 2500.0, 321.0])
def test_between_instants_it_is_as_good_as_at_instants(
    model: Surrogate, stand_in: Callable[..., Run], time_h: float
) -> None:
    for x in X:
        truth = stand_in(x, np.array([0.0, time_h]))
        mean, sd = model.predict(x, "elongation", [time_h])
        error = abs(mean[0, 0] - truth.values["elongation"][1])
        assert error < 0.01 * mean[0, 0] + 3 * sd[0, 0]
        ceeq, _ = model.predict(x, "ceeq", [time_h], [130])
        assert ceeq[0, 0, 0] == pytest.approx(truth.values["ceeq"][1, 130], rel=0.01)


def test_at_zero_nothing_has_crept_and_the_first_hour_is_proportional(model: Surrogate) -> None:
    for name, nodes in (("elongation", None), ("ceeq", [5]), ("deformation", [299])):
        mean, sd = (v.reshape(3, -1) for v in model.predict(X[:1], name, [0.0, 0.25, 1.0], nodes))
        assert np.all(mean[0] == 0)
        assert np.all(sd[0] == 0)
        np.testing.assert_allclose(mean[1], 0.25 * mean[2], rtol=1e-12)
    hot, _ = model.predict(X[:1], "displacement", [0.0], [299])
    assert hot[0, 0, 0, 2] > 1.0


def test_shapes_follow_the_kind_of_the_quantity(model: Surrogate) -> None:
    times = [10.0, 500.0, 9000.0]
    assert model.predict(X, "elongation", times)[0].shape == (2, 3)
    assert model.predict(X, "ceeq", times, [4, 8])[0].shape == (2, 3, 2)
    assert model.predict(X, "deformation", times, [4, 8])[1].shape == (2, 3, 2, 3)
    assert model.predict(X, "mises", times)[0].shape == (2, 3, 300)


@pytest.mark.parametrize("quantity", ["ceeq", "mises", "deformation", "displacement"])
def test_nodes_asked_for_are_those_of_the_whole_field(model: Surrogate, quantity: str) -> None:
    times = [3.0, 20_000.0]
    whole = model.predict(X, quantity, times)
    few = model.predict(X, quantity, times, [250, 17])
    for part, all_nodes in zip(few, whole, strict=True):
        np.testing.assert_allclose(part, all_nodes[:, :, [250, 17]], rtol=1e-9, atol=1e-13)


def test_many_inputs_are_the_same_as_one_by_one(model: Surrogate) -> None:
    x = np.random.default_rng(2).uniform(model.low, model.high, (1500, 4))
    mean, sd = model.predict(x, "elongation", [8000.0])
    for i in (0, 1023, 1024, 1499):
        alone = model.predict(x[i], "elongation", [8000.0])
        np.testing.assert_allclose([mean[i], sd[i]], [a[0] for a in alone], rtol=1e-6)


def test_displacement_is_the_field_at_zero_plus_the_permanent_deformation(
    model: Surrogate,
) -> None:
    at = ([0.0, 7000.0], [299, 40])
    hot, hot_sd = model.predict(X, "displacement", *at)
    cold, cold_sd = model.predict(X, "deformation", *at)
    np.testing.assert_allclose(hot[:, 1] - hot[:, 0], cold[:, 1], rtol=1e-9, atol=1e-12)
    assert np.all(hot_sd >= cold_sd)


def test_the_tip_of_the_field_agrees_with_the_elongation(model: Surrogate) -> None:
    tip = model.predict(X, "deformation", [30_000.0], [model.named["tip"]])[0][:, 0, 0, 2]
    np.testing.assert_allclose(tip, model.predict(X, "elongation", [30_000.0])[0][:, 0], rtol=2e-3)


def test_training_notes_its_bases_and_what_they_lose_of_runs_left_out(model: Surrogate) -> None:
    notes = model.manifest["training"]
    assert notes["runs"] == 66
    for name, part in model.parts.items():
        base = notes["bases"][name]
        assert base["coefficients"] == part.columns.stop - part.columns.start
        assert 0 < base["held_out_percent"] < 2.0


def test_modes_put_the_deformation_together(model: Surrogate) -> None:
    """E T c with T = the modes at a node is the deformation there, error included."""
    nodes, time = [299, 12], 23_000.0
    modes = model.deformation_modes(nodes)
    rows = modes.reshape(6, -1)
    mixed, mixed_sd = model.mode_response(time, rows).evaluate(X)
    direct, sd = model.response("deformation", [time], nodes).evaluate(X)
    np.testing.assert_allclose(mixed, direct, rtol=1e-10, atol=1e-13)
    assert np.all(mixed_sd <= sd)  # without what the truncated modes leave
    np.testing.assert_allclose(mixed_sd[:, 2], sd[:, 2], rtol=0.15)


def test_mixing_can_make_the_modes_errors_uncorrelated(model: Surrogate) -> None:
    c = model.mode_covariance(15_000.0)
    np.testing.assert_allclose(c, c.T, rtol=1e-12)
    values, vectors = np.linalg.eigh(c)
    assert values.min() > -1e-9 * values.max()
    response = model.mode_response(15_000.0, vectors.T[-3:])
    np.testing.assert_allclose(response.ka**2, values[-3:], rtol=1e-9)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda m: m.predict(X, "elongation", [50_001.0]), ["times[0] = 50001.0", "50000 h"]),
        (lambda m: m.predict(X, "elongation", [1.0, -0.1]), ["times[1] = -0.1"]),
        (lambda m: m.response("elongation", [float("nan")]), ["times[0] = nan"]),
        (lambda m: m.predict(X, "ceeq", [1.0], [3, 300]), ["nodes[1] = 300", "0 … 299"]),
        (lambda m: m.response("ceeq", [1.0], [-1]), ["nodes[0] = -1"]),
        (lambda m: m.deformation_modes([1.5]), ["nodes[0] = 1.5"]),
        (lambda m: m.mode_covariance(-1.0), ["times[0] = -1.0"]),
        (
            lambda m: m.predict([1.0, 1.1, 0.0, 0.0], "elongation", [1.0]),
            ["x[0], t1t_rate = 1.1", "0.8 … 1"],
        ),
    ],
)
def test_what_lies_outside_is_refused_with_its_place_and_the_limits(
    model: Surrogate, call: Callable[[Surrogate], object], words: list[str]
) -> None:
    with pytest.raises(RangeError) as caught:
        call(model)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (lambda m: m.predict(X, "stretch", [1.0]), "elongation"),
        (lambda m: m.predict(X[:, :3], "elongation", [1.0]), "tbc_thickness"),
        (lambda m: m.predict(X, "elongation", [1.0], [3]), "leave them out"),
        (lambda m: m.mode_response(1.0, np.ones((2, 1))), "(Q, "),
    ],
)
def test_a_wrong_question_is_refused_with_what_would_be_right(
    model: Surrogate, call: Callable[[Surrogate], object], word: str
) -> None:
    with pytest.raises(InputError) as caught:
        call(model)
    assert word in str(caught.value)


def test_the_scale_of_the_error_is_the_covariance_of_the_left_out_residuals(
    model: Surrogate,
) -> None:
    part: Part = replace(model.parts["ceeq"], cut_time=np.zeros(53), inflation=1.0)
    g0, d = part.forms(np.array([9000.0]), np.array([131]))
    assert g0.shape == (1, 1)
    expected = np.linalg.norm(d[:, 0, 0] @ part.left_out)
    found = part.scale(np.array([9000.0]), np.array([131]), 1.0)
    assert found[0, 0] == pytest.approx(expected, rel=1e-9)
    doubled = replace(part, inflation=2.0).scale(np.array([9000.0]), np.array([131]), 1.0)
    assert doubled[0, 0] == pytest.approx(2 * expected, rel=1e-9)


def own(path: Path, runs: int) -> Archive:
    """A user's archive: a positive field and a signed curve, two inputs, no CEEQ."""
    nodes = np.linspace(0, 1, 12)
    time = np.array([0.0, 1.0, 10.0, 100.0, 1000.0, 4000.0])
    made = Archive.create(
        path,
        inputs=[Input("gas", 900.0, 1200.0), Input("flow", 0.0, 1.0)],
        time_h=time,
        mesh=Mesh("bar", np.zeros((12, 3)), np.zeros((1, 8), int), np.zeros((12, 3)), {"end": 11}),
        seed=1,
        command="own",
        quantities=[Quantity("temperature", "K", "field"), Quantity("twist", "deg", "scalar")],
    )
    for k, (u, w) in enumerate(np.random.default_rng(4).random((runs, 2))):
        fall = np.outer(1 + 0.01 * np.log1p(time), np.exp(-(0.5 + w) * nodes))
        values = {"temperature": (900 + 300 * u) * fall, "twist": (u - w**2) * np.log1p(time)}
        made.write(k, Run({"gas": 900 + 300 * u, "flow": w}, values))
    return made


def test_quantities_of_a_users_own_need_no_blade(tmp_path: Path) -> None:
    model = train(own(tmp_path, 30), seed=3)
    mean, sd = model.predict(np.array([[1050.0, 0.4]]), "twist", [100.0])
    assert mean[0, 0] == pytest.approx((0.5 - 0.16) * np.log(101), rel=1e-3)
    hot, _ = model.predict(np.array([[1050.0, 0.4]]), "temperature", [100.0], [11])
    exact = 1050 * (1 + 0.01 * np.log(101)) * np.exp(-0.9)
    assert hot[0, 0, 0] == pytest.approx(exact, rel=1e-3)
    assert sd[0, 0] > 0
    with pytest.raises(InputError, match="deformation"):
        model.predict(np.array([[1050.0, 0.4]]), "deformation", [100.0])


def test_training_twice_gives_the_same_digest_and_other_runs_another(tmp_path: Path) -> None:
    archive = own(tmp_path, 16)
    first, again = (digest_of(train(archive, range(12), seed=3)) for _ in range(2))
    assert first == again
    assert first != digest_of(train(archive, range(4, 16), seed=3))


def test_too_few_runs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="5 runs are too few for 2 inputs: make 9 or more"):
        train(own(tmp_path, 5))


def test_runs_of_the_same_inputs_count_once(tmp_path: Path) -> None:
    """With their twins in, left-out errors are nothing and so were the bands, 1e8 too narrow."""
    archive = own(tmp_path, 12)
    single = train(archive, seed=3)
    for k in range(12):
        archive.write(12 + k, archive.read(k))
    twice = train(archive, seed=3)
    assert digest_of(twice) == digest_of(single)
    assert twice.manifest["training"]["runs"] == 12
    with pytest.raises(ModelError, match="8 runs are too few"):
        train(archive, [*range(8), *range(12, 20)])


def test_inputs_that_move_together_are_learnt_along_their_line(tmp_path: Path) -> None:
    archive = own(tmp_path, 14)
    for k, u in enumerate(np.linspace(0.0, 1.0, 14)):
        run = archive.read(k)
        twist = u**2 * np.log1p(np.array(archive.declaration.time_h))
        archive.write(k, Run({"gas": 900 + 300 * u, "flow": u}, {**run.values, "twist": twist}))
    mean, sd = train(archive, seed=3).predict(np.array([[1065.0, 0.55]]), "twist", [1000.0])
    assert mean[0, 0] == pytest.approx(0.55**2 * np.log(1001), rel=5e-3)
    assert 0 < sd[0, 0] < 0.05
