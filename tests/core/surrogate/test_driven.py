"""A surrogate whose inputs run in time by calibrated amplitudes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.builtin import rotor_blade
from core.builtin.paper_network import rotor_blade_network
from core.calibration.online import update
from core.calibration.state import RotorSpec, shared_posterior
from core.course import Course
from core.diagnosis.adopt import with_effects
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.drift import Drift
from core.errors import InputError, ModelError, RangeError
from core.model import Model, rotor_blade_wide
from core.network import Network, Parameter
from core.observation import Inspection
from core.prior import Prior
from core.surrogate import clock, driven, kept
from core.surrogate.driven import Driven
from core.surrogate.formula import FormulaInput, FormulaModel
from core.surrogate.history import follow
from core.surrogate.kept import Wanted

KEPT = json.loads(Path(__file__).with_name("histories.json").read_text())
TIMES = np.array(KEPT["time_h"])[1:]
TIP, CRITICAL = KEPT["nodes"]
BLADE = rotor_blade.load()
RAMP = Course.of([(0.0, 0.0), (5e4, 1.0)])
RANGES = {"tbc_thickness": (1.0, 4 / 3), "t1t_rate": (0.8, 0.95)}
RANGES |= {"erosion": (0.0, 1 / 3)}
CYCLED = {"tbc_thickness": (1.0, 4 / 3), "t1t_rate": (0.8, 1.0), "wear": (0.0, 1 / 3)}
LOSS = Course.of([(0.0, 0.0), (5e4, -1.0)])
EROSION = Drift("erosion", "tbc_thickness", LOSS, "times")
FOULING = Drift("fouling", "t1t_rate", RAMP)
WORN = Driven(BLADE, (EROSION,), RANGES, {})
RNG = np.random.default_rng(1)


def points(model: Driven, n: int) -> np.ndarray:
    low, high = np.array([(i.low, i.high) for i in model.inputs]).T
    return low + RNG.random((n, len(low))) * (high - low)


def test_many_are_answered_whatever_is_still_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour that is kept and one that is new, where the new one makes all that is kept go."""
    x, worn = points(WORN, driven.MANY), replace(WORN)
    whole = worn.predict(x, "elongation", np.array([9e3, 5e4]))
    monkeypatch.setattr(kept, "MOST", 0)
    worn = replace(WORN)
    worn.predict(x, "elongation", np.array([5e4]))
    again = worn.predict(x, "elongation", np.array([9e3, 5e4]))
    assert np.array_equal(again[0], whole[0])
    assert np.array_equal(again[1], whole[1])


