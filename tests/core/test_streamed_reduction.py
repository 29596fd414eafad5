"""The reduction of archives that do not fit into memory, against numpy on small ones."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from core.archive import Archive, Input, Mesh, Quantity, Run
from core.errors import InputError
from core.reduction import Basis
from core.reduction.runs import RunRows, parts_of
from core.reduction.streamed import BLOCK, InMemory, streamed_svd
from core.reduction.sweep import Sweep, rank_for, sweep

Array = NDArray[np.float64]
TIME_H = (0.0, 1.0, 10.0, 100.0, 1000.0)
NODES = 30
QUANTITIES = (
    Quantity("ceeq", "1", "field"),
    Quantity("mises", "MPa", "field"),
    Quantity("displacement", "mm", "vector field"),
    Quantity("elongation", "mm", "scalar"),
)


def decaying(m: int, n: int, ratio: float, seed: int = 3) -> Array:
    rng = np.random.default_rng(seed)
    k = min(m, n)
    u, _ = np.linalg.qr(rng.standard_normal((m, k)))
    v, _ = np.linalg.qr(rng.standard_normal((n, k)))
    return (u * ratio ** np.arange(float(k))) @ v.T


def made(folder: Path, runs: int, nodes: int = NODES) -> Archive:
    mesh = Mesh(
        "m", np.zeros((nodes, 3)), np.zeros((1, 8), dtype=np.int64), np.zeros((nodes, 3)), {}
    )
    archive = Archive.create(
        folder,
        inputs=[Input("x", -4.0, 4.0), Input("y", -4.0, 4.0)],
        time_h=TIME_H,
        mesh=mesh,
        seed=1,
        command="",
        quantities=QUANTITIES,
    )
    span, time = np.linspace(0, 1, nodes), np.arange(len(TIME_H))
    for k in range(runs):
        x, y = np.random.default_rng(k).uniform(-1, 1, 2)
        shape = np.exp(x * span + 0.3 * y) * time[:, None]
        archive.write(
            k,
            Run(
                {"x": x, "y": y},
                {
                    "ceeq": 1e-4 * shape,
                    "mises": 150.0 / (1 + np.exp(-y) * span + 0.1 * shape),
                    "displacement": np.stack([shape, np.sin(x * shape), shape**2], axis=-1),
                    "elongation": shape[:, -1],
                },
            ),
        )
    return archive


def stacked(archive: Archive, runs: int) -> Array:
    """All runs' fields as they are, components one after another."""
    rows = []
    for k in range(runs):
        values = archive.read(k).values
        fields = [values["ceeq"], values["mises"]]
        fields += [values["displacement"][..., a] for a in range(3)]
        rows.append(np.concatenate([f.astype(float).ravel() for f in fields]))
    return np.array(rows)


@pytest.mark.parametrize("shape", [(9, 40), (9, 2 * BLOCK + 77), (40, 12)])
def test_two_passes_are_numpys_decomposition_where_the_samples_reach_the_rows(
    shape: tuple[int, int],
) -> None:
    matrix = decaying(*shape, 0.5)
    u, basis = streamed_svd(InMemory(matrix), 8, seed=1, oversample=50)
    exact_u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    np.testing.assert_allclose(basis.singular, s[:8], rtol=1e-10)
    np.testing.assert_allclose(np.abs(np.sum(basis.modes.T * vt[:8], axis=1)), 1.0, rtol=1e-10)
    np.testing.assert_allclose(np.abs(np.sum(u * exact_u[:, :8], axis=0)), 1.0, rtol=1e-10)
    np.testing.assert_allclose(basis.modes.T @ basis.modes, np.eye(8), atol=1e-13)
    assert basis.total == pytest.approx(np.sum(matrix**2), rel=1e-12)


def test_fewer_samples_than_rows_are_as_good_after_a_power_iteration_and_not_before() -> None:
    matrix = decaying(120, 400, 0.9)
    s = np.linalg.svd(matrix, compute_uv=False)[:8]
    _, sharp = streamed_svd(InMemory(matrix), 8, seed=1, iterations=2)
    _, blunt = streamed_svd(InMemory(matrix), 8, seed=1, oversample=0, iterations=0)
    assert np.max(np.abs(sharp.singular / s - 1)) < 1e-3
    assert np.max(np.abs(blunt.singular / s - 1)) > 0.1


def test_rows_of_few_directions_give_these_and_no_more() -> None:
    rng = np.random.default_rng(5)
    matrix = rng.standard_normal((30, 3)) @ rng.standard_normal((3, 500))
    _, basis = streamed_svd(InMemory(matrix), 8, seed=1)
    assert len(basis.singular) == basis.modes.shape[1] == 3
    assert basis.energy[2] == pytest.approx(1.0, rel=1e-13)


