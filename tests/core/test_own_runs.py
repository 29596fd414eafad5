"""What is wrong with a user's runs: refused, or trained with a warning, and always named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from core.archive import Archive
from core.archive.faults import Findings, RunsError
from core.archive.opening import check_file, opened
from core.archive.take import take
from core.errors import InputError, ModelError
from core.model import Model
from core.network import Network
from core.surrogate.artefact import load
from core.surrogate.own import make
from tests import exchanger
from tests.exchanger import BOTH, NETWORK, TIME_H, dataset, drop, network, points, stored

Spoil = Callable[[xr.Dataset], xr.Dataset | None]


def taken(
    data: xr.Dataset, folder: Path, declared: Network | None = None, **options: list[str]
) -> tuple[Archive, Findings, tuple[int, ...]]:
    file = stored(data, folder / "runs.nc")
    with opened(file) as source:
        return take(source, declared or network(), folder / "taken", **options)


def refused(data: xr.Dataset, folder: Path, declared: Network | None = None) -> list[InputError]:
    with pytest.raises(RunsError) as caught:
        taken(data, folder, declared)
    return list(caught.value.faults)


def warned(found: Findings, what: str) -> InputError:
    (one,) = [one for one in found.warnings if one.what == what]
    return one


def test_sound_runs_are_taken_without_a_word_but_for_what_the_network_lacks(
    tmp_path: Path,
) -> None:
    archive, found, chosen = taken(dataset(), tmp_path)
    assert chosen == tuple(range(24))
    assert [one.what for one in found.warnings] == ["quantity transfer"]
    declared = archive.declaration
    assert [(i.name, i.low, i.high) for i in declared.inputs] == [
        ("roughness", 1.0, 9.0),
        ("fouling_rate", 2e-5, 2e-4),
    ]
    assert declared.time_h == tuple(TIME_H)
    np.testing.assert_array_equal(archive.read(5).values["drop"], drop(points()[5], TIME_H))


def test_a_missing_run_is_named_and_left_out_by_its_label_or_by_its_emptiness(
    tmp_path: Path,
) -> None:
    _, found, chosen = taken(dataset().isel(run=[*range(9), *range(10, 24)]), tmp_path)
    assert warned(found, "run").value == "9"
    assert len(chosen) == 23
    empty = dataset()
    empty["drop"][7] = np.nan
    empty["transfer"][7] = np.nan
    (tmp_path / "b").mkdir()
    _, found, chosen = taken(empty, tmp_path / "b")
    assert "missing" in warned(found, "run 7").problem
    assert 7 not in chosen
    assert len(chosen) == 23
    (tmp_path / "c").mkdir()
    reindexed = dataset().isel(run=[*range(7), *range(8, 24)]).reindex(run=range(24))
    _, found, chosen = taken(reindexed, tmp_path / "c")
    assert "missing" in warned(found, "run 7").problem
    assert 7 not in chosen
    assert len(chosen) == 23


def test_every_nan_is_told_with_run_quantity_and_hour_and_the_run_can_be_left_out(
    tmp_path: Path,
) -> None:
    data = dataset()
    data["drop"][3, 4] = np.nan
    data["transfer"][3, 6:] = np.nan
    data["drop"][11, 8] = np.inf
    faults = refused(data, tmp_path, network(BOTH))
    assert [one.what for one in faults] == ["run 3: drop", "run 3: transfer", "run 11: drop"]
    assert "at 2000 h" in faults[0].problem
    assert "at 8000 h; 3 values" in faults[1].problem
    (tmp_path / "b").mkdir()
    _, found, chosen = taken(data, tmp_path / "b", network(BOTH), leave_out=["3", "11"])
    assert len(chosen) == 22
    assert warned(found, "runs").value == "3, 11"
    (tmp_path / "c").mkdir()
    with pytest.raises(RunsError, match="leave_out = '99' is no run"):
        taken(data, tmp_path / "c", leave_out=["99"])


FIELD = """
name: plate
parameters:
  - {name: load, level: local, unit: kN, prior: {kind: uniform, low: 1, high: 5}}
quantities:
  - {name: warmth, unit: K, kind: field, low: 0, high: 2000, node: hot,
     sigma_obs: {kind: log_uniform, low: 0.1, high: 5}}
  - {name: deformation, unit: mm, kind: vector, low: -50, high: 50,
     sigma_obs: {kind: log_uniform, low: 0.001, high: 0.2}}
