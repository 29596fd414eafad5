"""Tables, numpy archives and series of mesh files become the one format."""

from __future__ import annotations

import json
from pathlib import Path

import meshio
import numpy as np
import pytest
import xarray as xr

from core.archive.arrays import convert_arrays
from core.archive.cells import CORNERS
from core.archive.faults import RunsError
from core.archive.meshes import convert_meshes
from core.archive.opening import opened
from core.archive.table import convert_table, read_table
from core.archive.take import take
from core.errors import ModelError, UnitError
from core.units import ratio, unit
from service.export.vtu import vtu
from service.ports import Mesh
from tests.exchanger import TIME_H, drop, network, points, write_table


def fields(error: pytest.ExceptionInfo[RunsError]) -> list[str]:
    return [one.what for one in error.value.faults]


def test_a_table_becomes_runs_whatever_the_order_of_its_lines(tmp_path: Path) -> None:
    x = points(12)
    table = write_table(tmp_path / "runs.csv", x)
    head, *lines = table.read_text().splitlines()
    shuffled = np.random.default_rng(1).permutation(len(lines))
    table.write_text("\ufeff" + "\n".join([head, *(lines[i] for i in shuffled)]) + "\n")
    convert_table(table, tmp_path / "runs.nc")
    with xr.open_dataset(tmp_path / "runs.nc", engine="h5netcdf", decode_times=False) as data:
        order = [int(label) for label in data["run"].values]
        assert sorted(order) == list(range(12))
        np.testing.assert_array_equal(data["time"], TIME_H)
        np.testing.assert_array_equal(data["roughness"], x[order, 0])
        assert data["drop"].attrs["units"] == "kPa"
        for place, k in enumerate(order):
            np.testing.assert_array_equal(data["drop"][place], drop(x[k], TIME_H))


def test_an_empty_cell_of_a_table_is_a_value_that_is_missing(tmp_path: Path) -> None:
    table = write_table(tmp_path / "runs.csv", points(12), {(3, 5): "", (8, 2): "NaN"})
    convert_table(table, tmp_path / "runs.nc")
    with opened(tmp_path / "runs.nc") as source, pytest.raises(RunsError) as caught:
        take(source, network(), tmp_path / "taken")
    assert fields(caught) == ["run 3: drop", "run 8: drop"]
    assert "at 4000 h" in caught.value.faults[0].problem


def test_runs_of_a_table_may_have_instants_of_their_own(tmp_path: Path) -> None:
    table = write_table(tmp_path / "runs.csv", points(12))
    lines = [line for line in table.read_text().splitlines() if not line.startswith("2,250")]
    table.write_text("\n".join(lines))
    convert_table(table, tmp_path / "runs.nc")
    with opened(tmp_path / "runs.nc") as source:
        archive, found, chosen = take(source, network(), tmp_path / "taken")
    assert source.time_h.shape == (12, 9)
    assert archive.declaration.time_h == tuple(TIME_H)
    assert next(one.value for one in found.warnings if one.what == "runs") == "2"
    assert len(chosen) == 12


@pytest.mark.parametrize(
    ("text", "what", "words"),
    [
        ("run,time [h],a [1],y\n1,0,2,3\n", "column y", "has no unit"),
        ("run,time [h],a [1],y [smoot]\n1,0,2,3\n", "column y", "is no unit"),
        ("run,time [mm],a [1],y [K]\n1,0,2,3\n", "column time", "not of s"),
        ("run,time [a],a [1],y [K]\n1,0,2,3\n", "column time", "does not say how many hours"),
        ("time [h],a [1],y [K]\n0,2,3\n", "header", "missing among the columns"),
        ("run,time [h],a [1],a [1]\n1,0,2,3\n", "header", "a column twice"),
        ("run,time [h],a [1],y [K]\n1,0,2,3\n1,5,2,4;5\n", "line 3: y", "is no number"),
        ("run,time [h],a [1],y [K]\n1,0,2\n", "line 2", "has not the 4 cells"),
        ("run,time [h],a [1],y [K]\n1,0,2,3\n1,0,2,4\n", "run 1", "two lines at 0 h"),
        ("run,time [h],a [1],y [K]\n1,,2,3\n", "line 2: time", "is no instant"),
        ("run,time [h],a [1],y [K]\n,0,2,3\n", "line 2: run", "is empty"),
        ("run,time [h],a [1],y [K]\n1,0,2,inf\n", "line 2: y", "is not finite"),
        ("run,time [h],points [1],y [K]\n1,0,2,3\n", "header", "keeps for itself"),
    ],
)
def test_what_is_wrong_with_a_table_is_told_with_line_and_column(
    text: str, what: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "runs.csv").write_text(text)
    with pytest.raises(RunsError) as caught:
        read_table(tmp_path / "runs.csv")
    assert caught.value.faults[0].what == what
    assert words in str(caught.value.faults[0])


