from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import meshio
import numpy as np
import pytest

from core.blade import MESHES, BladeMesh, build_mesh, interpolate
from core.blade.element import gauss, shape
from core.blade.geometry import NAMED_POINTS, brick, jacobians
from core.blade.properties import Geometry
from core.errors import InputError, RangeError

COUNTS = {"coarse": 1536, "default": 5600, "fine": 12048, "paper": 27360}


def volumes_of(mesh: meshio.Mesh) -> np.ndarray:
    """Signed volume of each hexahedron20 of a file, by the element's own mapping."""
    points, weights = gauss(3)
    cells = mesh.cells_dict["hexahedron20"]
    jacobian = np.einsum("enx,pna->epxa", mesh.points[cells], shape(points)[1])
    return np.linalg.det(jacobian) @ weights


@pytest.mark.parametrize("name", MESHES)
def test_named_meshes_have_their_numbers_of_nodes_and_all_nodes_are_used(name: str) -> None:
    mesh = build_mesh(name)
    assert len(mesh.points) == COUNTS[name]
    assert np.array_equal(np.unique(mesh.cells), np.arange(COUNTS[name]))


def test_metal_of_the_sections_and_mass_are_those_declared() -> None:
    mesh = build_mesh("fine")
    assert mesh.volume * 8.11e-6 == pytest.approx(0.9006, rel=1e-3)  # kg
    assert jacobians(mesh.points, mesh.cells).min() > 0


def test_tip_and_critical_points_are_the_same_place_in_every_mesh() -> None:
    for a, b in combinations(MESHES, 2):
        for name in NAMED_POINTS:
            first, second = build_mesh(a), build_mesh(b)
            gap = first.points[first.named[name]] - second.points[second.named[name]]
            assert np.abs(gap).max() < 1e-12


def test_written_vtu_is_right_handed_and_carries_the_fields(tmp_path: Path) -> None:
    mesh = build_mesh("coarse")
    field = mesh.points * [1.0, 2.0, 3.0]
    mesh.write_vtu(tmp_path / "blade.vtu", {"displacement": field, "ceeq": mesh.points[:, 2]})
    back = meshio.read(tmp_path / "blade.vtu")
    assert volumes_of(back).min() > 0
    assert volumes_of(back).sum() == pytest.approx(mesh.volume, rel=1e-12)
    assert np.array_equal(back.point_data["displacement"], field)


def test_a_mirrored_mesh_is_refused_and_its_file_would_have_negative_volumes(
    tmp_path: Path,
) -> None:
    mesh = build_mesh("coarse")
    mirrored = mesh.points * [-1.0, 1.0, 1.0]
    meshio.write(tmp_path / "m.vtu", meshio.Mesh(mirrored, [("hexahedron20", mesh.cells)]))
    assert volumes_of(meshio.read(tmp_path / "m.vtu")).max() < 0
    with pytest.raises(InputError, match="left-handed or folded: 256 of 256"):
        replace(mesh, points=mirrored)


def test_the_node_order_of_another_program_is_refused() -> None:
    mesh = build_mesh("coarse")
    order = [*range(12), *range(16, 20), *range(12, 16)]  # vertical edges before the upper ring
    with pytest.raises(InputError) as caught:
        replace(mesh, cells=mesh.cells[:, order])
    assert caught.value.what == "mesh"
    assert "right-handed" in caught.value.remedy


def test_interpolation_is_exact_for_a_field_of_the_element_space() -> None:
    coarse, fine = build_mesh("coarse"), build_mesh("fine")
    c, w, s = coarse.parametric.T
    values = np.stack([s**2 * w - 2 * s + w**2, 1 + 0 * c], axis=1)
    there = interpolate(coarse, values, fine)
    _, w, s = fine.parametric.T
    assert there[:, 0] == pytest.approx(s**2 * w - 2 * s + w**2, abs=1e-13)
    assert there[:, 1] == pytest.approx(1.0, abs=1e-13)


def test_interpolation_onto_the_own_nodes_changes_nothing() -> None:
    mesh = build_mesh("coarse")
    assert interpolate(mesh, mesh.points, mesh) == pytest.approx(mesh.points, abs=1e-12)


def test_interpolated_places_converge_with_the_third_power_of_the_element() -> None:
    geometry, target = Geometry(), build_mesh("paper")
    gaps = []
    for n in (12, 24, 48):
        mesh = build_mesh((n, 1, 16), geometry)
        gaps.append(np.abs(interpolate(mesh, mesh.points, target) - target.points).max())
    rates = np.log2(np.array(gaps[:-1]) / gaps[1:])
    assert np.all(rates > 2.7)


def test_interpolation_wraps_around_the_trailing_edge() -> None:
    mesh = build_mesh("coarse")
    same = np.array([[0.0, 0.3, 0.4], [1.0, 0.3, 0.4], [-1e-9, 0.3, 0.4]])
    there = interpolate(mesh, mesh.points, same)
    assert np.abs(there - there[0]).max() < 1e-5


def test_a_place_outside_the_blade_or_a_field_of_another_mesh_is_refused() -> None:
    mesh = build_mesh("coarse")
    with pytest.raises(RangeError, match="outside the blade"):
        interpolate(mesh, mesh.points, np.array([[0.2, 0.5, 1.3]]))
    with pytest.raises(InputError, match="1536 nodes"):
        interpolate(mesh, np.zeros(1464), mesh)
    with pytest.raises(InputError, match="one row per node"):
        mesh.write_vtu("unused.vtu", {"ceeq": np.zeros(54)})


def test_an_unknown_or_unfit_mesh_is_refused_with_the_choices() -> None:
    with pytest.raises(InputError, match="coarse, default, fine, paper"):
        build_mesh("huge")
    with pytest.raises(InputError, match="no node at critical"):
        build_mesh((18, 1, 8))
    with pytest.raises(InputError, match="3 around"):
        build_mesh((2, 1, 8))


def test_values_of_a_mesh_cannot_be_changed() -> None:
    mesh = build_mesh("coarse")
    with pytest.raises(ValueError, match="read-only"):
        mesh.points[0, 0] = 0.0
    assert mesh.element_nodes is mesh.cells


def test_face_nodes_lie_on_the_plane_of_their_name() -> None:
    mesh = brick((2, 3, 4), (20.0, 30.0, 40.0))
    assert set(mesh.points[mesh.face_nodes("tip"), 2]) == {40.0}
    assert set(mesh.points[mesh.face_nodes("outside"), 1]) == {0.0}
    assert isinstance(mesh, BladeMesh)
    assert mesh.volume == pytest.approx(24000.0)