"""


def plate(count: int = 12) -> xr.Dataset:
    """A field and a vector at 10 nodes of a plate under a load, quadratic in both."""
    load, node = np.linspace(1, 5, count), np.arange(10.0)
    time = np.array([0.0, 10, 40, 90, 160])
    growth = np.sqrt(time)[None, :, None]
    warmth = 300 + 2 * load[:, None, None] * growth * (1 + 0.1 * node)
    moved = 0.01 * (load[:, None, None] ** 2 + growth * load[:, None, None]) * node
    vector = np.stack([0.1 * moved, -0.3 * moved, moved], axis=-1)
    return xr.Dataset(
        {
            "load": ("run", 1000 * load, {"units": "N", "low": 1000.0, "high": 5000.0}),
            "warmth": (("run", "time", "node"), warmth, {"units": "K"}),
            "displacement": (("node", "run", "xyz", "time"), vector.transpose(2, 0, 3, 1) / 1000,
                             {"units": "m"}),
            "points": (("node", "xyz"), np.outer(node, [0.01, 0, 0]), {"units": "m"}),
        },
        coords={"time": ("time", 3600 * time, {"units": "s"})},
        attrs={"named_nodes": '{"hot": 9}', "title": "a plate"},
    )  # fmt: skip


def test_nan_at_one_node_names_the_node(tmp_path: Path) -> None:
    data = plate()
    data["warmth"][4, 2, 6] = np.nan
    data["displacement"][8, 5, 1, 3] = np.nan
    faults = refused(data, tmp_path, network(FIELD))
    assert [one.what for one in faults] == ["run 4: warmth", "run 5: displacement"]
    assert "at 40 h, node 6" in faults[0].problem
    assert "at 90 h, node 8" in faults[1].problem


def test_fields_and_vectors_of_no_creeping_body_are_learnt_and_read(tmp_path: Path) -> None:
    with opened(stored(plate(), tmp_path / "runs.nc")) as source:
        surrogate, found = make(source, network(FIELD), tmp_path / "model")
    assert {one.what for one in found.warnings} == {
        "units of input load", "units of quantity deformation", "node of deformation"
    }  # fmt: skip
    assert "tip is not among" in warned(found, "node of deformation").problem
    np.testing.assert_allclose(surrogate.points[3], [30.0, 0, 0])
    model = Model.of(network(FIELD), surrogate)
    x, times = np.array([[2.3]]), np.array([25.0, 130.0])
    mean, sd = surrogate.predict(x, "warmth", times, [9])
    true = 300 + 2 * 2.3 * np.sqrt(times) * 1.9
    assert np.all(np.abs(mean[0, :, 0] - true) < 0.3)
    rows = surrogate.deformation_modes([4, 7])
    response = surrogate.mode_response(90.0, np.eye(rows.shape[2]))
    modes, _ = response.evaluate(x)
    seen = np.einsum("nxb,b->nx", rows, modes[0])
    grown = 0.01 * np.sqrt(90.0) * 2.3 * np.array([4.0, 7.0])
    np.testing.assert_allclose(seen[:, 2], grown, rtol=2e-3)
    moved, _ = surrogate.predict(x, "deformation", np.array([90.0]), [4, 7])
    np.testing.assert_allclose(moved[0, 0], seen, rtol=1e-3, atol=1e-6)
    assert model.surrogate.named == {"hot": 9}
    assert sd.shape == (1, 2, 1)


def test_a_users_cells_stay_with_the_model(tmp_path: Path) -> None:
    """They were read and thrown away, and fields of such a model were refused as VTU."""
    lines = np.array([[k, k + 1] for k in range(9)])
    drawn = plate().assign(cells=(("cell", "corner"), lines))
    made = {}
    for name, data in {"bare": plate(), "drawn": drawn}.items():
        with opened(stored(data, tmp_path / f"{name}.nc")) as source:
            made[name], _ = make(source, network(FIELD), tmp_path / name)
    read = load(tmp_path / "drawn")
    assert read.cells is not None
    assert read.cells[0] == "line"
    assert read.cells[1].tolist() == lines.tolist()
    assert read.digest == made["drawn"].digest != made["bare"].digest
    assert load(tmp_path / "bare").cells is None, "and a model without is what it was"
    told = drawn.assign(cells=(("cell", "corner"), lines, {"kind": "triangle"}))
    (fault,) = refused(told, tmp_path, network(FIELD))
    assert fault.what == "kind of cells"
    said = drawn.assign(cells=(("cell", "corner"), lines, {"kind": "line"}))
    taken(said, tmp_path, network(FIELD))


@pytest.mark.parametrize(
    ("variable", "units", "field", "words"),
    [
        ("drop", "furlong2", "units of drop", "is no unit"),
        ("drop", None, "units of drop", "are missing"),
        ("drop", "mm", "units of quantity drop", "unit of m, not of m^-1 kg s^-2"),
        ("roughness", "degC", "units of input roughness", "unit of K, not of m"),
        ("time", "kPa", "units of time", "not of s"),
        ("time", "yr", "units of time", "does not say how many hours"),
    ],
)
def test_a_unit_that_is_none_or_measures_something_else_is_refused(
    variable: str, units: str | None, field: str, words: str, tmp_path: Path
) -> None:
    data = dataset()
    data[variable].attrs = {} if units is None else {"units": units}
    (fault,) = [one for one in refused(data, tmp_path) if one.what == field]
    assert words in fault.problem


def test_another_unit_of_the_same_is_converted_and_told(tmp_path: Path) -> None:
    data = dataset()
    data["drop"] = (("run", "time"), data["drop"].values / 100, {"units": "bar"})
    archive, found, _ = taken(data, tmp_path)
    assert "multiplied by 100" in warned(found, "units of quantity drop").problem
    np.testing.assert_allclose(archive.read(5).values["drop"], drop(points()[5], TIME_H))


def test_numbers_of_another_magnitude_than_readings_may_have_are_told_with_the_factor(
    tmp_path: Path,
) -> None:
    data = dataset()
    data["drop"] = (("run", "time"), 1000 * data["drop"].values, {"units": "kPa"})
    _, found, _ = taken(data, tmp_path)
    one = warned(found, "quantity drop")
    assert "leaves what readings may be" in one.problem
    assert "times 0.001 it would fit" in one.remedy
    (tmp_path / "b").mkdir()
    small = dataset()
    small["drop"] = (("run", "time"), 1e-4 * small["drop"].values, {"units": "kPa"})
    _, found, _ = taken(small, tmp_path / "b")
    assert "readings tell nothing" in warned(found, "quantity drop").problem


def test_a_run_that_diverged_is_named_where_all_others_are_what_readings_may_be(
    tmp_path: Path,
) -> None:
    """All runs were told to be in another unit, times 1e-6."""
    data = dataset()
    data["drop"][17, 5:] *= 1e6
    one = warned(taken(data, tmp_path)[1], "quantity drop")
    assert one.problem.endswith("in 1 of 24 runs: 17")
    assert "leave out what diverged" in one.remedy


def test_unequal_instants_are_put_on_a_common_axis_and_the_runs_are_named(tmp_path: Path) -> None:
    data, x = dataset(), points()
    own = np.tile(TIME_H, (24, 1))
    own[4] = [0, 300, 700, 1500, 3000, 6000, 10_000, 13_000, 15_000]
    own[9, 8] = np.nan
    values = np.array([drop(a, t) for a, t in zip(x, own, strict=True)])
    data = data.drop_vars(["time", "drop", "transfer"])
    data["time_of_run"] = (("run", "time"), own, {"units": "h"})
    data["drop"] = (("run", "time"), values, {"units": "kPa"})
    archive, found, chosen = taken(data, tmp_path)
    one = warned(found, "runs")
    assert one.value == "4, 9"
    assert "up to 12000 h, where run 9 ends" in one.problem
    assert archive.declaration.time_h == tuple(TIME_H[:-1])
    assert len(chosen) == 24
    np.testing.assert_array_equal(archive.read(5).values["drop"], values[5, :-1])
    brought = archive.read(4).values["drop"]
    assert 0 < np.max(np.abs(brought - drop(x[4], TIME_H[:-1]))) < 0.02 * brought.max()
    told = warned(found, "quantity drop")
    assert "interpolating in time may miss" in told.problem
    short = data.copy(deep=True)
    short["time_of_run"][9, 4:] = np.nan
    (tmp_path / "b").mkdir()
    (fault,) = refused(short, tmp_path / "b")
    assert fault.what == "run 9: time"


def test_runs_with_hardly_an_instant_in_common_are_refused_by_name(tmp_path: Path) -> None:
    """Control: with one instant more before the shortest run ends they are taken."""
    for early, fits in ((2, False), (3, True)):
        data, x = dataset(), points()
        own = np.tile(
            np.concatenate([np.linspace(0, 5e3, early), np.linspace(9e3, 15e3, 7)]), (24, 1)
        )
        own[9] = np.nan
        own[9, :5] = [0, 2e3, 4e3, 6e3, 8e3]
        at = np.where(np.isfinite(own), own, 0.0)
        values = np.array([drop(a, t) for a, t in zip(x, at, strict=True)])
        data = data.drop_vars(["time", "drop", "transfer"])
        data["time_of_run"] = (("run", "time"), own, {"units": "h"})
        data["drop"] = (("run", "time"), values, {"units": "kPa"})
        folder = tmp_path / str(early)
        folder.mkdir()
        if fits:
            assert len(taken(data, folder)[0].declaration.time_h) == 4
            continue
        (fault,) = refused(data, folder)
        assert (fault.what, fault.value) == ("runs", 3)
        assert "up to 8000 h, where run 9 ends: fewer than 4" in fault.problem
        assert "leave run 9 out" in fault.remedy


def test_faults_stand_in_one_order_whatever_the_process(tmp_path: Path) -> None:
    """Inputs that no network knows came in the order of a set of texts, of each process its own."""
    names = ["salt", "dust", "water", "iron", "clay", "sand", "lime"]
    data = dataset()
    for k, name in enumerate(names):
        data[name] = ("run", np.linspace(0, 1 + k, 24), {"units": "1"})
    told = [one.what for one in refused(data, tmp_path) if one.what.startswith("input ")]
    assert told == [f"input {name}" for name in sorted(names)]


def test_instants_that_do_not_increase_or_begin_late_are_refused(tmp_path: Path) -> None:
    data = dataset(time_h=TIME_H + 100)
    assert "begin with 0" in refused(data, tmp_path)[0].remedy
    (tmp_path / "b").mkdir()
    back = TIME_H.copy()
    back[3:5] = back[4:2:-1]
    faults = refused(dataset(time_h=back), tmp_path / "b")
    assert faults[0].what == "time[4]"


def _constant(data: xr.Dataset) -> None:
    data["drop"][:] = data["drop"].values[0]


def _never_varies(data: xr.Dataset) -> None:
    data["roughness"][:] = 4.5


def _outside(data: xr.Dataset) -> None:
    data["roughness"].attrs |= {"low": 1.0, "high": 9.0}
    data["roughness"][6] = 9.4


def _narrow(data: xr.Dataset) -> None:
    data["roughness"].attrs |= {"low": 0.5, "high": 8.95}


def _unknown_input(data: xr.Dataset) -> None:
    data["salt"] = ("run", np.linspace(0, 1, 24), {"units": "1"})


def _shape(data: xr.Dataset) -> None:
    data["depth"] = (("run", "layer"), np.zeros((24, 2)), {"units": "m"})


def _twins(data: xr.Dataset) -> None:
    for name in ("roughness", "fouling_rate"):
        data[name][13] = data[name].values[12]


@pytest.mark.parametrize(
    ("spoil", "field", "words"),
    [
        (_constant, "quantity drop", "the same in every run"),
        (_never_varies, "input roughness", "the same in all 24 runs"),
        (_outside, "run 6: roughness", "outside its bounds, 1 … 9 um"),
        (_narrow, "prior of roughness", "wider than the bounds of the runs, 0.5 … 8.95"),
        (_unknown_input, "input salt", "no parameter of the network"),
        (_shape, "dimensions of depth", "neither an input (run) nor a quantity"),
        (_twins, "runs 12 and 13", "differs at equal inputs"),
    ],
)
def test_what_nothing_can_be_learnt_from_is_refused_by_name(
    spoil: Spoil, field: str, words: str, tmp_path: Path
) -> None:
    data = dataset()
    spoil(data)
    (fault,) = [one for one in refused(data, tmp_path) if one.what == field]
    assert words in fault.problem
    assert "np." not in str(fault)


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ("length_h: 10", "length_h of drop = 10.0 needs 96 modes up to 16000 h"),
        ("length_h: 8000, sd: 0.9", "sd of drop = 0.9 lets 1 . f fall to -"),
    ],
)
def test_a_discrepancy_that_these_hours_cannot_have_is_refused_before_training(
    told: str, words: str, tmp_path: Path
) -> None:
    """A model was trained, and every rotor on it was blocked."""
    gp = f"high: 2}}, discrepancy: {{kind: gp, {told}}}}}"
    file = stored(dataset(), tmp_path / "runs.nc")
    with opened(file) as source, pytest.raises(RunsError, match=words):
        make(source, network(NETWORK.replace("high: 2}}", gp)), tmp_path / "model")


ASLEEP = """
name: vane
parameters:
  - {name: load, level: local, prior: {kind: uniform, low: 1, high: 2}}
  - {name: leak, level: dormant, nominal: 0, prior: {kind: uniform, low: 0, high: 1}}
