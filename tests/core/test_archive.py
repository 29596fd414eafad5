from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from core.archive import Archive, Declaration, Input, Mesh, Quantity, Run, disk
from core.errors import InputError, ModelError, RangeError

TIME_H = (0.0, 10.0, 100.0, 1000.0, 8000.0)
INPUTS = (Input("tbc_thickness", 0.5, 1.5), Input("t1t_rate", 0.8, 1.0))
MESH = Mesh(
    "cube",
    np.arange(24.0).reshape(8, 3),
    np.arange(8)[None],
    np.linspace(0, 1, 24).reshape(8, 3),
    {"tip": 7, "critical": 2},
)


def new(path: Path) -> Archive:
    return Archive.create(
        path, inputs=INPUTS, time_h=TIME_H, mesh=MESH, seed=3, command="make them"
    )


def run(k: int) -> Run:
    rng = np.random.default_rng(k)
    fields = {name: rng.random((5, 8)) for name in ("ceeq", "creep_damage", "mises")}
    return Run(
        {"tbc_thickness": 0.7 + 0.1 * k, "t1t_rate": 0.9},
        {**fields, "displacement": rng.random((5, 8, 3)), "elongation": rng.random(5)},
    )


def spoiled(quantity: str, where: tuple[int, ...], value: float) -> Run:
    good = run(0)
    values = {name: array.copy() for name, array in good.values.items()}
    values[quantity][where] = value
    return Run(good.inputs, values)


def test_a_run_comes_back_fields_in_single_and_curves_in_double_precision(tmp_path: Path) -> None:
    archive = new(tmp_path / "a")
    archive.write(4, run(4))
    back = Archive.open(tmp_path / "a").read(4)
    assert back.inputs == run(4).inputs
    np.testing.assert_array_equal(back.values["elongation"], run(4).values["elongation"])
    for name in ("ceeq", "creep_damage", "mises", "displacement"):
        assert back.values[name].dtype == np.float32
        np.testing.assert_array_equal(back.values[name], run(4).values[name].astype("f4"))


def test_mesh_and_declaration_come_back(tmp_path: Path) -> None:
    new(tmp_path / "a")
    back = Archive.open(tmp_path / "a")
    mesh = back.mesh()
    np.testing.assert_array_equal(mesh.points, MESH.points)
    np.testing.assert_array_equal(mesh.cells, MESH.cells)
    np.testing.assert_array_equal(mesh.parametric, MESH.parametric)
    assert back.declaration.named == {"tip": 7, "critical": 2}
    assert back.declaration.time_h == TIME_H
    assert (back.declaration.seed, back.declaration.command) == (3, "make them")


def test_inputs_and_stacks_follow_the_indices_asked_for(tmp_path: Path) -> None:
    archive = new(tmp_path / "a")
    for k in (5, 0, 2):
        archive.write(k, run(k))
    assert archive.done() == (0, 2, 5)
    np.testing.assert_allclose(archive.inputs()[:, 0], [0.7, 0.9, 1.2])
    np.testing.assert_allclose(archive.inputs([5, 0])[:, 0], [1.2, 0.7])
    np.testing.assert_array_equal(
        archive.stack("mises", [2, 0])[1], run(0).values["mises"].astype("f4")
    )
    assert [index for index, _ in archive.runs()] == [0, 2, 5]


