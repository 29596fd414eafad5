from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import splu

from core.blade import Properties, build_mesh, simulate
from core.blade.dissection import Factor, dissect
from core.blade.geometry import BladeMesh, brick
from core.blade.mechanics import LARGE, Structure, Support
from core.errors import InputError, ModelError


def lattice(mesh: BladeMesh) -> np.ndarray:
    return np.rint(2 * mesh.parametric * np.array(mesh.shape)).astype(np.int64)


def grid_laplacian(n: int) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Bilinear elements' coupling of a square of n × n nodes, diagonally dominant."""
    at = np.stack(np.meshgrid(np.arange(n), np.arange(n), [0], indexing="ij"), -1).reshape(-1, 3)
    near = np.abs(at[:, None] - at[None]).max(axis=2) == 1
    matrix = np.where(near, -1.0, 0.0)
    matrix[np.arange(len(at)), np.arange(len(at))] = near.sum(axis=1) + 0.37
    return sparse.csr_matrix(matrix), 2 * at


@pytest.mark.parametrize("closed", [False, True])
def test_every_node_belongs_to_one_part_and_no_element_touches_both_sides_of_a_cut(
    closed: bool,
) -> None:
    mesh = build_mesh("coarse") if closed else brick((4, 3, 5), (1.0, 1.0, 1.0))
    parts = dissect(lattice(mesh), 2 * mesh.shape[0] if closed else 0, leaf=12)
    assert np.array_equal(
        np.sort(np.concatenate([p.nodes for p in parts])), range(len(mesh.points))
    )
    under: list[set[int]] = []
    for part in parts:
        under.append(set(part.nodes.tolist()).union(*(under[k] for k in part.below)))
    cells = [set(cell) for cell in mesh.cells.tolist()]
    for part in parts:
        if len(part.below) == 2:
            left, right = (under[k] for k in part.below)
            assert left
            assert right
            assert not [cell for cell in cells if cell & left and cell & right]


@pytest.mark.parametrize("n", [1, 2, 9, 23])
def test_a_solution_is_that_of_superlu(n: int) -> None:
    matrix, at = grid_laplacian(n)
    parts = dissect(at, leaf=5)
    factor = Factor(matrix, [p.nodes for p in parts], [p.below for p in parts])
    load = np.random.default_rng(n).standard_normal(n * n)
    assert factor.solve(load) == pytest.approx(splu(matrix.tocsc()).solve(load), abs=1e-12)


def test_a_blade_is_displaced_as_by_superlu_whatever_is_prescribed() -> None:
    mesh = build_mesh("coarse")
    hot = 900.0 + 200.0 * mesh.parametric[:, 2]
    tip = mesh.face_nodes("tip")
    fixed = {1: (tip[:5], np.linspace(0.1, 0.3, 5))}
    loose = Support(face="root", fixed=(2,), foundation=3.7)
    found = [
        Structure(
            mesh, hot, Properties(), support=loose, solver=solver, extra_fixed=fixed
        ).displacement()
        for solver in ("splu", "dissection")
    ]
    assert np.abs(found[1] - found[0]).max() < 1e-9 * np.abs(found[0]).max()


def test_a_run_is_the_same_with_either_solver(base: dict[str, float]) -> None:
    hours = np.array([0.0, 30.0, 700.0])
    runs = [
        simulate(base, "coarse", time_h=hours, dtype=np.float64, solver=solver)
        for solver in ("splu", "dissection")
    ]
    assert runs[1].elongation[1:] == pytest.approx(runs[0].elongation[1:], rel=1e-8)
    assert runs[1].ceeq == pytest.approx(runs[0].ceeq, rel=1e-7)


def test_small_meshes_keep_superlu_and_large_ones_are_dissected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mesh = build_mesh("coarse")
    solves = []
    for large in (len(mesh.points) + 1, len(mesh.points)):
        monkeypatch.setattr("core.blade.mechanics.LARGE", large)
        solves.append(Structure(mesh, np.full(len(mesh.points), 900.0), Properties())._solve)
    assert [isinstance(getattr(s, "__self__", None), Factor) for s in solves] == [False, True]
    assert len(build_mesh("fine").points) < LARGE < len(build_mesh("paper").points)


def test_a_tree_that_does_not_separate_is_refused() -> None:
    """Negative control: the same nodes, cut at places that are no borders of elements."""
    matrix, at = grid_laplacian(9)
    parts = dissect(np.random.default_rng(5).permutation(at), leaf=5)
    with pytest.raises(InputError, match="do not separate"):
        Factor(matrix, [p.nodes for p in parts], [p.below for p in parts])


def test_a_matrix_that_is_not_positive_definite_is_refused() -> None:
    matrix, at = grid_laplacian(9)
    parts = dissect(at, leaf=5)
    with pytest.raises(ModelError, match=r"not positive definite \(unknown \d+ of 81\)"):
        Factor(
            sparse.csr_matrix(matrix - 3 * sparse.eye(81)),
            [p.nodes for p in parts],
            [p.below for p in parts],
        )