quantities:
"""
CREPT = "  - {name: %s, unit: '1', kind: %s, low: -9, high: 99, sigma_obs: {kind: log_uniform, low: 0.01, high: 1}}\n"  # noqa: E501


def creeping(first: float = 0.0) -> xr.Dataset:
    """Runs of a creeping body, with an oxide that grows beside; elongation from `first`."""
    x = exchanger.maximin_lhs(20, (1.0, 0.0), (2.0, 1.0), 5)
    grown = np.array([a * np.sqrt(TIME_H / 1000) * np.exp(0.5 * b) for a, b in x])
    course, field = ("run", "time"), grown[:, :, None] * np.array([0.2, 0.6, 1.0])
    return xr.Dataset(
        {
            "load": ("run", x[:, 0], {"units": "1"}),
            "leak": ("run", x[:, 1], {"units": "1"}),
            "elongation": (course, first + 0.5 * grown, {"units": "1"}),
            "oxide": (course, 2 * grown, {"units": "1"}),
            "ceeq": (("run", "time", "node"), field, {"units": "1"}),
        },
        coords={"time": ("time", TIME_H, {"units": "h"}), "run": np.arange(20)},
    )


@pytest.mark.parametrize(
    ("quantities", "field", "words"),
    [
        ({"elongation": "scalar", "oxide": "scalar"}, "quantity oxide", "has no rule in time"),
        ({"ceeq": "field"}, "quantities", "neither elongation nor deformation"),
    ],
)
def test_what_cannot_follow_an_input_that_sleeps_is_refused_before_training(
    quantities: dict[str, str], field: str, words: str, tmp_path: Path
) -> None:
    """A model was trained of oxide beside elongation, and its first reading blocked every rotor."""
    declared = network(ASLEEP + "".join(CREPT % one for one in quantities.items()))
    (fault,) = refused(creeping(), tmp_path, declared)
    assert fault.what == field
    assert words in fault.problem
    assert "dormant parameter leak" in fault.problem


def test_a_family_that_runs_in_time_is_refused_where_nothing_is_followed(tmp_path: Path) -> None:
    """It was never found, and diagnoses said that the readings were too few."""
    family = """families:
  - {name: silt, sentence: silt settles, target: input, of: fouling_rate, how: plus, size: 1.0e-5,
     sign: 1, shapes: [%s], whom: [all], clock: blade, kind: physics}