def test_a_file_cut_in_the_middle_does_not_count_as_done(tmp_path: Path) -> None:
    archive = new(tmp_path / "a")
    for k in range(3):
        archive.write(k, run(k))
    whole = archive.file(1).read_bytes()
    archive.file(1).write_bytes(whole[: len(whole) // 2])
    assert archive.done() == (0, 2)
    with pytest.raises(ModelError, match="run-0001"):
        archive.read(1)


def test_a_file_with_a_damaged_byte_is_told_in_words_and_not_done(tmp_path: Path) -> None:
    """HDF5 raises KeyError over some bytes, OSError over others, and does not mind the rest."""
    archive = new(tmp_path / "a")
    archive.write(0, run(0))
    archive.write(1, run(1))
    raw = archive.file(1).read_bytes()
    gone = 0
    for place in range(400):
        spoilt = bytearray(raw)
        spoilt[place] ^= 1
        archive.file(1).write_bytes(spoilt)
        done = archive.done()
        assert done in ((0,), (0, 1)), place
        if done == (0,):
            gone += 1
            with pytest.raises(ModelError, match="cannot be read as netCDF"):
                archive.read(1)
    assert gone > 40


def test_runs_are_told_in_the_order_of_their_numbers_beyond_ten_thousand(tmp_path: Path) -> None:
    archive = new(tmp_path / "a")
    for index in (10_000, 9_999, 2):
        archive.write(index, run(1))
    assert archive.done() == (2, 9_999, 10_000)
    assert [index for index, _ in archive.runs()] == [2, 9_999, 10_000]


def test_a_process_killed_while_writing_leaves_the_runs_before_and_nothing_half(
    tmp_path: Path,
) -> None:
    archive = new(tmp_path / "a")
    archive.write(0, run(0))
    child = (
        "import os, sys, numpy as np\n"
        "import core.archive as a\n"
        "archive = a.Archive.open(sys.argv[1]); good = archive.read(0)\n"
        "os.replace = lambda *names: os._exit(9)\n"
        "archive.write(1, good)\n"
    )
    killed = subprocess.run([sys.executable, "-c", child, str(archive.path)], check=False)
    assert killed.returncode == 9
    assert archive.done() == (0,)
    archive.write(1, run(1))
    assert archive.done() == (0, 1)


def test_create_goes_on_with_the_same_archive_and_refuses_another(tmp_path: Path) -> None:
    new(tmp_path / "a").write(0, run(0))
    assert new(tmp_path / "a").done() == (0,)
    with pytest.raises(ModelError, match=r"another archive \(seed, code\)"):
        Archive.create(
            tmp_path / "a",
            inputs=INPUTS,
            time_h=TIME_H,
            mesh=MESH,
            seed=4,
            command="make them",
            code="b2",
        )


def test_of_two_that_start_different_archives_in_one_place_the_first_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other one comes between the look and the write; its mesh stays, too."""
    real, path = disk.link_file, tmp_path / "a"
    other = replace(MESH, points=MESH.points + 1.0, name="another")

    def late(part: Path, file: Path) -> bool:
        monkeypatch.undo()
        Archive.create(path, inputs=INPUTS, time_h=TIME_H, mesh=other, seed=4, command="make them")
        return real(part, file)

    monkeypatch.setattr(disk, "link_file", late)
    with pytest.raises(ModelError, match=r"another archive \(mesh, seed\)"):
        new(path)
    assert Archive.open(path).declaration.seed == 4
    np.testing.assert_array_equal(Archive.open(path).mesh().points, other.points)
    assert sorted(file.name for file in path.iterdir()) == ["archive.json", "mesh.nc"]


def test_a_start_that_was_killed_before_its_mesh_is_gone_on_with(tmp_path: Path) -> None:
    new(tmp_path / "a")
    (tmp_path / "a" / "mesh.nc").unlink()
    np.testing.assert_array_equal(new(tmp_path / "a").mesh().points, MESH.points)


def test_one_worker_needs_no_hard_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", none)
    archive = new(tmp_path / "a")
    archive.write(0, run(0))
    assert Archive.open(tmp_path / "a").done() == (0,)


def test_one_file_carries_the_whole_archive(tmp_path: Path) -> None:
    archive = new(tmp_path / "a")
    for k in (1, 3):
        archive.write(k, run(k))
    archive.to_netcdf(tmp_path / "all.nc")
    back = Archive.from_netcdf(tmp_path / "all.nc", tmp_path / "b")
    assert back.declaration == archive.declaration
    assert back.done() == (1, 3)
    np.testing.assert_array_equal(back.mesh().cells, MESH.cells)
    for name, values in archive.read(3).values.items():
        np.testing.assert_array_equal(back.read(3).values[name], values)


def test_xarray_reads_both_files_with_names_and_units(tmp_path: Path) -> None:
    archive = new(tmp_path / "a")
    archive.write(1, run(1))
    archive.to_netcdf(tmp_path / "all.nc")
    with xr.open_dataset(archive.file(1), engine="h5netcdf") as data:
        assert data["displacement"].dims == ("time", "node", "xyz")
        assert data["mises"].attrs["units"] == "MPa"
    with xr.open_dataset(tmp_path / "all.nc", engine="h5netcdf") as data:
        assert data["ceeq"].dims == ("run", "time", "node")
        assert data["ceeq"].sizes == {"run": 1, "time": 5, "node": 8}


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (spoiled("ceeq", (3, 6), np.nan), ["run 7", "ceeq", "1000 h", "node 6"]),
        (spoiled("elongation", (2,), np.inf), ["run 7", "elongation", "100 h"]),
        (spoiled("displacement", (4, 5, 1), np.nan), ["run 7", "displacement", "8000 h", "node 5"]),
        (Run(run(0).inputs, {**run(0).values, "mises": np.ones((5, 9))}), ["mises", "(5, 8)"]),
        (Run({"tbc_thickness": 1.0}, run(0).values), ["run 7", "t1t_rate", "missing"]),
        (Run(run(0).inputs, {"ceeq": np.ones((5, 8))}), ["mises", "missing"]),
    ],
)
def test_a_broken_run_is_refused_naming_run_quantity_instant_and_node(
    tmp_path: Path, broken: Run, words: list[str]
) -> None:
    archive = new(tmp_path / "a")
    with pytest.raises(InputError) as caught:
        archive.write(7, broken)
    for word in words:
        assert word in str(caught.value)
    assert archive.done() == ()


def test_an_input_outside_its_bounds_is_refused_with_the_bounds(tmp_path: Path) -> None:
    outside = Run({"tbc_thickness": 1.0, "t1t_rate": 1.01}, run(0).values)
    with pytest.raises(RangeError, match=r"t1t_rate = 1\.01 lies outside 0\.8 … 1\.0"):
        new(tmp_path / "a").write(0, outside)
    nan = Run({"tbc_thickness": 1.0, "t1t_rate": float("nan")}, run(0).values)
    with pytest.raises(RangeError, match="t1t_rate = nan"):
        new(tmp_path / "b").write(0, nan)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"time_h": (0.0, 10.0, 10.0, 20.0)}, r"time_h\[2\] = 10.0 does not increase"),
        ({"time_h": (1.0, 10.0, 20.0, 30.0)}, "does not start at 0"),
        ({"time_h": (0.0, 1.0, float("nan"), 3.0)}, "does not increase"),
        ({"inputs": (Input("a", 2.0, 1.0),)}, "is not an interval"),
        ({"inputs": (Input("ceeq", 0.0, 1.0),)}, "has a name twice"),
        ({"named": {"tip": 8}}, r"named node tip = 8 is not in 0 … 7"),
        ({"quantities": (Quantity("q", "1", "tensor"),)}, "unknown kind"),  # type: ignore[arg-type]
    ],
)
def test_a_declaration_that_cannot_hold_runs_is_refused(
    tmp_path: Path, change: dict[str, object], problem: str
) -> None:
    good = new(tmp_path / "a").declaration
    with pytest.raises(InputError, match=problem):
        replace(good, **change)  # type: ignore[arg-type]


def test_a_declaration_of_another_schema_or_without_a_key_is_refused(tmp_path: Path) -> None:
    raw = json.loads(new(tmp_path / "a").declaration.to_json())
    with pytest.raises(ModelError, match="schema 99"):
        Declaration.from_json(json.dumps(raw | {"schema": 99}))
    del raw["mesh"]
    with pytest.raises(ModelError, match="mesh"):
        Declaration.from_json(json.dumps(raw))


def test_a_file_that_is_no_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.nc").write_bytes(b"not a netCDF file")
    with pytest.raises(ModelError, match=r"x\.nc"):
        Archive.from_netcdf(tmp_path / "x.nc", tmp_path / "b")
    xr.Dataset({"a": ("n", [1.0])}).to_netcdf(tmp_path / "y.nc", engine="h5netcdf")
    with pytest.raises(ModelError, match="no packed archive"):
        Archive.from_netcdf(tmp_path / "y.nc", tmp_path / "b")
    with pytest.raises(ModelError, match=r"archive\.json"):
        Archive.open(tmp_path)


def test_a_packed_archive_with_a_spoiled_value_is_refused_on_unpacking(tmp_path: Path) -> None:
    archive = new(tmp_path / "a")
    archive.write(1, run(1))
    archive.to_netcdf(tmp_path / "all.nc")
    with xr.open_dataset(tmp_path / "all.nc", engine="h5netcdf") as data:
        loaded = data.load()
    loaded["ceeq"][0, 2, 3] = np.nan
    loaded.to_netcdf(tmp_path / "bad.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=r"run 1: ceeq = nan is not finite at 100 h, node 3"):
        Archive.from_netcdf(tmp_path / "bad.nc", tmp_path / "b")