def test_hours_asked_for_together_answer_to_the_last_bit_as_one_by_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And are compiled once: what follows a call of `ready` compiles nothing."""
    hours, made = [9e3, 2e4, 5e4], []
    x, whole = points(WORN, driven.MANY), Driven.compiled
    length, strain = Wanted.of("elongation"), Wanted.of("ceeq", [TIP])
    mixing = np.eye(3, BLADE.parts["deformation"].factors.space.shape[1])
    shape = Wanted.of("deformation", mixing=mixing)

    def counted(self: Driven, wanted: Any, times: Any, *more: Any) -> Any:
        made.append((list(wanted), list(times)))
        return whole(self, wanted, times, *more)

    monkeypatch.setattr(Driven, "compiled", counted)
    together, alone = replace(WORN), replace(WORN)
    together.ready(driven.MANY - 1, {length: hours})
    assert made == [], "so few are followed one by one"
    together.ready(driven.MANY, {length: [0.0, *hours, 9e3], strain: hours, shape: hours[:2]})
    assert made == [([length, strain, shape], hours)]
    lengths = [together.predict(x, "elongation", np.array([t])) for t in hours]
    strains = [together.predict(x, "ceeq", np.array([t]), [TIP]) for t in hours]
    shapes = [one.evaluate(x) for one in together.mode_responses(hours[:2], mixing)]
    assert len(made) == 1, "all is there"
    for t, several in zip(hours, lengths, strict=True):
        same(several, alone.predict(x, "elongation", np.array([t])))
    for t, several in zip(hours, strains, strict=True):
        same(several, alone.predict(x, "ceeq", np.array([t]), [TIP]))
    for t, several in zip(hours, shapes, strict=False):
        same(several, alone.mode_response(t, mixing).evaluate(x))
    one_by_one = [(own, t) for own in (length, strain, shape) for t in hours][:-1]
    assert made[1:] == [([own], [t]) for own, t in one_by_one]
    together.mode_responses(hours, mixing)
    assert made[-1] == ([shape], hours[2:]), "only what is new"
    with pytest.raises(RangeError, match="9000000000"):
        together.ready(driven.MANY, {length: [9e9]})


def test_many_hours_are_compiled_some_at_a_time_and_answer_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No more of a scan's rows is held than of `TOGETHER` hours; a quantity that none of them asks
    for is left out."""
    x, hours, made, whole = points(WORN, driven.MANY), [9e3, 2e4, 3e4, 5e4], [], Driven.compiled
    length, strain = Wanted.of("elongation"), Wanted.of("ceeq", [TIP])

    def counted(self: Driven, wanted: Any, times: Any, *more: Any) -> Any:
        made.append((list(wanted), list(times)))
        return whole(self, wanted, times, *more)

    at_once = replace(WORN).predict(x, "elongation", np.array(hours))
    monkeypatch.setattr(Driven, "compiled", counted)
    monkeypatch.setattr(kept, "TOGETHER", 2)
    some = replace(WORN)
    some.ready(len(x), {length: hours, strain: hours[:2]})
    assert made == [([length], hours[2:]), ([length, strain], hours[:2])], "alike together"
    same(some.predict(x, "elongation", np.array(hours)), at_once)
    assert len(made) == 2


def same(got: tuple[np.ndarray, np.ndarray], wanted: tuple[np.ndarray, np.ndarray]) -> None:
    """Mean and sd, to the last bit."""
    for a, b in zip(got, wanted, strict=True):
        assert np.array_equal(a, b)


def test_blocks_are_answered_as_if_each_were_asked_for_and_rows_are_worked_out_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    x, nodes, times = points(WORN, 7), list(range(40)), np.array([0.0, 2e4])
    whole = [WORN.predict(x[k : k + 3], "deformation", times, nodes) for k in (0, 3, 6)]
    asked, rows = [], Driven._rows

    def counted(self: Driven, *what: Any) -> Any:
        asked.append(what)
        return rows(self, *what)

    monkeypatch.setattr(Driven, "_rows", counted)
    got = list(WORN.in_blocks(x, "deformation", times, nodes, 3))
    assert len(asked) == 1
    for mine, own in zip(got, whole, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(mine, own, strict=True))


@pytest.mark.parametrize(
    ("quantity", "nodes", "shape"),
    [("elongation", None, ()), ("ceeq", [CRITICAL], (1,)), ("deformation", [TIP, 7], (2, 3))],
)
def test_many_at_the_start_are_nothing_in_the_right_shape(
    quantity: str, nodes: list[int] | None, shape: tuple[int, ...]
) -> None:
    mean, sd = WORN.predict(points(WORN, driven.MANY), quantity, np.array([0.0]), nodes)
    assert mean.shape == sd.shape == (driven.MANY, 1, *shape)
    assert not mean.any()


@pytest.mark.parametrize("count", [1, driven.MANY])
def test_few_and_many_are_refused_beyond_the_inputs_and_the_hours(count: int) -> None:
    """Polynomials would answer: 0.016 mm for a coating of 2.5."""
    x, j = np.repeat(points(WORN, 1), count, axis=0), 0
    assert WORN.inputs[j].name == "tbc_thickness"
    for bad in (2.5, np.nan):
        odd = x.copy()
        odd[-1, j] = bad
        with pytest.raises(RangeError, match="tbc_thickness"):
            WORN.predict(odd, "elongation", np.array([5e4]))
    for hour in (-1.0, np.nan, 6e4):
        with pytest.raises(RangeError, match="times"):
            WORN.predict(x, "elongation", np.array([hour]))
        with pytest.raises(RangeError, match="times"):
            list(WORN.in_blocks(x, "elongation", np.array([hour]), None, 64))
    edge = np.repeat([[i.high for i in WORN.inputs]], count, axis=0)
    assert np.all(WORN.predict(edge * (1 + 1e-15), "elongation", np.array([5e4]))[0] > 0)