"""
    (fault,) = refused(dataset(), tmp_path, network(NETWORK + family % "linear, step"))
    assert fault.what == "shapes of the effect 'silt'"
    assert "needs a field ceeq" in fault.problem
    (tmp_path / "b").mkdir()
    _, found, _ = taken(dataset(), tmp_path / "b", network(NETWORK + family % "constant, linear"))
    assert [one.what for one in found.warnings] == ["the effect 'silt'", "quantity transfer"]
    assert "reaches to the end of the runs, 2e-05 … 0.0002" in found.warnings[0].problem


@pytest.mark.parametrize(
    ("sign", "bounds", "warned_of"),
    [(1, (2e-5, 3e-4), 0), (-1, (2e-5, 3e-4), 1), (-1, (1e-5, 2e-4), 0), (0, (1e-5, 2e-4), 0)],
)
def test_a_family_that_the_runs_have_no_room_for_is_told_when_they_are_checked(
    sign: int, bounds: tuple[float, float], warned_of: int, tmp_path: Path
) -> None:
    """It was told by the first diagnosis, of an effect of 112 nat, that it could not be adopted."""
    family = """families:
  - {name: grit, sentence: it wears, target: input, of: fouling_rate, how: times, size: 0.3,
     sign: %d, shapes: [constant], whom: [lot], clock: blade, kind: physics}
