from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from core.archive import Archive, Input, Mesh, Quantity, Run
from core.errors import ModelError
from core.surrogate.fitting import hyper_of, reduced
from core.surrogate.targets import FLOOR, Target, forms_of, invert, mean_ceeq, targets_of

Array = NDArray[np.float64]
TIME_H = np.array([0.0, 10.0, 1000.0, 8000.0])
FIELD = Quantity("q", "1", "field")
MESH = Mesh("two", np.zeros((2, 3)), np.zeros((1, 8), int), np.zeros((2, 3)), {"tip": 1})


def small(path: Path, field: Array, quantities: tuple[Quantity, ...], **given: Array) -> Archive:
    """One run per row of the field of CEEQ (n, T, 2); u = (3, 0, 5 + 40 mean CEEQ) at both nodes.

    given   values (n, …) of a quantity in place of these
    """
    made = Archive.create(
        path,
        inputs=[Input("a", 0.0, 1.0)],
        time_h=TIME_H,
        mesh=MESH,
        seed=0,
        command="",
        quantities=quantities,
    )
    for k, ceeq in enumerate(field):
        mean = ceeq.mean(axis=1)
        displacement = np.tile([3.0, 0.0, 5.0], (4, 2, 1))
        displacement[:, :, 2] += 40 * mean[:, None]
        values = {"ceeq": ceeq, "displacement": displacement, "elongation": 40 * mean}
        values |= {name: rows[k] for name, rows in given.items()}
        kept = {q.name: values[q.name] for q in quantities}
        made.write(k, Run({"a": k / len(field)}, kept))
    return made


CEEQ = Quantity("ceeq", "1", "field")
MOVED = Quantity("displacement", "mm", "vector field")
LONGER = Quantity("elongation", "mm", "scalar")


def test_growing_positive_and_signed_quantities_get_their_forms() -> None:
    growing = np.abs(np.random.default_rng(1).random((2, 4, 3)))
    growing[:, 0] = 0
    assert forms_of(growing, FIELD) == ("log rate",)
    assert forms_of(growing + 0.1, FIELD) == ("log", "raw")
    assert forms_of(growing - 0.1, FIELD) == ("raw",)
    assert forms_of(growing, LONGER) == ("log rate", "raw")
    assert forms_of(growing, MOVED) == ("raw",)


def test_rounding_beside_nothing_is_nothing() -> None:
    """Values that a program carried to the nodes: a little below 0, and not quite 0 at first."""
    growing = 1e-3 * np.abs(np.random.default_rng(1).random((2, 4, 3)))
    growing[:, 0] = 1e-10
    growing[0, 1, 2] = -2e-10
    assert forms_of(growing, FIELD) == ("log rate",)
    growing[0, 1, 2] = -2e-5
    assert forms_of(growing, FIELD) == ("raw",)


def test_a_curve_of_creep_strain_is_no_field_that_the_rest_goes_with(tmp_path: Path) -> None:
    ceeq = np.cumsum(np.full((3, 4, 2), 1e-3), axis=1)
    ceeq[:, 0] = 0
    curve = Quantity("ceeq", "1", "scalar")
    archive = small(tmp_path, ceeq, (curve, LONGER), ceeq=ceeq.mean(axis=2))
    found = {t[0].name: t[0].form for t in targets_of(archive, range(3))}
    assert found == {"ceeq": "log rate", "elongation": "log rate"}


def test_an_elongation_with_elastic_stretch_in_it_is_learnt_by_itself(tmp_path: Path) -> None:
    ceeq = np.cumsum(np.full((3, 4, 2), 1e-3), axis=1)
    ceeq[:, 0] = 0
    stretched = 40 * ceeq.mean(axis=2) + 0.5
    archive = small(tmp_path, ceeq, (CEEQ, LONGER), elongation=stretched)
    found = {t[0].name: t[0] for t in targets_of(archive, range(3))}
    assert found["elongation"].form == "log"
    back = invert("log", found["elongation"].values, TIME_H)
    np.testing.assert_allclose(back[:, :, 0], stretched)