def test_many_of_the_wrong_shape_are_refused_by_the_names_that_are_wanted() -> None:
    with pytest.raises(InputError, match="erosion"):
        WORN.predict(points(WORN, driven.MANY)[:, :-1], "elongation", np.array([5e4]))


@pytest.mark.parametrize(
    ("quantity", "nodes"),
    [("elongation", None), ("ceeq", [CRITICAL]), ("deformation", [TIP, CRITICAL])],
)
def test_without_amplitude_it_is_the_surrogate(quantity: str, nodes: list[int] | None) -> None:
    x = points(WORN, 5)
    x[:, -1] = 0.0
    times = np.array([0.0, 8e3, 5e4])
    mean, sd = WORN.predict(x, quantity, times, nodes)
    whole, spread = BLADE.predict(x[:, :4], quantity, times, nodes)
    assert mean.shape == whole.shape
    assert mean == pytest.approx(whole, rel=1e-6, abs=1e-12)
    assert not mean[:, 0].any()
    assert np.all(sd[:, 1:] >= spread[:, 1:] * 0.5)


def test_every_way_of_a_cycle_gets_its_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """One piece for a way, held at its mean, would miss several percent: rates are exponential."""
    half = 5e4 / 8
    to_and_fro = Course.of([(k * half, -float(k % 2)) for k in range(9)])
    model = Driven(BLADE, (Drift("wear", "tbc_thickness", to_and_fro, "times"),), CYCLED, {})
    x, hours = np.array([[1.15, 0.94, 0.3, 1.8, 0.33]]), np.array([2.5e4, 5e4])
    mean = model.along(x, "elongation", hours)[0].ravel()
    for parts, off in ((24, 0.002), (1, 0.02)):
        monkeypatch.setattr("core.surrogate.in_time.PARTS", parts)
        other = model.along(x, "elongation", hours)[0].ravel()
        assert np.all(np.abs(mean / other - 1.0) < off) == (parts > 1), mean / other


@pytest.mark.parametrize(
    ("quantity", "nodes", "most"),
    [("elongation", None, 0.004), ("ceeq", [CRITICAL], 0.012), ("deformation", [TIP], 0.01)],
)
def test_the_polynomials_are_what_it_predicts(
    quantity: str, nodes: list[int] | None, most: float
) -> None:
    """Over the whole box, error and its size; relative to the value's own size over the box."""
    times = np.array([8e3, 24e3, 5e4])
    x = points(WORN, 60)
    mean, sd = WORN.predict(x, quantity, times, nodes)
    got, spread = WORN.response(quantity, times, nodes).evaluate(x)
    mean, sd = mean.reshape(got.shape), sd.reshape(got.shape)
    off = np.abs(got - mean) / np.sqrt(np.mean(mean**2, axis=1, keepdims=True))
    assert np.quantile(off, 0.95) < most
    ratio = spread / sd
    assert 0.8 < np.median(ratio) < 1.25
    assert np.all((ratio > 0.3) & (ratio < 3.0))


def test_mixtures_of_the_deformation_s_modes_are_its_fields() -> None:
    modes = WORN.deformation_modes([TIP])[0]
    x = points(WORN, 20)
    got, _ = WORN.mode_response(24e3, modes).evaluate(x)
    whole, _ = WORN.predict(x, "deformation", np.array([24e3]), [TIP])
    assert got == pytest.approx(whole[:, 0, 0], abs=0.01 * np.abs(whole).max())


def test_at_the_start_nothing_has_grown_and_the_other_rows_are_what_they_were() -> None:
    hours = np.array([0.0, 24e3])
    got = WORN.response("ceeq", hours, [TIP, CRITICAL])
    x = points(WORN, 20)
    mean, sd = got.evaluate(x)
    assert not mean[:, :2].any()
    assert not sd[:, :2].any()
    assert np.array_equal(got.a[2:], WORN.response("ceeq", [24e3], [TIP, CRITICAL]).a)
    modes = WORN.deformation_modes([TIP])[0]
    assert not WORN.mode_response(0.0, modes).evaluate(x)[0].any()
    with pytest.raises(RangeError, match="outside"):
        WORN.response("elongation", [-1.0])


