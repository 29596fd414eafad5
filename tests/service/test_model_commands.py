"""The commands of a user's own runs: table → archive → model → database → rotor."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

from service.bootstrap import make_science, make_store, make_worker, prepare
from service.cli import app
from service.handlers.inspections import Item, post_inspections
from service.handlers.rotors import create_rotor, view_rotor
from service.ports import BladeRecord
from service.settings import Settings
from tests.core.test_converters import meshes
from tests.exchanger import BOTH, NETWORK, dataset, points, stored, write_table


def run(*words: object, **environ: str) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words], env=environ)


def test_a_table_is_converted_checked_trained_and_registered_and_a_rotor_lives_on_it(
    tmp_path: Path,
) -> None:
    write_table(tmp_path / "runs.csv", points())
    (tmp_path / "net.yaml").write_text(NETWORK)
    runs, net, model = tmp_path / "runs.nc", tmp_path / "net.yaml", tmp_path / "model"
    done = run("model", "convert", tmp_path / "runs.csv", "--out", runs)
    assert done.exit_code == 0, done.output
    assert "24 runs; inputs roughness, fouling_rate; quantities drop" in done.stdout
    assert "24 runs can be trained on" in run("model", "check", runs, "--network", net).stdout
    done = run("model", "train", runs, "--network", net, "--out", model, "--json")
    told = json.loads(done.stdout)
    assert told["quality"]["drop"]["verdict"] == "good"
    assert "is not empty" in str(
        run("model", "train", runs, "--network", net, "--out", model).exception
    )

    settings = Settings(database_url=f"sqlite:///{tmp_path / 'twin.db'}")
    environ = {"BLADETWIN_DATABASE_URL": settings.database_url}
    done = run("model", "register", model, "exchanger", **environ)
    assert done.exit_code == 0, done.output
    assert told["version"] in done.stdout
    store = make_store(settings)
    prepare(store, settings)
    science = make_science(settings, store)
    create_rotor(store, "station", "exchanger", [BladeRecord("E1")], 256, 1)
    from core.observation import Inspection

    reading = Inspection("a", "E1", "drop", 5000.0, np.array([9.0]))
    post_inspections(store, "station", [Item("", reading)])
    make_worker(store, science, settings).drain()
    assert view_rotor(store, "station").rotor.applied_seq == 1
    store.close()
    refused = run("model", "register", model, "rotor-blade", **environ)
    assert "built-in" in str(refused.exception)
    verified = run("verify", **environ)
    assert verified.exit_code == 0, verified.output


def test_faults_stand_line_by_line_on_stderr_or_in_one_object(tmp_path: Path) -> None:
    data = dataset()
    data["drop"][7, 3] = np.nan
    data["transfer"].attrs["units"] = "mm"
    runs, net = stored(data, tmp_path / "runs.nc"), tmp_path / "net.yaml"
    net.write_text(BOTH)
    done = run("model", "check", runs, "--network", net)
    assert done.exit_code == 1
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert [line.split(" = ")[0] for line in lines[:-1]] == [
        "fault: units of quantity transfer", "fault: run 7: drop"
    ]  # fmt: skip
    assert lines[-1] == "bladetwin: refused for 2 faults"
    told = json.loads(run("model", "check", runs, "--network", net, "--json").stdout)
    assert [one["field"] for one in told["faults"]] == ["units of quantity transfer", "run 7: drop"]
    assert not (tmp_path / "model").exists()
    left = run("model", "check", runs, "--network", net, "--leave-out", "7", "--json")
    assert [one["field"] for one in json.loads(left.stdout)["faults"]] == [
        "units of quantity transfer"
    ]
    net.write_text(NETWORK)
    left = run("model", "check", runs, "--network", net, "--leave-out", "7")
    assert left.exit_code == 0
    assert "warning: runs = '7' is left out, as asked" in left.stderr


def test_a_training_that_is_refused_leaves_its_folder_as_it_was(tmp_path: Path) -> None:
    """The same command with --leave-out found the folder not empty."""
    write_table(tmp_path / "runs.csv", points(), {(3, 4): "", (5, 2): "9000"})
    (tmp_path / "net.yaml").write_text(NETWORK)
    runs, net, model = tmp_path / "runs.nc", tmp_path / "net.yaml", tmp_path / "model"
    run("model", "convert", tmp_path / "runs.csv", "--out", runs)
    train = ["model", "train", runs, "--network", net, "--out", model]
    done = run(*train)
    assert done.exit_code == 1
    assert "run 3: drop" in done.stderr
    assert not model.exists()
    model.mkdir()
    assert run(*train, "--leave-out", "3").exit_code == 1, "run 5 spoils what is learnt"
    assert list(model.iterdir()) == []
    done = run(*train, "--leave-out", "3", "--leave-out", "5")
    assert done.exit_code == 0, done.output
    (tmp_path / "file").write_text("")
    done = run(*train[:-1], tmp_path / "file")
    assert "is no folder" in str(done.exception)


def test_a_table_of_mesh_files_is_converted_with_the_fields_that_are_named(tmp_path: Path) -> None:
    table = meshes(tmp_path)
    done = run(
        "model", "convert", table, "--out", tmp_path / "runs.nc",
        "--field", "temperature [K]", "--node", "end=19",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "quantities reaction, temperature" in done.stdout
    odd = run("model", "convert", table, "--out", tmp_path / "n.nc", "--field", "temperature")
    assert "has no unit" in str(odd.exception)
