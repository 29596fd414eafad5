"""The room that effects find in the runs, each alone and two together."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from core.builtin import creep_specimens
from core.calibration.online import RotorSpec, Workspace, update
from core.calibration.state import blade_posterior
from core.course import Course
from core.diagnosis import Case, Facts, adopt
from core.diagnosis.adopt import with_effects
from core.diagnosis.conclude import Rival
from core.diagnosis.diagnose import _end
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import UNTIL, Cell
from core.diagnosis.held import while_read
from core.diagnosis.hypotheses import Hypothesis
from core.diagnosis.room import room as room_of
from core.diagnosis.search import Search
from core.drift import Drift, How
from core.errors import CalibrationError, InputError
from core.model import Model, rotor_blade, rotor_blade_wide
from core.observation import Inspection
from core.runs_end import held_by

FAMILY = {f.name: f for f in FAMILIES}
FOULING = Cell(FAMILY["fouling"], "linear", "all")
STEP = Cell(FAMILY["firing temperature step"], "step", "all", step_h=17_500.0)


@pytest.fixture(scope="module")
def search() -> Search:
    """Two blades; one joined late, so that each has a course of its own: nothing is seen before."""
    names = ("B1", "B2")
    data = tuple(
        Inspection(f"{b}-{t}", b, "elongation", t, np.array([0.3 + 1e-6 * t]), sigma=0.02)
        for b in names
        for t in (7e3, 21e3)
    )
    facts = {"B1": Facts(), "B2": Facts(offset_h=14e3)}
    model, spec, work = rotor_blade_wide(), RotorSpec("r", names, 100, 1), Workspace()
    case = Case(spec, data, facts)
    state = update(model, spec, data, workspace=work)
    return Search(model, state, case, work, lambda *a: None)


def test_effects_that_leave_the_runs_together_are_held_at_their_end(search: Search) -> None:
    """Each alone has its room; where both would leave it, the gas stays at the runs' hottest."""
    both = with_effects(search.model, (FOULING, STEP), search.case.facts, {"elongation": 0.02})
    fouling, step = (p.prior for p in both.network.parameters if p.prior.sd in (0.04, 0.02))
    gas = next(p.prior for p in both.network.parameters if p.name == "t1t_rate")
    assert gas.high + fouling.high + step.high > 1.045
    made = search.calibrated((FOULING, STEP))
    assert made is not None
    assert all(d.held for d in made.model.network.drifts)
    assert made.state.meta["sealed"]


def test_a_search_gives_an_effect_the_room_of_the_readings(search: Search) -> None:
    """Read to 21,000 h, when a coating has lost 0.42 of what it loses by 50,000 h: the runs would
    have 1.24, and four times the expected size is less. The whole prior has 0.95."""
    wear = Cell(FAMILY["coating wear"], "linear", "blade", "B1")
    assert search.case.read_h == {"B1": 21e3, "B2": 21e3}
    made = search.calibrated((wear,))
    assert made is not None
    prior = made.model.network.parameter(wear.name).prior
    assert prior.high == pytest.approx(4 * 0.25)


@pytest.mark.parametrize(("hour", "given"), [(21e3, None), (9e4, None), (9e4, 0.7), (9e4, 1.3)])
def test_blades_that_an_effect_takes_out_of_the_runs_while_they_are_read_are_told(
    search: Search, hour: float, given: float | None
) -> None:
    """As often as their particles leave them; of blades without the effect nothing is."""
    wear = Cell(FAMILY["coating wear"], "linear", "blade", "B1")
    made = search.calibrated((wear,))
    assert made is not None
    posterior = blade_posterior(made.state.meta, made.state.arrays.__getitem__, "B1")
    x = posterior.column("tbc_thickness") if given is None else given
    share = min(hour / 5e4, UNTIL)
    left = x * (1.0 - posterior.column(wear.name) * share) < 0.4
    held = float(posterior.particles.w @ left)
    known = None if given is None else {"B1": {"tbc_thickness": given}}
    found = held_by(made.model, posterior, "B1", "tbc_thickness", hour, (known or {}).get("B1"))
    assert found == pytest.approx(held, abs=1e-12)
    if given is None:
        told = while_read(wear.name, made.model, made.state, {"B1": hour, "B2": 1.5e5})
        assert (told is None) == (held < 0.05)
        assert told is None or f"{wear.name} takes {held:.1f} of 1 blades to the end" in told
        assert while_read(wear.name, made.model, made.state, {"B2": 1.5e5}) is None