def test_a_table_in_another_encoding_is_told_how_to_save_it(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_bytes("run,time [h],a [1],y [µm]\n1,0,2,3\n".encode("latin-1"))
    with pytest.raises(ModelError, match=r"no text in UTF-8.*0xb5.*save it as CSV in UTF-8"):
        read_table(tmp_path / "runs.csv")
    with pytest.raises(ModelError, match=r"cannot be read as CSV: .*No such file"):
        read_table(tmp_path / "nowhere.csv")


def test_an_input_that_is_named_and_changes_within_a_run_is_refused(tmp_path: Path) -> None:
    table = write_table(tmp_path / "runs.csv", points(12))
    with pytest.raises(RunsError, match="one value for each run"):
        convert_table(table, tmp_path / "a.nc", inputs=["roughness", "drop"])
    with pytest.raises(RunsError, match="is no column"):
        convert_table(table, tmp_path / "a.nc", inputs=["grain"])
    assert not (tmp_path / "a.nc").exists()
    told = convert_table(table, tmp_path / "a.nc", inputs=["roughness"])
    assert told["quantities"] == ["fouling_rate", "drop"]


def arrays(path: Path, **change: object) -> Path:
    x = points(12)
    told: dict[str, object] = {
        "roughness": x[:, 0],
        "fouling_rate": x[:, 1],
        "drop": np.array([drop(a, TIME_H) for a in x]),
        "time": TIME_H,
        "units": json.dumps({"roughness": "um", "fouling_rate": "1/h", "drop": "kPa", "time": "h"}),
        "bounds": json.dumps({"roughness": [1.0, 9.0]}),
    }
    np.savez(path, **(told | change))  # type: ignore[arg-type]
    return path


def test_a_numpy_archive_becomes_runs(tmp_path: Path) -> None:
    told = convert_arrays(arrays(tmp_path / "runs.npz"), tmp_path / "runs.nc")
    assert told == {"runs": 12, "inputs": ["roughness", "fouling_rate"], "quantities": ["drop"]}
    with opened(tmp_path / "runs.nc") as source:
        assert (source.inputs["roughness"].low, source.inputs["roughness"].high) == (1.0, 9.0)
        np.testing.assert_array_equal(source.read(7, "drop"), drop(points(12)[7], TIME_H))


def test_a_numpy_archive_that_does_not_fit_or_is_pickled_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunsError) as caught:
        convert_arrays(
            arrays(tmp_path / "a.npz", drop=np.zeros((12, 5)), units="{}"), tmp_path / "n"
        )
    assert fields(caught) == [
        "units of time", "units of roughness", "units of fouling_rate", "units of drop", "drop"
    ]  # fmt: skip
    odd = arrays(tmp_path / "b.npz", drop=np.array([{}, 1], dtype=object))
    with pytest.raises(ModelError, match="without pickle"):
        convert_arrays(odd, tmp_path / "n")
    (tmp_path / "c.npz").write_text("no zip")
    with pytest.raises(ModelError, match=r"c\.npz"):
        convert_arrays(tmp_path / "c.npz", tmp_path / "n")


def meshes(folder: Path, runs: int = 3, spoil: str = "") -> Path:
    """VTU files of a warm bar of four hexahedra, and their table."""
    grid = np.array([[x, y, z] for z in range(5) for y in range(2) for x in range(2)], float)
    cells = [
        [4 * z + k for k in (0, 1, 3, 2)] + [4 * z + 4 + k for k in (0, 1, 3, 2)] for z in range(4)
    ]
    lines = ["run,time [h],file,load [kN],reaction [N]"]
    for k in range(runs):
        for i, t in enumerate((0.0, 10.0, 40.0, 90.0)):
            name = f"run{k}-{i}.vtu"
            warm = 300 + (k + 1) * t * grid[:, 2]
            moved = 1e-3 * np.outer(warm - 300, [0, 0, 1])
            here = grid + (0.01 if spoil == name else 0.0)
            data = {"temperature": warm, "displacement": moved}
            meshio.Mesh(here, [("hexahedron", cells)], point_data=data).write(folder / name)
            lines.append(f"{k},{t},{name},{k + 1},{100 * t + k}")
    (folder / "runs.csv").write_text("\n".join(lines))
    return folder / "runs.csv"