def test_a_part_that_is_the_same_in_every_run_does_not_disturb_the_others() -> None:
    rng = np.random.default_rng(4)
    z = rng.uniform(-1, 1, (24, 2))
    shape = np.array([1.0, 2.0, 0.5])
    moved = (np.sin(2 * z[:, 0]) + 0.3 * z[:, 1])[:, None, None] * TIME_H[None, :, None] * shape
    still = np.tile(np.array([3.0, 0.0, 5.0]), (24, 4, 1))
    alone = {"moved": reduced(Target("moved", "raw", TIME_H, moved), 1)}
    for rest in (still, still * (1 + 1e-8 * rng.normal(size=still.shape))):
        both = alone | {"still": reduced(Target("still", "raw", TIME_H, rest), 1)}
        found, plain = hyper_of(z, both), hyper_of(z, alone)
        assert found.trend == plain.trend
        np.testing.assert_allclose(found.lengths, plain.lengths, rtol=1e-3)


def test_targets_lead_back_to_the_quantities(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    ceeq = np.cumsum(rng.uniform(1e-4, 1e-3, (3, 4, 2)), axis=1)
    ceeq[:, 0] = 0
    archive = small(tmp_path, ceeq, (CEEQ, MOVED, LONGER))
    found = {t[0].name: t[0] for t in targets_of(archive, range(3))}
    assert list(found) == ["mean_ceeq", "ceeq", "elastic", "deformation", "elongation"]
    mean = mean_ceeq(archive, range(3))
    np.testing.assert_allclose(mean, ceeq.mean(axis=2), rtol=1e-6)
    scale = found["mean_ceeq"]
    e = invert(scale.form, scale.values, scale.time_h)[:, :, 0]
    np.testing.assert_allclose(e, mean[:, 1:], rtol=1e-12)
    log = found["ceeq"]
    np.testing.assert_allclose(invert(log.form, log.values, log.time_h), ceeq[:, 1:], rtol=1e-6)
    np.testing.assert_allclose(found["elastic"].values[:, 0], [[3, 0, 5] * 2] * 3, rtol=1e-7)
    np.testing.assert_allclose(found["elongation"].values, 40.0, rtol=1e-6)
    moved = found["deformation"].values.reshape(3, 3, 2, 3)
    np.testing.assert_allclose(moved[..., 2], 40.0, rtol=3e-3)  # displacement is single precision
    assert np.all(moved[..., :2] == 0)


def test_what_does_not_creep_counts_as_the_floor(tmp_path: Path) -> None:
    ceeq = np.array([[[0.0, 0.0], [1e-30, 1e-3], [1e-20, 2e-3], [2e-13, 4e-3]]])
    archive = small(tmp_path, ceeq, (CEEQ,))
    (target,) = next(targets_of(archive, [0]))
    expected = np.log(FLOOR * 4e-3 / 8000)
    np.testing.assert_allclose(target.values[0, :, 0], expected, rtol=1e-8)
    np.testing.assert_allclose(np.exp(target.values[0, -1, 1]) * 8000, 4e-3, rtol=1e-6)


def test_without_ceeq_nothing_is_a_share_of_it(tmp_path: Path) -> None:
    ceeq = np.cumsum(np.random.default_rng(3).uniform(1e-4, 1e-3, (2, 4, 2)), axis=1)
    archive = small(tmp_path, ceeq, (MOVED, LONGER))
    found = {t[0].name: t[0] for t in targets_of(archive, range(2))}
    assert {name: target.form for name, target in found.items()} == {
        "displacement": "raw", "deformation": "raw", "elongation": "log"
    }  # fmt: skip
    moved = found["deformation"].values.reshape(2, 4, 2, 3)
    mean = ceeq.mean(axis=2)
    np.testing.assert_allclose(
        moved[..., 2], 40 * np.repeat((mean - mean[:, :1])[:, :, None], 2, axis=2), atol=1e-6
    )


def test_a_run_without_creep_is_refused(tmp_path: Path) -> None:
    still = np.zeros((2, 4, 2))
    still[0, 1:] = 1e-3
    with pytest.raises(ModelError, match="run 1 does not creep"):
        next(targets_of(small(tmp_path / "b", still, (CEEQ, MOVED)), [0, 1]))
