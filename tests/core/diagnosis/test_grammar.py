"""Which cells a rotor's readings could tell of; users' own families; the rotor's clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.ages import undated
from core.diagnosis.adopt import _bounded, amplitude_of, typical_noise
from core.diagnosis.clock import of_no_day, readers, with_offsets
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import UNTIL, Cell, Facts, Readers, cells
from core.errors import InputError
from core.family import Family
from core.model import rotor_blade
from core.observation import Inspection

NOBODY = Readers({}, {}, (4000.0,), (4000.0,))
INPUTS = ("tbc_thickness", "t1t_rate", "creep_steady")


def names(blades: dict[str, Facts], who: Readers = NOBODY) -> set[str]:
    return {c.name for c in cells(FAMILIES, INPUTS, ["elongation"], blades, who)}


def test_only_what_readings_could_tell_of_is_listed() -> None:
    plain = names({"B1": Facts(), "B2": Facts()})
    assert "coating wear" in plain
    assert "fouling" in plain
    assert "cooling decline" not in plain  # these runs have no such input
    assert not any("lot" in n or "instrument" in n or "campaign" in n for n in plain)
    lots = names({"B1": Facts(coating_lot="C1"), "B2": Facts(coating_lot="C2")})
    assert {"coating wear (coating lot C1)", "coating wear (coating lot C2)"} <= lots
    two = replace(
        NOBODY, instruments={"elongation": ("a", "b")}, campaigns={"elongation": ("x", "y")}
    )
    assert {"instrument offset (instrument a)", "campaign offset (campaign y)"} <= names(
        {"B1": Facts(), "B2": Facts()}, two
    )
    alike = [replace(reading("B1", h, "x"), instrument="a") for h in (7990.0, 8010.0)]
    one = replace(readers(alike, {"B1": Facts()}), between_h=(4000.0,), ages_h=(4000.0,))
    assert names({"B1": Facts(), "B2": Facts()}, one) == plain
    some = [alike[0], reading("B1", 8010.0, None)]
    beside = names({"B1": Facts(), "B2": Facts()}, readers(some, {"B1": Facts()}))
    assert {"instrument offset (instrument a)", "campaign offset (campaign x)"} <= beside
    assert not any("None" in name for name in beside), "what has no name is no cell"


def test_who_read_something_else_has_no_offset_here() -> None:
    """A scanner of shapes is no third instrument of elongations, and no second one."""
    read = {name: replace(reading("B1", 8e3, "x"), instrument=name) for name in ("a", "b", "c")}
    shape = replace(read["c"], quantity="deformation")
    blades = {"B1": Facts(), "B2": Facts()}
    three = names(blades, readers([read["a"], read["b"], shape], {"B1": Facts()}))
    offsets = {n for n in three if n.startswith("instrument offset")}
    assert offsets == {f"instrument offset (instrument {n})" for n in ("a", "b")}
    two = names(blades, readers([read["a"], shape], {"B1": Facts()}))
    assert not any("instrument" in n for n in two)


def test_what_grows_has_its_size_inside_the_models_hours_and_runs_alike_when_it_is_calibrated() -> (
    None
):
    """In a model of 5,000 h, and beyond the hours up to which anything is known of wear."""
    family = next(f for f in FAMILIES if f.shapes == ("early", "linear", "late"))
    blades = {"B1": Facts(coating_lot="C1"), "B2": Facts(coating_lot="C2")}
    few = [
        c
        for c in cells([family], INPUTS, ["elongation"], blades, NOBODY, 5000.0)
        if c.shape == "linear"
    ]
    many = [
        c
        for c in cells([family], INPUTS, ["elongation"], blades, NOBODY, 2e5)
        if c.shape == "linear"
    ]
    hours = np.array([2500.0, 5000.0, 1e5])
    assert few[0].course.at(hours) == pytest.approx([0.5, 1.0, UNTIL])
    assert many[0].course.at(10 * hours) == pytest.approx([0.5, 1.0, UNTIL])
    for cell in (few[0], many[0], replace(many[0], shape="late")):
        at = np.linspace(0.0, 3e5, 400)
        assert np.array_equal(_bounded(cell, -1).at(at), -cell.course.at(at))
    assert amplitude_of(few[0]).endswith("by 5,000 h")


@pytest.mark.parametrize(
    ("family", "said"),
    [
        ("tip rub", "lost from elongation"),
        ("cooling blockage", "lost from cooling_flow"),
        ("coating spallation", "lost of tbc_thickness"),
        ("root settling", "added to elongation"),
    ],
)
def test_what_is_lost_is_not_said_to_be_added(family: str, said: str) -> None:
    own = next(f for f in FAMILIES if f.name == family)
    assert amplitude_of(Cell(own, "step", "blade", "B1", 9e3)) == said


def test_a_step_is_tried_between_all_inspections() -> None:
    who = replace(NOBODY, between_h=(4000.0, 12000.0))
    found = cells(FAMILIES, INPUTS, ["elongation"], {"B1": Facts()}, who)
    hours = {c.step_h for c in found if c.family.name == "firing temperature step"}
    assert hours == {4000.0, 12000.0}


def test_shapes_are_nothing_at_the_start_and_of_the_order_of_one_at_the_reference() -> None:
    for shape in ("early", "linear", "late"):
        course = Cell(FAMILIES[0], shape, "all").course
        assert course.at(0.0) == 0.0
        assert course.at(50_000.0) == pytest.approx(1.0)
        assert np.all(np.diff(course.at(np.linspace(0, 60_000, 13))) > 0)
    early, late = (Cell(FAMILIES[0], s, "all").course.at(25_000.0) for s in ("early", "late"))
    assert early > 0.5 > late
    step = Cell(FAMILIES[1], "step", "blade", "B1", 9000.0).course
    assert (step.at(8999.0), step.at(9000.0)) == (0.0, 1.0)


def test_families_are_data() -> None:
    for family in FAMILIES:
        assert Family.from_json(family.to_json()) == family
    assert len({f.name for f in FAMILIES}) == len(FAMILIES)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"shapes": ("sometimes",)}, "shapes of the effect"),
        ({"whom": ()}, "whom of the effect"),
        ({"size": None}, "size of the effect"),
        ({"size": -1.0}, "is not positive"),
        ({"whom": ("campaign",)}, "concerns readings, not an input"),
        ({"sign": 2}, "sign of the effect"),
    ],
)
def test_a_family_that_is_none_is_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        replace(FAMILIES[0], **changes)  # type: ignore[arg-type]


def test_a_family_told_in_other_words_is_refused() -> None:
    told = FAMILIES[0].to_json()
    for wrong in ({**told, "colour": "red"}, {k: v for k, v in told.items() if k != "whom"}):
        with pytest.raises(InputError, match="is no effect"):
            Family.from_json(wrong)


def reading(blade: str, time_h: float, campaign: str | None) -> Inspection:
    return Inspection(f"{blade}{time_h}", blade, "elongation", time_h, [0.1], campaign=campaign)  # type: ignore[arg-type]


def test_campaigns_tell_when_a_blade_came() -> None:
    data = [
        reading("old", 8000, "c1"), reading("old", 16000, "c2"),
        reading("new", 8000, "c2"), reading("told", 100, "c1"),
    ]  # fmt: skip
    blades = {"old": Facts(), "new": Facts(), "told": Facts(), "unread": Facts()}
    found = with_offsets(blades, data, {"told": 500.0})
    assert {b: f.offset_h for b, f in found.items()} == {
        "old": 0.0, "new": 8000.0, "told": 500.0, "unread": 0.0,
    }  # fmt: skip


def test_inspections_of_one_visit_are_one() -> None:
    data = [reading("a", h, None) for h in (7990, 8000, 16000, 16010)]
    who = readers(data, {"a": Facts()})
    assert len(who.between_h) == 2
    assert 0 < who.between_h[0] < 7990 < who.between_h[1] < 16000


def test_no_step_is_tried_before_blades_that_were_read_when_they_were_new() -> None:
    """There is no hour before hour 0. A step at 0 concerned nobody, as an event, or could not be
    calibrated, and kept its share of the evidence."""
    new = [reading(b, h, None) for b in "ab" for h in (0, 8000, 16000)]
    facts = {"a": Facts(), "b": Facts(offset_h=8e3)}
    who = readers(new, facts)
    assert who.ages_h == (4000.0, 12_000.0)
    assert who.between_h == (4000.0, 12_000.0, 20_000.0)
    assert readers(new[:1], facts).ages_h == ()


def test_a_step_is_tried_between_hours_of_its_own_clock() -> None:
    """Both blades were read at the ages of 4,000 and 8,000 h; one of them joined at 20,000 h."""
    data = [reading(b, h, None) for b in ("old", "new") for h in (4000, 8000)]
    facts = {"old": Facts(coating_lot="C1"), "new": Facts(coating_lot="C2", offset_h=20e3)}
    who = readers(data, facts)
    assert who.between_h == (2000.0, 6000.0, 16_000.0, 26_000.0)
    assert who.ages_h == (2000.0, 6000.0)
    inputs = ["tbc_thickness", "t1t_rate"]
    steps: dict[str, set[float | None]] = {}
    for one in cells(FAMILIES, inputs, ["elongation"], facts, who):
        if one.shape == "step":
            steps.setdefault(one.family.clock, set()).add(one.step_h)
    assert steps["blade"] == set(who.ages_h)
    assert steps["rotor"] == steps["event"] == set(who.between_h)


def test_the_campaign_with_the_oldest_blade_tells_when_a_blade_came() -> None:
    """`new` was mostly read in campaigns without an old one, `last` with none but `new`."""
    data = [
        reading("old", 20_000, "c3"),
        reading("new", 2000, "c1"), reading("new", 4000, "c2"), reading("new", 8000, "c3"),
        reading("new", 9000, "c4"), reading("last", 1000, "c4"),
    ]  # fmt: skip
    found = with_offsets({b: Facts() for b in ("old", "new", "last")}, data, {})
    assert [found[b].offset_h for b in ("old", "new", "last")] == [0.0, 12_000.0, 20_000.0]


def test_blades_that_are_linked_by_others_alone_are_dated_along_the_whole_chain() -> None:
    """Each joined where the one before was last read."""
    data = [
        reading("a", 24_000, "c1"), reading("b", 8000, "c1"),
        reading("b", 18_000, "c2"), reading("c", 2000, "c2"),
        reading("c", 12_000, "c3"), reading("d", 2000, "c3"),
    ]  # fmt: skip
    found = with_offsets({b: Facts() for b in "abcd"}, data, {})
    assert [found[b].offset_h for b in "abcd"] == [0.0, 16_000.0, 32_000.0, 42_000.0]


def test_a_name_under_which_a_blade_was_read_years_apart_is_no_day() -> None:
    """All readings of a gauge under one label: nobody joined late."""
    data = [reading("a", 8000, "gauge"), reading("a", 16_000, "gauge"), reading("b", 8000, "gauge")]
    found = with_offsets({b: Facts() for b in "ab"}, data, {})
    assert [found[b].offset_h for b in "ab"] == [0.0, 0.0]
    near = [reading("a", 8000, "c"), reading("a", 8040, "c"), reading("b", 2000, "c")]
    found = with_offsets({b: Facts() for b in "ab"}, near, {})
    assert found["b"].offset_h == pytest.approx(6040.0), (
        "negative control: nearly one hour is a day"
    )


def regular(*more: Inspection) -> list[Inspection]:
    """Three blades, of which two joined at 7,000 and 14,000 h, in four campaigns; and more."""
    came = {"old": 0, "mid": 7000, "new": 14_000}
    days = [(k, 21_000 + 7000 * k) for k in range(4)]
    return [*(reading(b, h - c, f"c{k}") for k, h in days for b, c in came.items()), *more]


CAME = {"old": 0.0, "mid": 7000.0, "new": 14_000.0}


def offsets(data: list[Inspection]) -> dict[str, float]:
    return {b: f.offset_h for b, f in with_offsets({b: Facts() for b in CAME}, data, {}).items()}


def test_a_campaign_that_contradicts_the_others_dates_nobody() -> None:
    """Blades of other ages, read at one hour of their own under one name: each round of asking set
    the rotor's hours 14,000 h later."""
    odd = [reading("old", 24_000, "scan"), reading("new", 24_000, "scan")]
    assert offsets(regular(*odd)) == offsets(regular(*odd[::-1])) == offsets(regular()) == CAME
    assert undated(regular(*odd)) == ("scan",)
    assert "when campaign scan was is not known" in of_no_day(regular(*odd))[0]
    mistyped = ("mid", "c2")
    wrong = [replace(r, time_h=1e3) if (r.blade, r.campaign) == mistyped else r for r in regular()]
    assert offsets(wrong) == CAME, "an hour that was mistyped"
    assert undated(wrong) == ("c2",)
    near = [reading("old", 24_000, "scan"), reading("new", 10_300, "scan")]
    assert undated(regular(*near)) == of_no_day(regular(*near)) == ()
    assert offsets(regular(*near))["new"] == pytest.approx(14_000, abs=300)


def test_of_two_campaigns_that_contradict_each_other_neither_is_believed() -> None:
    data = [
        reading("old", 20_000, "c1"), reading("new", 2000, "c1"),
        reading("old", 30_000, "c2"), reading("new", 29_000, "c2"),
    ]  # fmt: skip
    assert undated(data) == ("c1", "c2")
    assert offsets(data)["new"] == 0.0
    more = [*data, reading("mid", 10_000, "c2")]
    assert undated(more) == ("c1",), "the other has more blades"
    assert offsets(more) == {"old": 0.0, "mid": 20_000.0, "new": 1000.0}


def test_a_noise_that_readings_state_is_the_one_that_offsets_are_sized_by() -> None:
    model = rotor_blade()
    stated = [
        replace(reading("a", 8000, None), id=f"i{k}", sigma=s)
        for k, s in enumerate((0.08, 0.1, 0.3))
    ]
    assert typical_noise(model, {}, stated)["elongation"] == pytest.approx(0.1)
    middle = typical_noise(model, {})["elongation"]
    assert middle < 0.05, "negative control: the prior's middle"
    assert typical_noise(model, {"sigma_obs.elongation": 0.02}, stated)["elongation"] == 0.02