def test_a_series_of_mesh_files_becomes_fields_on_one_mesh(tmp_path: Path) -> None:
    wanted = {"temperature": "K", "displacement": "m"}
    told = convert_meshes(meshes(tmp_path), tmp_path / "runs.nc", wanted, named={"end": 19})
    assert told["quantities"] == ["reaction", "temperature", "displacement"]
    with opened(tmp_path / "runs.nc") as source:
        assert source.mesh.named == {"end": 19}
        assert source.mesh.cells.shape == (4, 8)
        np.testing.assert_allclose(source.mesh.points[19], [1, 1, 4])
        assert source.quantities["displacement"].kind == "vector field"
        np.testing.assert_allclose(source.read(1, "temperature")[2, 19], 300 + 2 * 40 * 4)
        np.testing.assert_allclose(source.read(2, "reaction"), [2, 1002, 4002, 9002])
        assert source.inputs["load"].values.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("kind", ["quad", "tetra", "wedge", "hexahedron"])
def test_the_cells_of_mesh_files_stay_what_they_are_in_vtks_order(
    kind: str, tmp_path: Path
) -> None:
    lines, told = ["run,time [h],file,load [kN]"], np.arange(CORNERS[kind])[None]
    points = np.random.default_rng(0).random((CORNERS[kind], 3))
    mesh = Mesh(points, told, kind)  # `vtu` writes it in VTK's order
    for k, t in np.ndindex(3, 4):
        name = f"run{k}-{t}.vtu"
        (tmp_path / name).write_bytes(vtu(mesh, {"warm": k * t * points[:, 0]}, float(t), {}))
        lines.append(f"{k},{t},{name},{k + 1}")
    (tmp_path / "runs.csv").write_text("\n".join(lines))
    convert_meshes(tmp_path / "runs.csv", tmp_path / "runs.nc", {"warm": "K"})
    with opened(tmp_path / "runs.nc") as source:
        assert source.mesh.kind == kind
        assert source.mesh.cells.tolist() == told.tolist()


def test_a_plane_mesh_without_z_lies_at_0(tmp_path: Path) -> None:
    """Of xdmf files, whose points have as many coordinates as were written."""
    lines, plane = ["run,time [h],file,load [kN]"], np.random.default_rng(0).random((6, 2))
    for k, t in np.ndindex(3, 4):
        name = f"run{k}-{t}.xdmf"
        cells, data = [("triangle", np.arange(6).reshape(2, 3))], {"warm": k * t * np.arange(6.0)}
        meshio.Mesh(plane, cells, point_data=data).write(tmp_path / name)
        lines.append(f"{k},{t},{name},{k + 1}")
    (tmp_path / "runs.csv").write_text("\n".join(lines))
    convert_meshes(tmp_path / "runs.csv", tmp_path / "runs.nc", {"warm": "K"}, named={"end": 5})
    with opened(tmp_path / "runs.nc") as source:
        np.testing.assert_array_equal(source.mesh.points, np.pad(plane, ((0, 0), (0, 1))))
        np.testing.assert_array_equal(source.read(2, "warm")[3], 6 * np.arange(6.0))
    with pytest.raises(RunsError, match="node end = 6 is not in 0 … 5"):
        convert_meshes(tmp_path / "runs.csv", tmp_path / "n", {"warm": "K"}, named={"end": 6})


def test_a_mesh_file_that_is_missing_moved_or_lacks_the_field_is_named(tmp_path: Path) -> None:
    table = meshes(tmp_path, spoil="run1-2.vtu")
    with pytest.raises(RunsError) as caught:
        convert_meshes(table, tmp_path / "runs.nc", {"temperature": "K"})
    assert fields(caught) == ["run 1: run1-2.vtu"]
    assert not (tmp_path / "runs.nc").exists()
    with pytest.raises(RunsError, match="its point data are temperature, displacement"):
        convert_meshes(table, tmp_path / "runs.nc", {"strain": "1"})
    (tmp_path / "run2-3.vtu").unlink()
    with pytest.raises(RunsError, match=r"run 2: file at 90 h = 'run2-3\.vtu' does not exist"):
        convert_meshes(table, tmp_path / "runs.nc", {"temperature": "K"})


@pytest.mark.parametrize(
    ("given", "wanted", "factor"),
    [
        ("m", "mm", 1e3), ("MPa", "Pa", 1e6), ("ksi", "MPa", 6.894757293168), ("%", "1", 0.01),
        ("um/h", "mm/d", 0.024), ("W/(m2 K)", "kW m^-2 K^-1", 1e-3), ("m²·K/W", "m2 K/W", 1.0),
        ("min", "h", 1 / 60), ("mm/yr", "um/h", 1e3 / 8766), ("1/kh", "1/h", 1e-3),
        ("hours", "days", 1 / 24), ("seconds", "hr", 1 / 3600), ("weeks", "h", 168.0),
        ("l/min", "m3/h", 0.06), ("N mm", "J", 1e-3),
    ],
)  # fmt: skip
def test_units_of_the_same_differ_by_their_factor(given: str, wanted: str, factor: float) -> None:
    a, b = ratio(given, wanted)
    assert (a, b) == (pytest.approx(factor, rel=1e-9), 0.0)