"""
    data = dataset()
    data["fouling_rate"].attrs |= {"low": bounds[0], "high": bounds[1]}
    _, found, _ = taken(data, tmp_path, network(NETWORK + family % sign))
    assert [one.what for one in found.warnings].count("the effect 'grit'") == warned_of


@pytest.mark.parametrize(
    ("changes", "what", "words"),
    [
        ("of: fouling_rate, size: 1.0e-16", "size", "too small for any reading to show"),
        ("of: fouling_rate, size: 1.0e-3", "size", "larger than all there can be of fouling_rate"),
        ("of: drop, target: reading, size: 1.0e-7", "size", "of the least noise of drop, 0.05"),
    ],
)
def test_a_family_of_a_size_that_cannot_be_meant_is_refused(
    changes: str, what: str, words: str, tmp_path: Path
) -> None:
    """1e-12 of an input's range was looked for in every diagnosis, and never found."""
    family = """families:
  - {name: silt, sentence: silt settles, target: input, how: plus, sign: 1, shapes: [constant],
     whom: [all], clock: blade, kind: physics, %s}
"""
    told = changes.split(", ")
    text = family % changes
    if "target: reading" in told:
        text = text.replace("target: input, ", "")
    (fault,) = refused(dataset(), tmp_path, network(NETWORK + text))
    assert fault.what == f"{what} of the effect 'silt'"
    assert words in fault.problem
    (tmp_path / "b").mkdir()
    taken(dataset(), tmp_path / "b", network(NETWORK + family % "of: fouling_rate, size: 1.0e-5"))


