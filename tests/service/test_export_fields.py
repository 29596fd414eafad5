"""Fields as VTU and predictions as CSV, read back by meshio and pandas."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import meshio
import numpy as np
import pandas
import pytest

from core.archive.cells import CORNERS, FROM_MESHIO
from core.blade.geometry import build_mesh
from core.calibration.state import Posterior
from core.model import rotor_blade
from core.observation import Inspection
from core.smc.particles import Particles
from service.export.vtu import CELL_TYPES, vtu
from service.fields import field_of, mesh_of, surface_of
from service.ports import Mesh
from service.science import CoreScience
from service.worker.loop import Worker

Json = dict[str, Any]
BLADE = "/v1/rotors/r1/blades/B1"


@pytest.fixture
def told(
    rotor: str, post: Callable[..., int], reading: Callable[..., Inspection], worker: Worker
) -> str:
    """B1 has a reading."""
    post(rotor, reading("i1"))
    worker.drain()
    return rotor


def read(body: bytes, tmp_path: Path) -> meshio.Mesh:
    file = tmp_path / "field.vtu"
    file.write_bytes(body)
    return meshio.read(file)


@pytest.mark.parametrize(("quantity", "unit"), [("deformation", "mm"), ("ceeq", "1")])
def test_meshio_reads_the_field_that_the_api_says_on_the_model_s_points(
    api: httpx.Client,
    told: str,
    tmp_path: Path,
    quantity: str,
    unit: str,
) -> None:
    path = f"{BLADE}/field?quantity={quantity}&time_h=30000"
    answer = api.get(f"{path}&format=vtu")
    version = api.get("/v1/rotors/r1").json()["version"]
    saved = f'attachment; filename="r1-B1-{quantity}-30000h-v{version}.vtu"'
    assert answer.headers["content-disposition"] == saved
    found, said = read(answer.content, tmp_path), api.get(path).json()
    for what in ("mean", "sd"):
        values = found.point_data[f"{quantity} {what} [{unit}]"]
        assert values.tolist() == said[what]
    assert found.field_data["TimeValue"].tolist() == [30_000.0]
    surface = api.get("/v1/models/rotor-blade/surface").json()
    np.testing.assert_allclose(found.points, surface["points"], atol=1e-3)
    assert found.cells_dict["triangle"].tolist() == surface["triangles"]
    told_of = answer.text.partition("<?bladetwin ")[2].partition("?>")[0]
    assert said["rests_on"]["state_digest"] in told_of


def test_a_field_of_the_shipped_model_lies_on_its_quadratic_hexahedra(tmp_path: Path) -> None:
    science = CoreScience()
    card = science.builtin("rotor-blade")
    mesh = science.mesh(card)
    assert mesh is not None
    rng = np.random.default_rng(3)
    psi = np.column_stack([rng.normal(1, 0.05, 64), *rng.normal(0, 0.3, (2, 64)),
                           rng.normal(0.9, 0.01, 64)])  # fmt: skip
    names = ("tbc_thickness", "creep_transient", "creep_steady", "t1t_rate")
    own = Posterior(names, Particles(psi, np.zeros(64)))
    field = field_of(rotor_blade(), own, "deformation", 30_000.0, None)
    body = vtu(mesh, {"mean": field.mean, "sd": field.sd}, 30_000.0, {"rotor": "r--1 ?> <a>"})
    found = read(body, tmp_path)
    built = build_mesh("default")
    assert found.points.tobytes() == built.points.tobytes()
    assert found.cells_dict["hexahedron20"].tolist() == built.cells.tolist()
    assert found.point_data["mean"].tobytes() == field.mean.tobytes()
    tip = card.nodes["tip"]
    assert found.point_data["mean"][tip, 2] > 0.05, "the tip grows outwards"
    assert ET.fromstring(body).tag == "VTKFile", "whatever the facts hold"
    assert mesh_of(built.points + 0.01, "default") is None, "negative control: another mesh"


def test_a_model_that_effects_drive_keeps_its_mesh() -> None:
    science = CoreScience()
    card = science.builtin("rotor-blade-wide")
    mesh = science.mesh(card)
    assert mesh is not None
    assert mesh.cells.shape == (960, 20)
    assert science.surface(card) is not None
    fine = science.builtin("rotor-blade").summary["errors"]
    assert card.summary["anchor"]["errors"] == fine
    assert card.summary["errors"] != fine


@pytest.mark.parametrize("kind", [*CELL_TYPES])
def test_meshio_reads_a_users_mesh_of_every_kind_of_cells(kind: str, tmp_path: Path) -> None:
    assert CELL_TYPES.keys() == CORNERS.keys()
    points = np.random.default_rng(1).random((CORNERS[kind] + 3, 3))
    cells = np.array([np.arange(CORNERS[kind]), 3 + np.arange(CORNERS[kind])])
    mesh = mesh_of(points, None, (kind, cells))
    assert mesh is not None
    assert mesh.own
    field = points[:, 0]
    found = read(vtu(mesh, {"warmth mean [K]": field}, 8.0, {}), tmp_path)
    assert found.points.tolist() == points.tolist()
    order = FROM_MESHIO.get(kind, [*range(CORNERS[kind])])
    assert found.cells_dict[kind][:, order].tolist() == cells.tolist()
    assert found.point_data["warmth mean [K]"].tolist() == field.tolist()


def test_without_cells_the_nodes_are_drawn_and_without_places_nothing_is() -> None:
    points = np.random.default_rng(1).random((4, 3))
    mesh = mesh_of(points, None)
    assert mesh is not None
    assert (mesh.kind, mesh.cells.tolist()) == ("vertex", [[0], [1], [2], [3]])
    points[2] = np.nan
    assert mesh_of(points, None) is None
    assert surface_of(points[:2], None) is None


def test_names_and_numbers_of_a_vtu_are_those_given(tmp_path: Path) -> None:
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0.25]]), np.array([[0, 1, 2]]), "triangle")
    data = {'a "b" <c> & [µm]': np.array([1e-300, -2.5, np.pi])}
    found = read(vtu(mesh, data, 0.1, {}), tmp_path)
    assert {name: values.tolist() for name, values in found.point_data.items()} == {
        'a "b" <c> & [µm]': [1e-300, -2.5, np.pi]
    }
    assert found.points[2].tolist() == [0.0, 1.0, 0.25]


def test_pandas_reads_a_prediction_to_the_last_digit(api: httpx.Client, told: str) -> None:
    path = f"{BLADE}/prediction?times=0,8000.5,50000&probability=0.9"
    answer = api.get(f"{path}&format=csv")
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    found = pandas.read_csv(io.BytesIO(answer.content))
    said = api.get(path).json()
    assert found["time_h"].tolist() == [0.0, 8000.5, 50_000.0]
    for name in ("mean", "lower", "upper"):
        assert found[name].tolist() == said[name]
    for name, values in said["sd"].items():
        assert found[f"sd_{name}"].tolist() == values
    for level, values in said["quantiles"].items():
        assert found[f"q{level}"].tolist() == values
    assert set(found["rotor"]) == {"r1"}
    assert set(found["version"]) == {said["rests_on"]["version"]}
    assert set(found["probability"]) == {0.9}
    assert found["sealed"].all()


def test_a_vector_s_prediction_has_a_row_for_each_direction(api: httpx.Client, told: str) -> None:
    path = f"{BLADE}/prediction?quantity=deformation&node=17&times=8000,50000"
    body = api.get(f"{path}&format=csv").content
    found = pandas.read_csv(io.BytesIO(body))
    said = api.get(path).json()
    assert found["component"].tolist() == ["x", "y", "z"] * 2
    assert found["mean"].to_numpy().reshape(2, 3).tolist() == said["mean"]
    assert set(found["node"]) == {17}