@pytest.mark.parametrize(
    "text", ["", "smoot", "m/", "m//s", "(m", "m)", "1e3 m", "m^99", "mmm", "-"]
)
def test_a_text_that_is_no_unit_is_refused(text: str) -> None:
    with pytest.raises(UnitError, match="is no unit"):
        unit(text)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"time": np.array(["a"] * 9)}, "time"),
        ({"time": np.array(3.0)}, "time"),
        ({"time": np.zeros((3, 9))}, "time"),
        ({"run": np.arange(3)}, "run"),
        ({"bounds": json.dumps({"roughness": [1.0]})}, "bounds of roughness"),
        ({"bounds": json.dumps({"roughness": ["a", "b"]})}, "bounds of roughness"),
        ({"bounds": json.dumps({"roughness": 5})}, "bounds of roughness"),
        ({"bounds": json.dumps({"roughnes": [1.0, 9.0]})}, "bounds of roughnes"),
        ({"bounds": json.dumps({"drop": [1.0, 9.0]})}, "bounds of drop"),
        ({"xyz": np.zeros(12)}, "xyz"),
        ({"a/b": np.zeros(12)}, "a/b"),
    ],
)
def test_arrays_that_do_not_fit_each_other_are_named(
    change: dict[str, object], what: str, tmp_path: Path
) -> None:
    with pytest.raises(RunsError) as caught:
        convert_arrays(arrays(tmp_path / "a.npz", **change), tmp_path / "n")
    assert what in fields(caught)
    assert not (tmp_path / "n").exists()


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"cells": np.array([0, 9])}, "cells"),
        ({"cells": np.array([[0, 9]])}, "cells"),
        ({"cells": np.array([[0.5, np.nan]])}, "cells"),
        ({"points": np.full((6, 3), "a")}, "points"),
        ({"points": np.zeros((5, 3))}, "points"),
    ],
)
def test_a_mesh_that_does_not_fit_the_fields_is_named(
    change: dict[str, object], what: str, tmp_path: Path
) -> None:
    units = {"roughness": "um", "fouling_rate": "1/h", "drop": "kPa", "time": "h", "heat": "K"}
    whole: dict[str, object] = {"heat": np.ones((12, 9, 6)), "points": np.zeros((6, 3))}
    whole |= {"cells": np.array([[0, 5]]), "units": json.dumps(units)}
    convert_arrays(arrays(tmp_path / "a.npz", **whole), tmp_path / "sound")
    with pytest.raises(RunsError) as caught:
        convert_arrays(arrays(tmp_path / "a.npz", **(whole | change)), tmp_path / "n")
    assert fields(caught) == [what]


def test_arrays_without_runs_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time=TIME_H, units=json.dumps({"time": "h"}))
    with pytest.raises(RunsError, match="holds no input"):
        convert_arrays(tmp_path / "a.npz", tmp_path / "n")


@pytest.mark.parametrize("text", ["m^", "m^s", "kg m^ s^-2", "m**", "m^^2", "^2"])
def test_a_power_without_its_number_is_refused(text: str) -> None:
    with pytest.raises(UnitError, match="is no unit"):
        unit(text)


@pytest.mark.parametrize("text", ["(" * 3000 + "m" + ")" * 3000, "m" + "9" * 5000])
def test_a_text_of_thousands_of_letters_is_refused_in_few(text: str) -> None:
    """No RecursionError, nor Python's own bound on digits."""
    with pytest.raises(UnitError, match="is no unit") as told:
        unit(text)
    assert len(str(told.value)) < 500


@pytest.mark.parametrize(
    ("given", "wanted"), [("rpm", "rad/s"), ("rad/s", "rpm"), ("Hz", "rad/s"), ("deg/s", "kHz")]
)
def test_turns_and_angles_are_not_taken_for_each_other(given: str, wanted: str) -> None:
    """Both are 1/s without a dimension, and 2 π apart."""
    with pytest.raises(UnitError, match="turns"):
        ratio(given, wanted)


def test_turns_among_themselves_and_angles_among_themselves_compare() -> None:
    assert ratio("rpm", "Hz")[0] == pytest.approx(1 / 60)
    assert ratio("rad/s", "deg/s")[0] == pytest.approx(180 / np.pi)
    assert ratio("rpm", "1/s")[0] == pytest.approx(1 / 60)


def test_temperatures_differ_by_an_offset_and_other_things_do_not_compare() -> None:
    assert ratio("degC", "K") == (1.0, 273.15)
    a, b = ratio("degF", "degC")
    assert 212 * a + b == pytest.approx(100.0)
    with pytest.raises(UnitError, match="unit of m, not of s"):
        ratio("mm", "min")