def test_an_elongation_that_does_not_grow_with_creep_cannot_follow_an_input_that_sleeps(
    tmp_path: Path,
) -> None:
    declared = network(ASLEEP + CREPT % ("elongation", "scalar"))
    with opened(stored(creeping(), tmp_path / "runs.nc")) as source:
        make(source, declared, tmp_path / "model")
    with (
        opened(stored(creeping(1.0), tmp_path / "elastic.nc")) as source,
        pytest.raises(RunsError, match="quantity elongation = None is learnt as 'log'"),
    ):
        make(source, declared, tmp_path / "elastic")


def test_a_prior_in_which_no_run_lies_is_refused(tmp_path: Path) -> None:
    """Roughness in mm for um: the prior was a thousandth of the box, and all of it extrapolated."""
    data = dataset()
    data["roughness"].attrs["units"] = "mm"
    (fault,) = refused(data, tmp_path)
    assert fault.what == "prior of roughness"
    assert "1.17e+03 … 8.83e+03 um" in fault.problem
    (tmp_path / "b").mkdir()
    narrow = network(NETWORK.replace("low: 1, high: 9", "low: 1, high: 1.1"))
    assert "in which no run lies" in refused(dataset(), tmp_path / "b", narrow)[0].problem


@pytest.mark.parametrize("kept", [0, 24])
def test_nothing_to_learn_from_is_told(tmp_path: Path, kept: int) -> None:
    """A file of no runs, or all of them left out."""
    with pytest.raises(RunsError, match="runs = 0 are left to learn from"):
        taken(dataset().isel(run=slice(0, kept)), tmp_path, leave_out=[str(k) for k in range(kept)])


def hours(own: np.ndarray) -> xr.Dataset:
    return dataset().assign(time_of_run=(("run", "time"), own, {"units": "h"}))


def test_an_hour_without_end_is_refused_and_no_run_goes_on_to_it(tmp_path: Path) -> None:
    """As a last instant it let the run's values go on beyond its last finite one."""
    own = np.tile(TIME_H, (24, 1))
    own[2, -1] = np.inf
    (fault,) = refused(hours(own), tmp_path)
    assert (fault.what, fault.problem) == ("run 2: time", "is no instant")


def test_runs_without_any_hour_are_refused(tmp_path: Path) -> None:
    (fault,) = refused(hours(np.full((24, len(TIME_H)), np.nan)), tmp_path)
    assert fault.what == "time_of_run"


def test_the_same_run_twice_counts_once(tmp_path: Path) -> None:
    data = dataset()
    twice = xr.concat([data, data.isel(run=[4])], "run").assign_coords(run=np.arange(25))
    _, found, chosen = taken(twice, tmp_path)
    assert warned(found, "runs 4 and 24").value == "24"
    assert chosen == tuple(range(24))


