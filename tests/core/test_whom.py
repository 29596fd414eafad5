"""Effects that concern some blades, by clocks of their own: drifts, biases and their network."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from core.course import Course
from core.drift import ITSELF, Bias, Drift
from core.errors import InputError
from core.network import Network, Parameter
from core.prior import Prior
from core.quantity import Quantity

RAMP = Course.of([(0.0, 0.0), (10_000.0, -1.0)])
WEAR = Drift("wear", "coating", RAMP, "times")
ZERO = Bias("zero", "elongation", Course.of(1.0))


def test_a_drift_of_all_blades_by_their_own_hours_is_every_blades_as_it_is() -> None:
    assert WEAR.of_blade("B1") is WEAR


def test_a_drift_of_some_blades_is_nothing_to_the_others() -> None:
    one = replace(WEAR, blades=("B2", "B3"))
    assert one.of_blade("B1") is None
    own = one.of_blade("B3")
    assert own is not None
    assert (own.name, own.input, own.how, own.blades) == ("wear", "coating", "times", None)
    assert own.shape == RAMP
    assert own == one.of_blade("B2")


def test_a_drift_by_the_rotors_hours_is_where_the_rotor_is_when_the_blade_counts_zero() -> None:
    """B2 joined at hour 4000 of the rotor: at 3000 h of its own the rotor has 7000."""
    one = replace(WEAR, since=(("B2", 4000.0),))
    joined, first = one.of_blade("B2"), one.of_blade("B1")
    assert joined is not None
    assert first is not None
    assert joined.shape.at(3000.0) == pytest.approx(-0.7, abs=1e-12)
    assert joined.shape.at(0.0) == pytest.approx(-0.4, abs=1e-12)
    assert first.shape.at(3000.0) == pytest.approx(-0.3, abs=1e-12), "not named: from 0"


def test_a_blades_own_drift_stays_as_it_is_when_it_is_asked_again() -> None:
    """Its clock was told already, also where it was told to be zero."""
    own = replace(WEAR, since=(("B2", 4000.0),)).of_blade("B2")
    assert own is not None
    assert own.since == ((ITSELF, 0.0),)
    assert own.of_blade("B2") == own


def test_only_by_the_rotors_hours_may_a_shape_begin_with_a_value() -> None:
    begun = RAMP.shifted(4000.0)
    with pytest.raises(InputError, match="does not start from 0"):
        Drift("wear", "coating", begun)
    late = Course.of([(100.0, 1.0), (200.0, 2.0)])  # 1 before its first point, too
    with pytest.raises(InputError, match="does not start from 0"):
        Drift("wear", "coating", late)
    assert Drift("wear", "coating", begun, since=(("B2", 1.0),)).shape == begun
    assert Drift("wear", "coating", Course.of(0.5)).shape.constant


@pytest.mark.parametrize(
    "one",
    [
        WEAR,
        replace(WEAR, blades=("B2",)),
        replace(WEAR, since=(("B1", 0.0), ("B2", 4000.0))),
        replace(WEAR, blades=()),
    ],
)
def test_whom_a_drift_concerns_goes_through_json(one: Drift) -> None:
    told = json.loads(json.dumps(one.to_json()))
    assert Drift.from_json(told) == one
    assert ("blades" in told, "since" in told) == (one.blades is not None, bool(one.since))


@pytest.mark.parametrize(
    ("own", "reading", "share"),
    [
        ((None, None), ("scanner", "c1"), 0.5),
        (("scanner", None), ("scanner", "c1"), 0.5),
        (("scanner", None), ("gauge", "c1"), 0.0),
        (("scanner", None), (None, None), 0.0),
        ((None, "c1"), (None, "c1"), 0.5),
        ((None, "c1"), ("scanner", "c2"), 0.0),
        (("scanner", "c1"), ("scanner", "c2"), 0.0),
        (("scanner", "c1"), ("gauge", "c1"), 0.0),
        (("scanner", "c1"), ("scanner", "c1"), 0.5),
    ],
)
def test_a_bias_is_of_readings_of_its_instrument_and_its_campaign(
    own: tuple[str | None, str | None], reading: tuple[str | None, str | None], share: float
) -> None:
    shape = Course.of([(0.0, 0.0), (8000.0, 1.0)])
    one = Bias("zero", "elongation", shape, instrument=own[0], campaign=own[1])
    assert one.share(4000.0, *reading) == share


def test_a_bias_of_some_blades_by_the_rotors_hours_is_the_blades_own() -> None:
    shape = Course.of([(6000.0, 0.0), (6000.0, 1.0)])
    one = Bias("rub", "elongation", shape, blades=("B2",), since=(("B2", 4000.0),), lasting=True)
    assert one.of_blade("B1") is None
    own = one.of_blade("B2")
    assert own is not None
    assert (own.blades, own.since, own.lasting) == (None, (), True)
    assert [own.share(hour, None, None) for hour in (1999.0, 2000.0)] == [0.0, 1.0]
    assert own.of_blade("B2") == own, "it is counted from its zero once"


@pytest.mark.parametrize("whose", [{"instrument": "scanner"}, {"campaign": "c1"}])
def test_what_lasts_is_the_blades_and_no_instruments(whose: dict[str, str]) -> None:
    with pytest.raises(InputError, match="cannot be of an instrument or a campaign"):
        replace(ZERO, lasting=True, **whose)
    assert replace(ZERO, lasting=True, blades=("B1",)).lasting


@pytest.mark.parametrize(
    ("one", "options"),
    [
        (ZERO, set()),
        (replace(ZERO, how="times", instrument="scanner", campaign="c1"),
         {"instrument", "campaign"}),
        (replace(ZERO, blades=("B2",), since=(("B2", 4000.0),), lasting=True),
         {"blades", "since", "lasting"}),
    ],
)  # fmt: skip
def test_a_bias_goes_through_json_and_tells_only_what_is_used(one: Bias, options: set[str]) -> None:
    told = json.loads(json.dumps(one.to_json()))
    assert Bias.from_json(told) == one
    assert told.keys() - {"name", "quantity", "shape", "how"} == options


@pytest.mark.parametrize("how", ["minus", ""])
def test_an_effect_is_added_or_multiplied(how: str) -> None:
    with pytest.raises(InputError, match="use plus or times"):
        replace(WEAR, how=how)
    with pytest.raises(InputError, match="use plus or times"):
        replace(ZERO, how=how)


def network(drifts: tuple[Drift, ...] = (), biases: tuple[Bias, ...] = ()) -> Network:
    prior = Prior("uniform", 0.5, 1.5)
    size = Prior("normal", 0.0, 0.4, 0.0, 0.1)
    own = tuple(Parameter(one.name, "shared", size) for one in (*drifts, *biases))
    noise = Prior("log_uniform", 1e-3, 0.2)
    return Network(
        "n",
        (Parameter("coating", "local", prior), *own),
        (Quantity("elongation", "mm", "scalar", noise, -5.0, 50.0),),
        drifts=drifts,
        biases=biases,
    )


def test_an_amplitude_that_is_added_has_the_unit_of_what_it_is_added_to() -> None:
    """It was told as a pure number in plans, exports, and reports of the next diagnosis."""
    cooled, gain = (
        replace(WEAR, name="cooling", how="plus"),
        replace(ZERO, name="gain", how="times"),
    )
    whole = network((WEAR, cooled), (ZERO, gain))
    coated = tuple(replace(p, unit="µm") if p.name == "coating" else p for p in whole.parameters)
    whole = replace(whole, parameters=coated)
    units = {p.name: whole.unit_of(p.name) for p in whole.parameters}
    assert units == {"coating": "µm", "wear": "1", "cooling": "µm", "zero": "mm", "gain": "1"}
    with pytest.raises(InputError, match="does not exist"):
        whole.unit_of("rub")


def test_a_network_of_effects_of_all_blades_is_every_blades() -> None:
    """A bias is made anew for every blade: equal, not only the same, must do."""
    one = network((WEAR,), (replace(ZERO, campaign="c1"),))
    assert one.for_blade("B1") is one


def test_a_blades_network_has_the_effects_that_concern_it_and_every_parameter() -> None:
    worn = replace(WEAR, blades=("B2", "B3"))
    rubbed = Bias("rub", "elongation", Course.of(1.0), blades=("B3",), lasting=True)
    whole = network((worn,), (ZERO, rubbed))
    names = {
        blade: tuple(e.name for e in (*own.drifts, *own.biases))
        for blade in ("B1", "B2", "B3")
        if (own := whole.for_blade(blade))
    }
    assert names == {"B1": ("zero",), "B2": ("wear", "zero"), "B3": ("wear", "zero", "rub")}
    for blade in names:
        assert whole.for_blade(blade).parameters == whole.parameters, "amplitudes are the rotor's"
        assert whole.for_blade(blade).quantities == whole.quantities
    assert whole.drifts == (worn,), "the rotor's own stays as it was"


def test_a_blades_network_runs_by_its_own_hours() -> None:
    whole = network((replace(WEAR, since=(("B2", 4000.0),)),))
    (first,), (joined,) = (whole.for_blade(blade).drifts for blade in ("B1", "B2"))
    assert first.shape.at(3000.0) == pytest.approx(-0.3, abs=1e-12)
    assert joined.shape.at(3000.0) == pytest.approx(-0.7, abs=1e-12)
    own = whole.for_blade("B2")
    assert own.for_blade("B2") is own