def test_readings_at_the_start_are_calibrated_like_those_of_the_surrogate() -> None:
    """They say nothing of what creeps; of an unknown noise they would say how large it is."""
    model = Model.of(with_erosion(), BLADE)
    late = Inspection("late", "B1", "elongation", 24e3, np.array([0.2]), sigma=0.02)
    zero = Inspection("zero", "B1", "elongation", 0.0, np.array([0.01]), sigma=0.02)
    nodes = np.array([TIP, CRITICAL])
    scan = Inspection("scan", "B1", "deformation", 0.0, np.zeros((2, 3)), nodes, sigma=0.03)
    found = []
    for readings in ([late], [late, zero, scan]):
        state = update(model, RotorSpec("r", ("B1",), 2000), readings)
        posterior = shared_posterior(state.meta, state.arrays.__getitem__)
        values, w = posterior.column("t1t_rate"), posterior.particles.w
        found.append((w @ values, np.sqrt(w @ (values - w @ values) ** 2)))
    (mean, sd), (again, spread) = found
    assert abs(again - mean) < 0.1 * sd
    assert spread == pytest.approx(sd, rel=0.1)


def test_amplitudes_are_finite_elements_with_that_history() -> None:
    """Kept runs whose inputs run from hour 0 on, each by its own amplitude."""
    seen = []
    for run in KEPT["runs"]:
        given = run["inputs"]
        both = {n: v for n, v in given.items() if isinstance(v, list)}
        if run["kind"] not in ("worn", "fouling", "both"):
            continue
        drifts = tuple(Drift(f"drift {name}", name, RAMP) for name in both)
        amplitudes = [end - start for (_, start), (_, end) in both.values()]
        box = {n: v[0][1] if n in both else v for n, v in given.items()}
        box |= {d.name: a for d, a in zip(drifts, amplitudes, strict=True)}
        narrow = {n: (v - 1e-6, v + 1e-6) for n, v in box.items()}
        model = Driven(BLADE, drifts, narrow, {})
        x = np.array([[box[i.name] for i in model.inputs]])
        mean, _ = model.predict(x, "elongation", TIMES)
        seen.append(np.abs(mean[0] / np.array(run["elongation"])[1:] - 1)[1:].max())
    assert len(seen) == 6
    assert max(seen) < 0.025


def test_a_node_whose_creep_has_stopped_answers_under_wear(monkeypatch: pytest.MonkeyPatch) -> None:
    """What hardly creeps has as much strain under thin coatings as under thick ones, to what the
    surrogate knows of it: when it had it under these is open, and its readings blocked a rotor."""
    wear = next(f for f in FAMILIES if f.name == "coating wear")
    wide, hours, node, other = rotor_blade_wide(), [2e4, 5e4], 0, 2520
    noise = {q.name: 1e-4 for q in wide.network.quantities}
    model = with_effects(wide, [Cell(wear, "linear", "all")], {}, noise, {"B1": 24e3}).surrogate
    assert isinstance(model, Driven)
    assert model.inputs[-1].high > 0.4 / 0.48, "the thinnest coatings are held before 24,000 h"
    low, high = np.array([(i.low, i.high) for i in model.inputs]).T
    x = low + np.random.default_rng(3).random((150, len(low))) * (high - low)
    mean, sd = model.response("ceeq", hours, [node]).evaluate(x)
    direct, _ = model.predict(x, "ceeq", np.array(hours), [node])
    off = np.abs(mean - direct[:, :, 0])
    assert np.all(off < 4.0 * sd)
    assert off.max() < 0.15 * direct.max()
    model.response("ceeq", hours, [other])
    monkeypatch.setattr(driven, "follow", lambda *a, late, **n: follow(*a, **n))
    with pytest.raises(RangeError, match="longer runs"):
        model.response("ceeq", hours, [other])
    model.response("ceeq", hours, [node])
    monkeypatch.setattr(clock, "_first", lambda _curve, _w, wanted: np.full(wanted.shape, np.nan))
    with pytest.raises(RangeError, match="longer runs"):
        model.response("ceeq", hours, [node])