def test_single_precision_loses_no_more_than_its_rounding() -> None:
    matrix = decaying(30, 4000, 0.6)
    double = streamed_svd(InMemory(matrix), 6, seed=1)[1]
    single = streamed_svd(InMemory(matrix), 6, seed=1, dtype=np.float32)[1]
    assert single.modes.dtype == np.float32
    np.testing.assert_allclose(single.singular, double.singular, rtol=3e-6)
    assert np.abs(single.modes.T @ single.modes - np.eye(6)).max() < 1e-5


def test_passes_are_two_and_two_more_for_each_power_iteration() -> None:
    class Counted(InMemory):
        read = 0

        def blocks(self) -> Iterator[Array]:
            Counted.read += 1
            return super().blocks()

    matrix, told = decaying(40, 90, 0.7), list[tuple[int, int]]()
    streamed_svd(Counted(matrix), 5, seed=1, iterations=3, progress=lambda *t: told.append(t))
    assert Counted.read == 8
    assert told == [(k, 8) for k in range(1, 9)]


def test_rows_that_end_early_or_are_zero_are_refused() -> None:
    class Short(InMemory):
        def blocks(self) -> Iterator[Array]:
            yield self.matrix[:7]

    with pytest.raises(InputError, match=r"rows = 7 are not the 20 told"):
        streamed_svd(Short(decaying(20, 30, 0.5)), 3, seed=1)
    with pytest.raises(InputError, match="all zero"):
        streamed_svd(InMemory(np.zeros((20, 30))), 3, seed=1)


def test_rows_of_an_archive_are_its_six_quantities_on_their_own_scales(tmp_path: Path) -> None:
    archive = made(tmp_path / "a", 7)
    rows = RunRows.of(archive, range(5), each=2)
    names = ["ceeq", "mises", "displacement_x", "displacement_y", "displacement_z"]
    assert [part.name for part in rows.parts] == names
    assert [part.unit for part in rows.parts] == ["1", "MPa", "mm", "mm", "mm"]
    every = stacked(archive, 7)
    np.testing.assert_allclose(rows.mean, every[:5].mean(axis=0), rtol=1e-12, atol=1e-15)
    centred = every - every[:5].mean(axis=0)
    size = len(TIME_H) * NODES
    scale = np.sqrt((centred[:5].reshape(5, 5, size) ** 2).mean(axis=(0, 2)))
    np.testing.assert_allclose(rows.scale, scale, rtol=1e-12)
    scaled = centred / np.repeat(scale, size)
    np.testing.assert_allclose(np.vstack(list(rows.blocks())), scaled[:5], atol=1e-12)
    np.testing.assert_allclose(np.vstack(list(rows.others([6, 5]).blocks())), scaled[[6, 5]])
    np.testing.assert_allclose(
        np.vstack(list(rows.only("displacement_y").blocks())), scaled[:5, 3 * size : 4 * size]
    )


def test_the_reduction_of_an_archive_is_numpys(tmp_path: Path) -> None:
    archive = made(tmp_path / "a", 9)
    rows = RunRows.of(archive, range(9))
    matrix = np.vstack(list(rows.blocks()))
    _, s, vt = np.linalg.svd(matrix, full_matrices=False)
    basis = streamed_svd(rows, 4, seed=1)[1]
    np.testing.assert_allclose(basis.singular, s[:4], rtol=1e-10)
    np.testing.assert_allclose(np.abs(np.sum(basis.modes.T * vt[:4], axis=1)), 1.0, rtol=1e-9)
    np.testing.assert_allclose(basis.energy, (np.cumsum(s**2) / np.sum(s**2))[:4], rtol=1e-12)


def test_quantities_that_are_chosen_or_curves_alone(tmp_path: Path) -> None:
    archive = made(tmp_path / "a", 3)
    chosen = parts_of(archive, ["elongation", "displacement_z"])
    assert [(p.name, p.columns) for p in chosen] == [
        ("elongation", slice(0, 5)),
        ("displacement_z", slice(5, 5 + 5 * NODES)),
    ]
    with pytest.raises(InputError, match=r"use some of ceeq, mises, displacement_x"):
        parts_of(archive, ["displacement"])
    with pytest.raises(InputError, match="fewer than two runs"):
        RunRows.of(archive, [0])