def test_an_effect_that_is_held_while_it_is_read_has_no_room(search: Search) -> None:
    """Its amplitude may stand far from the end of its own prior."""
    wear = Cell(FAMILY["coating wear"], "linear", "blade", "B1")
    made = search.calibrated((wear,))
    assert made is not None
    spec = replace(search.case.spec, known={"B1": {"tbc_thickness": 0.42}})
    cases = search.case, replace(search.case, spec=spec)
    usual, thin = (_end(wear, search.model, case, made) for case in cases)
    assert usual is None
    assert thin is not None
    assert thin.startswith("coating wear (blade B1) takes ")
    assert thin.endswith("before their last reading, no room: the runs end there")


def test_where_a_pair_has_no_room_each_of_the_two_is_tried(
    search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However little the scan gives it alone."""
    scan = search.case.scan(search.model, search.state)
    pair = tuple(
        next(i for i, c in enumerate(scan.cells) if (c.name, c.shape) == (one.name, one.shape))
        for one in (FOULING, STEP)
    )
    names = tuple(scan.cells[i].name for i in pair)
    only = [Hypothesis(pair, names, 20.0, 1.0)]
    made = adopt.with_effects

    def narrow(model: Model, cells: Sequence[Cell], *given: Any) -> Model:
        if len(cells) == 2:
            raise InputError("effects", 2, "find no room together", "")
        return made(model, cells, *given)

    monkeypatch.setattr(sys.modules[Search.__module__], "with_effects", narrow)
    search.known.clear()
    monkeypatch.setattr(sys.modules[Search.__module__], "weighed_all", lambda *a, **k: only)
    monkeypatch.setattr(sys.modules[Search.__module__], "SIBLINGS", 0)
    nothing = Rival((), search.model, lambda: search.state, 0.0)
    turn = search.turn(scan, nothing)
    assert names in search.refused
    assert set(turn.rivals) == {(name,) for name in names}


def drift(course: list[tuple[float, float]], moved: str, how: How = "plus") -> Drift:
    return Drift("effect", moved, Course.of([(0.0, 0.0), *course]), how)


@pytest.mark.parametrize(
    ("one", "room"),
    [
        # asleep at 1 in runs of 0.85 … 1.1: 0.1 of room above, 0.15 below
        (drift([(1e4, 1.0)], "cooling_flow"), (-0.15, 0.1)),
        (drift([(1e4, -1.0)], "cooling_flow"), (-0.1, 0.15)),
        (drift([(1e4, 2.0)], "cooling_flow"), (-0.075, 0.05)),
        (drift([(1e4, -1.0), (2e4, 2.0)], "cooling_flow"), (-0.075, 0.05)),
        # asleep at 0.62 in runs of 0.52 … 0.72
        (drift([(1e4, -1.0)], "gas_profile_peak", "times"), (-0.1 / 0.62, 0.1 / 0.62)),
        # anywhere in 2/3 … 4/3, in runs of 0.4 … 4/3: the thin ones bind, and none grows
        (drift([(1e4, -1.0)], "tbc_thickness", "times"), (0.0, 0.4)),
        (drift([(1e4, -1.0)], "tbc_thickness"), (0.0, 2 / 3 - 0.4)),
        # what it would become after the runs' 150,000 h counts for nothing: there is no such blade
        (drift([(1.5e5, -1.0), (1.8e5, -1.2)], "tbc_thickness", "times"), (0.0, 0.4)),
        (drift([(1.5e5, -0.5), (1.5e5, -1.0)], "tbc_thickness", "times"), (0.0, 0.4)),
        # anywhere in 0.8 … 1.0, in runs of 0.78 … 1.045
        (drift([(1e4, 1.0)], "t1t_rate"), (-0.02, 0.045)),
    ],
)
def test_an_amplitude_keeps_its_input_inside_the_runs_over_the_whole_prior(
    one: Drift, room: tuple[float, float]
) -> None:
    assert room_of(rotor_blade_wide(), one, -10.0, 10.0, 0.05) == pytest.approx(room, abs=1e-9)


@pytest.mark.parametrize(
    ("read_h", "blades", "room"),
    [
        ({"B1": 2.5e4, "B2": 1e4}, None, 1.04),  # half of it by then, from 5 / 6 to 0.4
        ({"B1": 2.5e4, "B2": 1e4}, ("B2",), 2.6),
        ({"B1": 2.5e4, "B2": 1e4}, ("B3",), 10.0),  # never read
        ({"B1": 9e4}, None, 0.52),
        ({"B1": 9e5}, None, 0.52),
    ],
)
def test_while_it_is_read_the_middle_half_of_blades_stays_inside_and_later_it_is_held(
    read_h: dict[str, float], blades: tuple[str, ...] | None, room: float
) -> None:
    one = replace(drift([(5e4, -1.0)], "tbc_thickness", "times"), blades=blades)
    found = room_of(rotor_blade_wide(), one, 0.0, 10.0, 0.25, read_h)
    assert found == pytest.approx((0.0, room))


def test_without_room_for_the_whole_prior_the_middle_half_of_it_does_not_help() -> None:
    """The narrow model's runs end where its prior does, whatever most blades would allow."""
    one = drift([(5e4, -1.0)], "tbc_thickness", "times")
    with pytest.raises(InputError, match=r"tbc_thickness.* finds no room: its runs, 0.666667"):
        room_of(rotor_blade(), one, 0.0, 10.0, 0.25, {"B1": 2.5e4})


def test_what_the_blades_share_keeps_the_whole_of_its_prior_inside() -> None:
    one = drift([(5e4, 1.0)], "t1t_rate")
    assert room_of(rotor_blade_wide(), one, 0.0, 10.0, 0.02, {"B1": 2.5e4})[1] == pytest.approx(
        0.09
    )


def test_by_the_rotor_s_hours_each_blade_s_last_reading_counts() -> None:
    """0.045 of room; s is 0.5 at the last reading of the old blade, 0.6 at that of the young."""
    course = Course.of([(0.0, 0.0), (1e5, 1.0)])
    one = Drift("effect", "t1t_rate", course, since=(("old", 0.0), ("young", 2e4)))
    found = room_of(rotor_blade_wide(), one, 0.0, 10.0, 0.01, {"old": 5e4, "young": 4e4})
    assert found[1] == pytest.approx(0.045 / 0.6)


def test_by_the_rotor_s_hours_the_youngest_blade_s_last_hour_counts() -> None:
    """0.045 of room above: s is 1.4 where its 150,000 h end, after 170,000 h of the rotor."""
    course = Course.of([(0.0, 0.0), (1.5e5, 1.0), (1.7e5, 1.4), (1.9e5, 1.8)])
    one = Drift("effect", "t1t_rate", course, since=(("young", 2e4),))
    assert room_of(rotor_blade_wide(), one, 0.0, 10.0, 0.01)[1] == pytest.approx(0.045 / 1.4)


def test_room_that_the_runs_have_beyond_what_was_asked_is_not_given() -> None:
    one = drift([(1e4, 1.0)], "cooling_flow")
    assert room_of(rotor_blade_wide(), one, -0.01, 0.02, 0.05) == (-0.01, 0.02)


def test_an_effect_with_less_room_than_a_fifth_of_its_size_is_refused() -> None:
    """Room on the side that physics does not take counts for nothing: 0.1 above, 0.15 below."""
    model, one = rotor_blade_wide(), drift([(1e4, 1.0)], "cooling_flow")
    assert room_of(model, one, -9.0, 9.0, 0.499)[1] == pytest.approx(0.1)
    with pytest.raises(InputError, match=r"cooling_flow.* finds no room: its runs, 0.85 … 1.1"):
        room_of(model, one, -9.0, 9.0, 0.501)
    with pytest.raises(InputError, match=r"finds no room: .* a narrower prior of cooling_flow"):
        room_of(model, one, 0.09, 9.0, 0.06)
    with pytest.raises(InputError, match=r"hold amplitudes of -0.15 … 0, where 0.06 is expected"):
        room_of(model, one, -9.0, -0.0, 0.06)


@pytest.mark.parametrize(
    ("sign", "size", "shape", "bounds"),
    [
        (0, 0.1, "constant", (-0.4, 0.4)),
        (0, 0.3, "constant", (-0.8, 1.2)),
        (0, 0.2, "linear", (-0.8 / 1.2, 0.8)),
        (-1, 0.3, "constant", (0.0, 0.8)),
        (-1, 0.3, "late", (0.0, 0.8 / 1.4)),
        (1, 2.0, "step", (0.0, 4.0)),
    ],
)
def test_a_gain_takes_four_fifths_of_a_reading_at_most_whatever_its_sign_and_course(
    sign: int, size: float, shape: Any, bounds: tuple[float, float]
) -> None:
    """One that was lost, or grew, was bounded as if it were added and constant: the network refused
    what was left of a reading, and the effect was said to have no room."""
    family = replace(FAMILY["instrument gain"], sign=sign, size=size, shapes=(shape,))
    cell = Cell(family, shape, "instrument", "LE-1", 9e3 if shape == "step" else None)
    model = with_effects(rotor_blade_wide(), [cell], {"B1": Facts()}, {"elongation": 0.02})
    prior = model.network.parameter("instrument gain (instrument LE-1)").prior
    assert (prior.low, prior.high) == pytest.approx(bounds)


@pytest.mark.parametrize(("whom", "lasting"), [("instrument", False), ("blade", True)])
def test_what_an_instrument_reads_wrong_is_no_blade_s_whatever_its_kind(
    whom: Any, lasting: bool
) -> None:
    """It could not enter a model, and shared the evidence with what could."""
    family = replace(FAMILY["instrument offset"], kind="operation", whom=(whom,))
    cell = Cell(family, "constant", whom, "B1")
    model = with_effects(rotor_blade_wide(), [cell], {"B1": Facts()}, {"elongation": 0.02})
    assert [one.lasting for one in model.network.biases] == [lasting]


def test_an_input_that_no_run_varied_has_noroom_of() -> None:
    with pytest.raises(InputError, match="is no input of the runs"):
        room_of(rotor_blade_wide(), drift([(1e4, 1.0)], "slot"), -1.0, 1.0, 0.1)


def test_a_formula_has_no_runs_to_stay_in() -> None:
    model = Model(creep_specimens.network(), creep_specimens.formula())
    with pytest.raises(InputError, match="needs simulation runs"):
        room_of(model, drift([(1e4, 1.0)], model.input_names[0]), -1.0, 1.0, 0.1)


def test_a_posterior_that_cannot_be_computed_refuses_that_hypothesis_alone(
    search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rotor's calibration says so in its own words; the diagnosis goes on."""

    def past(*given: object, **named: object) -> object:
        raise CalibrationError("64 boxes are not enough", event=None)

    monkeypatch.setattr(sys.modules[Search.__module__], "begun", past)
    wear = Cell(FAMILY["coating wear"], "linear", "blade", "B1")
    assert search.calibrated((wear,)) is None
    assert "64 boxes" in search.refused[(wear.name,)]