def test_inputs_that_are_held_are_no_inputs() -> None:
    ranges = {"t1t_rate": (0.8, 0.95), "fouling": (0.0, 0.05)}
    model = Driven(BLADE, (FOULING,), ranges, {"creep_transient": 0.5})
    names = [i.name for i in model.inputs]
    assert names == ["tbc_thickness", "t1t_rate", "creep_steady", "fouling"]
    x = points(model, 3)
    x[:, -1] = 0.0
    full = np.column_stack([x[:, :2], np.full(3, 0.5), x[:, 2]])
    mean, _ = model.predict(x, "elongation", TIMES)
    assert mean == pytest.approx(BLADE.predict(full, "elongation", TIMES)[0], rel=1e-6)
    assert model.response("elongation", [8e3]).names == tuple(names)


def with_erosion(**changed: Any) -> Network:
    """The blade's network with coatings that wear."""
    own, kept = rotor_blade_network(), []
    for p in own.parameters:
        low, high = RANGES.get(p.name, (p.prior.low, p.prior.high))
        kept.append(replace(p, prior=replace(p.prior, low=low, high=high)))
    erosion = Parameter("erosion", "shared", Prior("uniform", 0.0, 1 / 3))
    told = {"name": "worn", "parameters": (*kept, erosion), "drifts": (EROSION,), **changed}
    return replace(own, **told)


def test_a_network_declares_it() -> None:
    network = with_erosion()
    assert Network.from_json(json.loads(json.dumps(network.to_json()))) == network
    assert "drifts" not in rotor_blade_network().to_json()
    model = Model.of(network, BLADE)
    assert model.input_names[-1] == "erosion"
    assert isinstance(model.surrogate, Driven)
    assert model.surrogate.digest == WORN.digest
    again = Model.of(with_erosion(drifts=(replace(EROSION, how="plus"),)), model.surrogate)
    assert isinstance(again.surrogate, Driven)
    assert again.surrogate.base is BLADE
    assert again.digest != model.digest


def test_a_network_whose_drifts_nobody_answers_is_refused() -> None:
    with pytest.raises(ModelError, match=r"Model\.of"):
        Model(with_erosion(), BLADE)
    formula = FormulaModel((FormulaInput("tbc_thickness", 0.0, 2.0),), {}, "f")
    with pytest.raises(ModelError, match="erosion"):
        Model.of(with_erosion(), formula)
    with pytest.raises(InputError, match="amplitude"):
        with_erosion(drifts=(Drift("t1t_rate", "t1t_rate", RAMP),))
    with pytest.raises(InputError, match="does not exist"):
        with_erosion(drifts=(Drift("salt", "t1t_rate", RAMP),))
    with pytest.raises(InputError, match="twice"):
        with_erosion(drifts=(EROSION, EROSION))
    for wrong in ([1.0, 2.0], [[1.0]], [["early", 0.0]], None):
        told = with_erosion().to_json()
        told["drifts"][0]["shape"] = wrong
        with pytest.raises(InputError, match="network"):
            Network.from_json(told)


def test_a_course_that_leaves_the_runs_is_refused() -> None:
    with pytest.raises(InputError, match="course of tbc_thickness"):
        Driven(BLADE, (EROSION,), {"erosion": (0.0, 0.9)}, {})
    with pytest.raises(InputError, match="salt"):
        Driven(BLADE, (Drift("a", "salt", RAMP),), {"a": (0.0, 0.9)}, {})
    with pytest.raises(InputError, match="names of their own"):
        Driven(BLADE, (EROSION, EROSION), RANGES, {})
    with pytest.raises(InputError, match="range"):
        Driven(BLADE, (Drift("a", "t1t_rate", RAMP),), {}, {})
    with pytest.raises(InputError, match="does not start from 0"):
        Drift("a", "t1t_rate", Course.of([(0.0, 1.0), (1.0, 2.0)]))
    with pytest.raises(InputError, match="T"):
        WORN.mode_response(8e3, np.ones((1, 2)))