def direct(matrix: Array, unseen: Array, rank: int, scale: Array) -> Array:
    """What the first modes lose of unseen rows, in own units."""
    mean = matrix.mean(axis=0)
    modes = np.linalg.svd((matrix - mean) / scale, full_matrices=False)[2][:rank]
    a = (unseen - mean) / scale
    return np.asarray((a - a @ modes.T @ modes) * scale)


def test_a_sweep_tells_what_each_rank_loses_of_each_quantity(tmp_path: Path) -> None:
    archive = made(tmp_path / "a", 12)
    rows = RunRows.of(archive, range(9))
    basis = streamed_svd(rows, 6, seed=1)[1]
    found = sweep(rows.others([9, 10, 11]), basis, [5, 1, 3])
    every, size = stacked(archive, 12), len(TIME_H) * NODES
    scale = np.repeat(rows.scale, size)
    assert found.ranks == (1, 3, 5)
    for k, rank in enumerate(found.ranks):
        lost = direct(every[:9], every[9:], rank, scale).reshape(3, 5, size)
        x = every[9:].reshape(3, 5, size)
        error = np.sqrt((lost**2).sum(axis=(0, 2)) / (x**2).sum(axis=(0, 2)))
        np.testing.assert_allclose(found.error[:, k], error, rtol=1e-6)
        np.testing.assert_allclose(
            found.rmse[:, k], np.sqrt((lost**2).mean(axis=(0, 2))), rtol=1e-6
        )
        assert found.paper_rmse[k] == pytest.approx(np.sqrt((lost**2).mean()), rel=1e-6)
        each = np.sqrt((lost**2).sum(axis=2) / (x**2).sum(axis=2))
        np.testing.assert_allclose(found.worst[:, k], each.max(axis=0), rtol=1e-6)
        assert found.overall[k] == pytest.approx(np.sqrt((error**2).mean()), rel=1e-6)
    assert found.paper_magnitude == pytest.approx(np.abs(every[9:]).mean(), rel=1e-12)


def test_runs_that_a_basis_has_seen_are_reconstructed_better_than_others(tmp_path: Path) -> None:
    """Negative control of the held-out error: on its own runs a full basis loses nothing."""
    archive = made(tmp_path / "a", 12)
    rows = RunRows.of(archive, range(6))
    basis = streamed_svd(rows, 6, seed=1)[1]
    most = basis.modes.shape[1]
    seen, unseen = (sweep(rows.others(k), basis, [most]) for k in (range(6), range(6, 12)))
    assert seen.overall[0] < 1e-7
    assert unseen.overall[0] > 1e-4


def test_ranks_or_rows_that_do_not_fit_a_basis_are_refused(tmp_path: Path) -> None:
    archive = made(tmp_path / "a", 5)
    rows = RunRows.of(archive, range(5))
    basis = streamed_svd(rows, 3, seed=1)[1]
    with pytest.raises(InputError, match=r"not in 1 … 3"):
        sweep(rows, basis, [2, 4])
    with pytest.raises(InputError, match="use its own rows"):
        sweep(rows.only("ceeq"), basis, [1])


def test_a_rank_is_the_first_from_which_on_the_error_stays_below() -> None:
    assert rank_for([0.5, 0.2, 0.05], [1, 2, 3], 0.2) == 2
    assert rank_for([0.5, 0.2, 0.05], [1, 2, 3], 0.01) is None


def peak_mb(archive: Archive, runs: int, whole: bool) -> float:
    tracemalloc.start()
    try:
        if whole:
            matrix = np.vstack(list(RunRows.of(archive, range(runs), each=2).blocks()))
            Basis.of(matrix, 2, seed=1)
        else:
            rows = RunRows.of(archive, range(runs), each=2)
            basis = streamed_svd(rows, 2, seed=1, oversample=2)[1]
            sweep(rows, basis, [2])
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()


def test_memory_does_not_grow_with_the_runs(tmp_path: Path) -> None:
    """The negative control, which loads all of them, grows by half and more."""
    archive = made(tmp_path / "a", 16, nodes=1600)
    for _ in range(3):  # threads that other tests left in this process allocate as well
        few, many = (peak_mb(archive, runs, whole=False) for runs in (4, 16))
        if many < 1.1 * few:
            break
    assert many < 1.1 * few
    few, many = (peak_mb(archive, runs, whole=True) for runs in (4, 16))
    assert many > 1.5 * few


def test_a_sweep_is_made_of_sums() -> None:
    one = np.ones((2, 1, 1))
    found = Sweep((), (1,), one, 4 * one[..., 0], 2 * one[..., 0], one[..., 0])
    assert found.error[0, 0] == 0.5
    assert found.spread[0, 0] == pytest.approx(np.sqrt(0.5))