def test_three_runs_are_refused_with_the_number_that_is_needed_and_nine_are_warned_of(
    tmp_path: Path,
) -> None:
    (fault,) = refused(dataset(3), tmp_path)
    assert (fault.what, fault.value) == ("runs", 3)
    assert "too few for 2 inputs: 9 are needed" in fault.problem
    assert "misses drop by 2" in fault.problem
    (tmp_path / "b").mkdir()
    _, found, chosen = taken(dataset(9), tmp_path / "b")
    assert len(chosen) == 9
    assert "20 are usual" in warned(found, "runs").problem


def test_all_faults_of_all_kinds_are_told_at_once(tmp_path: Path) -> None:
    data = dataset()
    data["drop"][3, 4] = np.nan
    data["roughness"][8] = np.nan
    data["transfer"].attrs["units"] = "mm"
    _never = data["fouling_rate"]
    _never[:] = 1e-4
    found = {one.what for one in refused(data, tmp_path, network(BOTH))}
    assert found >= {
        "run 3: drop", "run 8: roughness", "units of quantity transfer", "input fouling_rate"
    }  # fmt: skip


def test_runs_that_stop_short_of_the_bounds_are_told(tmp_path: Path) -> None:
    data = dataset()
    data = data.isel(run=np.flatnonzero(data["roughness"].values < 7.0))
    _, found, _ = taken(data, tmp_path)
    assert "extrapolates" in warned(found, "input roughness").problem


def test_a_prior_that_lies_beside_most_runs_is_told_however_wide_these_are(tmp_path: Path) -> None:
    """Columns swapped: half of a prior had no run, and the runs beyond it hid that."""
    narrow = network(NETWORK.replace("low: 1, high: 9", "low: 0.6, high: 2"))
    _, found, _ = taken(dataset(), tmp_path, narrow)
    assert "extrapolates" in warned(found, "input roughness").problem


def test_a_network_that_the_runs_do_not_fit_is_refused_by_name(tmp_path: Path) -> None:
    text = NETWORK.replace("name: drop", "name: loss").replace("name: roughness", "name: grain")
    found = {one.what for one in refused(dataset(), tmp_path, network(text))}
    assert found >= {"parameter grain", "input roughness", "quantity loss"}
    asleep = NETWORK.replace("level: local, unit: um", "level: dormant, nominal: 3, unit: um")
    (tmp_path / "b").mkdir()
    faults = refused(dataset(), tmp_path / "b", network(asleep))
    assert [one.what for one in faults] == ["dormant parameter roughness"]


def test_a_surrogate_that_knows_nothing_is_refused_and_a_poor_one_warned_of(
    tmp_path: Path,
) -> None:
    data = dataset()
    wild = np.random.default_rng(4).normal(20.0, 5.0, (24, len(TIME_H)))
    data["drop"] = (("run", "time"), wild, {"units": "kPa"})
    with opened(stored(data, tmp_path / "wild.nc")) as source, pytest.raises(RunsError) as caught:
        make(source, network(), tmp_path / "wild")
    (fault,) = caught.value.faults
    assert fault.what == "surrogate of drop"
    assert "hardly more than the mean run" in fault.problem
    fine = NETWORK.replace("low: 0.05, high: 2}", "low: 1e-5, high: 1e-3}")
    with opened(stored(dataset(), tmp_path / "runs.nc")) as source:
        surrogate, found = make(source, network(fine), tmp_path / "poor")
    assert "above the noise" in warned(found, "surrogate of drop").problem
    row = surrogate.manifest["quality"]["drop"]
    assert row["verdict"] == "poor"
    assert row["noise"] == pytest.approx(1e-4)
    with opened(tmp_path / "runs.nc") as source:
        surrogate, found = make(source, network(), tmp_path / "good")
    assert surrogate.manifest["quality"]["drop"]["verdict"] == "good"
    assert [one.what for one in found.warnings] == ["quantity transfer"]


def test_held_out_errors_are_those_of_runs_that_the_surrogate_has_not_seen(
    tmp_path: Path,
) -> None:
    with opened(stored(dataset(40), tmp_path / "runs.nc")) as source:
        surrogate, _ = make(source, network(), tmp_path / "model")
    row = surrogate.manifest["quality"]["drop"]
    rng = np.random.default_rng(8)
    new = rng.uniform(exchanger.LOW, exchanger.HIGH, (300, 2))
    mean, _ = surrogate.predict(new, "drop", TIME_H)
    true = np.array([drop(x, TIME_H) for x in new])
    rms = float(np.sqrt(np.mean((mean - true) ** 2)))
    assert 0.2 < row["rms"] / rms < 8
    assert row["spread"] == pytest.approx(np.sqrt(np.mean(np.var(true, axis=0))), rel=0.2)


