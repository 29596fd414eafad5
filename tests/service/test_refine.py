"""`bladetwin model refine`: runs of any source, weighed by a rotor, until an accuracy."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from typer.testing import CliRunner

from core.archive import Archive, Input, Mesh
from core.blade import BOUNDS, build_mesh, simulate
from core.builtin import plans, rotor_blade
from core.builtin.paper_network import rotor_blade_network
from core.errors import FaultsError, InputError, ModelError
from core.posterior_region import of_prior
from core.surrogate.rounds import LOG, read_log
from service import refining
from service.cli import app
from service.command_runs import Command
from service.commands.refine import _regions, goals_of
from tests.exchanger import BOTH, NETWORK, TIME_H, drop, network, readings
from tests.patience import PATIENCE_S
from tests.service.test_sampling import HOURS, serving

PROGRAM = """
import json, math, sys
asked = json.load(open(sys.argv[-2]))
r, b = asked["inputs"]["roughness"], asked["inputs"]["fouling_rate"]
if len(sys.argv) > 3 and r > float(sys.argv[1]):
    sys.exit("no convergence")
layer = [-math.expm1(-b * t) for t in asked["time_h"]]
made = {"drop": [20 * (1 + 0.05 * r) * ((1 - 0.35 * s) ** -5 - 1) for s in layer]}
json.dump(made, open(sys.argv[-1], "w"))
"""
TRUTH = {"E1": np.array([2.6, 8.3e-5]), "E2": np.array([6.2, 8.3e-5])}


def run(*words: str | Path) -> Any:
    return CliRunner().invoke(app, ["model", "refine", *map(str, words)])


@pytest.fixture
def own(tmp_path: Path) -> Path:
    (tmp_path / "net.yaml").write_text(NETWORK)
    (tmp_path / "run.py").write_text(PROGRAM)
    lines = ["id,blade,quantity,time_h,value,unit"]
    for one in readings(TRUTH, (500.0, 2000.0, 5000.0, 9000.0), 0.1, 5):
        lines.append(",".join(str(one[k]) for k in lines[0].split(",")))
    (tmp_path / "readings.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def words(own: Path, *more: str) -> list[str]:
    command = f"{sys.executable} {own / 'run.py'}"
    found = ["--network", str(own / "net.yaml"), "--times", HOURS, "--start", "9", "--batch", "3"]
    return [*found, "--command", " ".join([command, *more]), "--workers", "1"]


def test_a_command_is_run_where_readings_say_until_the_accuracy_is_reached(own: Path) -> None:
    csv = ["--readings", str(own / "readings.csv"), "--accuracy", "drop=0.0008", "--most", "30"]
    done = run(own / "runs", *words(own), *csv)
    assert done.exit_code == 0, done.output
    rounds = read_log(own / "runs")
    last = rounds[-1]
    assert f"accuracy reached after {last.runs} runs: drop 0." in done.stdout
    assert last.region == "posterior of 2 blades, 8 readings"
    assert done.stderr.count("posterior of 2 blades") == len(rounds) - 1, "a line a round"
    archive = Archive.open(own / "runs")
    x = archive.inputs()
    for k in archive.done():
        np.testing.assert_allclose(archive.stack("drop", [k])[0], drop(x[k], TIME_H), rtol=1e-12)
    new = x[9:]
    assert len(new) >= 3
    assert np.median(np.abs(new[:, 1] - 8.3e-5)) < np.median(np.abs(x[:9, 1] - 8.3e-5))
    again = run(own / "runs", *words(own), *csv, "--json")
    told = json.loads(again.stdout)
    assert again.exit_code == 0
    assert told["runs"] == last.runs, "the same command makes no further run"
    assert told["reached"] is True
    assert [one["runs"] for one in told["rounds"]] == [one.runs for one in rounds]


def test_a_served_model_goes_on_and_falls_short_by_a_number(own: Path, tmp_path: Path) -> None:
    (own / "both.yaml").write_text(BOTH)
    asked = ["--network", str(own / "both.yaml"), "--times", HOURS, "--accuracy", "1e-6"]
    asked += ["--batch", "2", "--start", "9"]
    with serving(99.0, tmp_path / "log") as url:
        done = run(own / "runs", *asked, "--served", url, "--most", "11")
        more = run(own / "runs", *asked, "--served", url, "--most", "13", "--json")
    assert done.exit_code == more.exit_code == 1
    assert "fell short by a factor of " in done.stdout
    told = json.loads(more.stdout)
    assert told["runs"] == 13
    assert {one["quantity"] for one in told["rounds"][-1]["accuracy"]} == {"drop", "transfer"}
    assert (tmp_path / "log").read_text().count("[") == 13, "no run is made twice"


@pytest.mark.parametrize(
    ("hours", "said"),
    [
        ("0", "hours = 0.0 is where runs begin"),
        ("0,0.0", "is where runs begin"),
        ("-1", "lies outside 0 … 16000 h"),
        ("nan", "lies outside"),
        ("16001", "lies outside"),
    ],
)
def test_hours_at_which_nothing_can_be_told_are_refused_before_a_run(
    own: Path, hours: str, said: str
) -> None:
    """At hour 0 alone the accuracy was reached at once, 0 %, whatever the runs were."""
    done = run(own / "runs", *words(own), "--accuracy", "0.01", "--most", "9", "--hours", hours)
    assert isinstance(done.exception, InputError)
    assert said in str(done.exception)
    assert len(Archive.open(own / "runs").done()) == 0
    beside = run(own / "runs", *words(own), "--accuracy", "0.5", "--most", "9", "--hours", "0,500")
    assert "accuracy reached after 9 runs" in beside.stdout


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        (
            "low: 0.05, high: 2}",
            "low: 0.05, high: 2.0e200}",
            "sigma_obs of drop = 2e+200 is beyond",
        ),
        (
            "low: 1, high: 9",
            "low: 1.0e-198, high: 9.0e-198",
            "prior of roughness = 9e-198 is below",
        ),
    ],
)
def test_numbers_of_no_usable_size_are_refused_before_a_run(
    own: Path, was: str, now: str, said: str
) -> None:
    (own / "net.yaml").write_text(NETWORK.replace(was, now))
    done = run(own / "runs", *words(own), "--accuracy", "0.01", "--most", "9")
    assert done.exit_code == 1
    assert said in done.output
    assert not (own / "runs").exists()


@pytest.mark.parametrize("begun", [False, True])
def test_a_discrepancy_that_cannot_be_calibrated_is_refused_before_a_run(
    own: Path, begun: bool
) -> None:
    """Nine runs or more were made before training told it."""
    if begun:
        run(own / "runs", *words(own), "--accuracy", "0.5", "--most", "9", "--hours", "500")
    gp = "high: 2}, discrepancy: {kind: gp, length_h: 10}}"
    (own / "net.yaml").write_text(NETWORK.replace("high: 2}}", gp))
    asked = run(own / "runs", *words(own), "--accuracy", "1e-9", "--most", "12")
    said = "discrepancy length_h of drop = 10.0 needs 96 modes up to 16000 h, more than 6"
    assert asked.exit_code == 1
    assert said in asked.output
    if begun:
        assert len(Archive.open(own / "runs").done()) == 9
    else:
        assert not (own / "runs").exists()


def test_runs_that_fail_are_told_and_tried_again(own: Path) -> None:
    asked = ["--accuracy", "1e-6", "--most", "13"]
    few = run(own / "few", *words(own, "8.2"), *asked)
    said = "8 runs are there, and 9 are needed for 2 inputs; run [0-9] failed: .* no convergence"
    assert re.search(said, str(few.exception))
    asked += ["--start", "12"]
    done = run(own / "runs", *words(own, "8.2"), *asked, "--json")
    failed = json.loads(done.stdout)["failed"]
    assert done.exit_code == 1
    assert failed
    assert all("ended with 1: no convergence" in one["error"] for one in failed)
    again = json.loads(run(own / "runs", *words(own), *asked, "--json").stdout)
    assert again["failed"] == []
    assert again["runs"] == 13


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("pass", "wrote neither out.json nor out.npz"),
        ("open(sys.argv[2], 'w').write('{')", "cannot be read"),
        ("open(sys.argv[2], 'w').write('{\"lift\": [1]}')", "wrote no drop"),
        ("open(sys.argv[2], 'w').write('{\"drop\": [1, 2]}')", "is the wrong shape"),
        ("open(sys.argv[2][:-5] + '.npz', 'w')", "cannot be read"),
        ("open(sys.argv[2][:-5] + '.npz', 'w').write('PK\\3\\4 cut short')", "cannot be read"),
        ("open(sys.argv[2], 'w').write('{\"drop\": [1' + '0' * 400 + ']}')", "cannot be read"),
        ("import time; time.sleep(3600)", "took longer than 2 s"),
    ],
)
def test_what_a_command_does_wrong_is_the_reason_of_its_run(
    own: Path, program: str, said: str
) -> None:
    (own / "bad.py").write_text(f"import sys\n{program}\n")
    text = f"{sys.executable} {own / 'bad.py'}"
    limit_s = 2.0 if "2 s" in said else PATIENCE_S
    source = Command.of(text, network(), time_h=tuple(TIME_H), timeout=limit_s)
    archive = source.open(own / "runs", 0)
    failed = source.run(archive, {4: np.array([2.0, 5e-5])}, lambda done: None)
    assert said in failed[4]
    assert archive.done() == ()


def test_a_command_may_write_numpy_arrays(own: Path) -> None:
    (own / "npz.py").write_text(
        "import sys, numpy as np\nnp.savez(sys.argv[2][:-5] + '.npz', drop=np.arange(9.0))\n"
    )
    text = f"{sys.executable} {own / 'npz.py'}"
    source = Command.of(text, network(), time_h=tuple(TIME_H))
    archive = source.open(own / "runs", 0)
    assert source.run(archive, {4: np.array([2.0, 5e-5])}, lambda done: None) == {}
    np.testing.assert_array_equal(archive.stack("drop", [4])[0], np.arange(9.0))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--served", "http://127.0.0.1:9"], "stands beside --served"),
        (["--accuracy", "lift=0.1"], "use drop"),
        (["--accuracy", "much"], "is no relative sd"),
        (["--accuracy", "0"], "is not positive"),
        (["--hours", "late"], "are no hours"),
        (["--hours", "500,99999"], "hours = 99999.0 lies outside 0 … 16000 h"),
        (["--start", "3"], "start with 9 or more"),
        (["--batch", "0"], "batch = 0"),
        (["--elsewhere", "2"], "is no share"),
    ],
)
def test_what_cannot_be_refined_is_refused_before_a_run(
    own: Path, more: list[str], said: str
) -> None:
    done = run(own / "runs", *words(own), *more)
    assert done.exit_code == 1
    assert said in f"{done.output}{done.exception}"
    assert not list((own / "runs").glob("run-*"))


def test_a_source_without_its_network_and_an_archive_of_another_are_refused(own: Path) -> None:
    assert "has no source of runs" in str(run(own / "a", "--network", own / "net.yaml").exception)
    assert "network = None is missing" in str(run(own / "a", "--command", "true").exception)
    source = Command.of("true", network(), time_h=tuple(TIME_H))
    source.open(own / "a", 0)
    other = Command.of("true", network(BOTH), time_h=tuple(TIME_H))
    with pytest.raises(InputError, match=r"are not the network's .drop .*, transfer "):
        other.open(own / "a", 0)
    with pytest.raises(ModelError, match="other finite elements"):
        refining.FiniteElements().open(own / "a", 0)
    with pytest.raises(InputError, match="has no words"):
        Command.of("  ", network())


@pytest.mark.parametrize(
    ("text", "hours", "said"),
    [
        (NETWORK.replace("kPa", "Pa"), TIME_H, "are not the network's \\(drop \\[Pa\\]\\)"),
        (NETWORK.replace("high: 9}", "high: 12}"), TIME_H, "prior of roughness = '1 … 12' leaves"),
        (NETWORK, TIME_H[:-1], "times = '0, 250, .*' are not those of the runs"),
    ],
)
def test_runs_of_other_units_bounds_or_hours_are_not_gone_on_with(
    own: Path, text: str, hours: np.ndarray, said: str
) -> None:
    """They were taken as they are: readings in Pa met runs in kPa, and --times was passed over."""
    Command.of("true", network(), time_h=tuple(TIME_H)).open(own / "a", 0)
    Command.of("true", network()).open(own / "a", 0)
    Command.of("true", network(NETWORK.replace("high: 9}", "high: 8}"))).open(own / "a", 0)
    with pytest.raises(InputError, match=said):
        Command.of("true", network(text), time_h=tuple(hours)).open(own / "a", 0)


def test_readings_that_the_network_cannot_use_are_named_by_line(own: Path) -> None:
    archive = Command.of("true", network(), time_h=tuple(TIME_H)).open(own / "a", 0)
    head = b"id,blade,quantity,time_h,value,unit\n"
    with pytest.raises(FaultsError, match="line 2"):
        refining.readings_of(head + b"a,E1,lift,500,1.0,kPa\n", network(), archive)
    with pytest.raises(FaultsError, match="line 2"):
        refining.readings_of(head + b"a,E1,drop,99999,1.0,kPa\n", network(), archive)
    with pytest.raises(FaultsError, match="value"):
        refining.readings_of(b"id,blade\na,E1\n", network(), archive)
    (one,) = refining.readings_of(head + b"a,E1,drop,500,1.5,kPa\n", network(), archive)
    assert (one.blade, one.quantity, float(one.values[0])) == ("E1", "drop", 1.5)


def test_a_number_is_wanted_of_every_quantity_and_a_name_of_one() -> None:
    both = network(BOTH)
    assert [(g.quantity, g.wanted) for g in goals_of(["0.01"], (), both)] == [
        ("drop", 0.01),
        ("transfer", 0.01),
    ]
    (only,) = goals_of(["transfer=0.02"], (500.0,), both)
    assert (only.quantity, only.wanted, only.times_h) == ("transfer", 0.02, (500.0,))


def test_the_log_lies_beside_the_runs(own: Path) -> None:
    run(own / "runs", *words(own), "--accuracy", "0.5")
    assert json.loads((own / "runs" / LOG).read_text())["rounds"][0]["region"] == "maximin design"


def test_a_rotor_s_blades_and_readings_are_fetched_and_weigh_the_runs(
    api: httpx.Client, rotor: str, tmp_path: Path
) -> None:
    url, net = str(api.base_url), rotor_blade_network()
    one = {"quantity": "elongation", "time_h": 8000, "value": 0.101, "unit": "mm"}
    archive = coarse(tmp_path, (0.0, 1e3, 1e4, 5e4))
    _, words = _regions(net, archive, rotor, url, None, None, 0)
    assert words == ["warning: there is no reading: the whole prior counts"]
    told = {"inspections": [one | {"id": f"i{b}", "blade": b} for b in ("B1", "B2")]}
    assert api.post(f"/v1/rotors/{rotor}/inspections", json=told).status_code == 202
    regions, words = _regions(net, archive, rotor, url, None, None, 0)
    assert words == []
    region, said = regions(rotor_blade.load())
    assert said == "posterior of 3 blades, 2 readings", "one has none and is predicted as well"
    even = of_prior(net, list(BOUNDS))
    assert region.x.shape == (513, 4)
    spread = region.mean_and_sd()[1] / even.mean_and_sd()[1]
    assert spread[1] < 0.8, "the gas temperature is known better than before"
    low, high = np.array([*BOUNDS.values()]).T
    assert np.all((region.x >= low) & (region.x <= high))
    with pytest.raises(InputError, match="stands beside --rotor"):
        _regions(net, archive, rotor, url, None, tmp_path / "x.csv", 0)


def coarse(folder: Path, time_h: Sequence[float] = (0.0, 1.0, 5.0, 20.0)) -> Archive:
    """An archive of finite-element runs, short ones by default."""
    mesh = build_mesh("coarse")
    return Archive.create(
        folder / "blade",
        inputs=[Input(name, low, high) for name, (low, high) in BOUNDS.items()],
        time_h=time_h,
        mesh=Mesh("coarse", mesh.points, mesh.cells, mesh.parametric, mesh.named),
        seed=0,
        command=plans.STANDARD.command,
        code=rotor_blade.blade_digest(),
    )


def test_finite_elements_go_on_in_their_own_archive(tmp_path: Path) -> None:
    coarse(tmp_path)
    source = refining.FiniteElements(workers=1)
    archive = source.open(tmp_path / "blade", 0)
    assert refining.network_of(archive).name == "rotor-blade"
    told: list[int] = []
    x = np.array([1.1, 0.97, 0.5, 1.5])
    assert source.run(archive, {7: x}, told.append) == {}
    assert told == [1]
    point = dict(zip(BOUNDS, x.tolist(), strict=True))
    direct = simulate(point, "coarse", time_h=archive.declaration.time_h)
    np.testing.assert_allclose(archive.read(7).values["elongation"], direct.elongation)
    assert archive.done() == (7,)