def test_our_own_folder_and_packed_file_are_read_by_the_same_checks(tmp_path: Path) -> None:
    archive, _, _ = taken(dataset(), tmp_path)
    archive.to_netcdf(tmp_path / "packed.nc")
    for number, path in enumerate((archive.path, tmp_path / "packed.nc")):
        with opened(path) as source:
            again, found, chosen = take(source, network(), tmp_path / f"again{number}")
        assert chosen == tuple(range(24))
        assert found.warnings == []
        np.testing.assert_array_equal(again.inputs(), archive.inputs())


def test_a_file_whose_numbers_lie_elsewhere_is_not_read(tmp_path: Path) -> None:
    other = stored(dataset(), tmp_path / "runs.nc")
    with h5py.File(tmp_path / "link.nc", "w") as file:
        file["drop"] = h5py.ExternalLink(str(other), "/drop")
    (tmp_path / "secret").write_bytes(b"\0" * 80)
    with h5py.File(tmp_path / "raw.nc", "w") as file:
        file.create_dataset("drop", (10,), "f8", external=[(str(tmp_path / "secret"), 0, 80)])
    layout = h5py.VirtualLayout((24, 9), "f8")
    layout[:] = h5py.VirtualSource(str(other), "drop", (24, 9))
    with h5py.File(tmp_path / "virtual.nc", "w") as file:
        file.create_virtual_dataset("drop", layout)
    for name in ("link", "raw", "virtual"):
        with pytest.raises(ModelError, match="elsewhere"):
            check_file(tmp_path / f"{name}.nc")
    check_file(other)
    (tmp_path / "text.nc").write_text("run,time")
    with pytest.raises(ModelError, match="cannot be read as netCDF"):
        check_file(tmp_path / "text.nc")


def test_an_archive_that_would_unfold_beyond_memory_is_refused_before_it_is_read(
    tmp_path: Path,
) -> None:
    with h5py.File(tmp_path / "bomb.nc", "w") as file:
        file.create_dataset("drop", (1000, 1000, 2000), "f8", chunks=(1, 1000, 2000),
                            compression="gzip")  # fmt: skip
        for axis, name in enumerate(("run", "time", "node")):
            scale = file.create_dataset(name, (file["drop"].shape[axis],), "f8")
            scale.make_scale(name)
            file["drop"].dims[axis].attach_scale(scale)
    assert (tmp_path / "bomb.nc").stat().st_size < 100_000
    with pytest.raises(RunsError, match="values are declared"), opened(tmp_path / "bomb.nc"):
        pass


@pytest.mark.parametrize("size", [1e200, 1e31, 1e-198])
@pytest.mark.parametrize("name", ["drop", "roughness"])
def test_numbers_of_no_usable_size_are_refused_with_a_sentence(
    name: str, size: float, tmp_path: Path
) -> None:
    """Squares overflowed while a model was trained, or nothing seemed to move."""
    data = dataset()
    data[name] = data[name].copy(data=data[name].values * size)
    text = {
        "drop": ("low: -5, high: 250", f"low: {-5 * size!r}, high: {250 * size!r}"),
        "roughness": ("low: 1, high: 9", f"low: {size!r}, high: {9 * size!r}"),
    }
    faults = refused(data, tmp_path, network(NETWORK.replace(*text[name])))
    told = [one for one in faults if name in one.what]
    assert told
    beyond = "is beyond 1e+30" if size > 1 else "is below 1e-30"
    assert all(one.problem == beyond and "unit of its own size" in one.remedy for one in told)


@pytest.mark.parametrize("ends", ["low: 0.05, high: 2e200", "low: 1e-198, high: 2"])
def test_a_noise_of_no_usable_size_is_refused_with_a_sentence(ends: str, tmp_path: Path) -> None:
    (fault,) = refused(dataset(), tmp_path, network(NETWORK.replace("low: 0.05, high: 2", ends)))
    assert fault.what == "sigma_obs of drop"
    assert "1e" in fault.problem
