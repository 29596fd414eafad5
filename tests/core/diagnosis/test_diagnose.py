"""The whole loop on a model whose posterior and evidence are known exactly.

y = 0.8 s + 1.3 l_0 − 0.7 t l_1 + bend t², where `bend` is dormant at 0 and declared as something
that the model may lack. Readings are made with it, without it, and with it in every second blade.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from core.calibration.online import RotorSpec, Workspace, update
from core.calibration.start import Start
from core.calibration.state import shared_posterior
from core.diagnosis import Case, Diagnosis, Facts, diagnose, to_json
from core.diagnosis import diagnose as module_function
from core.diagnosis.adopt import amplitude, frees, with_effects
from core.diagnosis.conclude import Rival, Turn
from core.diagnosis.families import FAMILIES, families_for
from core.diagnosis.grammar import Cell
from core.diagnosis.hypotheses import Hypothesis
from core.diagnosis.leaving import without_open
from core.diagnosis.pictures import pictures
from core.diagnosis.placebos import Placebo
from core.diagnosis.search import Search
from core.diagnosis.verdict import LEFT
from core.errors import InputError
from core.family import Family
from core.model import Model
from core.network import Network, Parameter
from core.observation import Inspection
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel
from tests.core.calibration.test_exact import SLOPES, conjugate

BEND = Family(
    "bend", "answers grow with the square of time", "input", "bend", "plus", 0.3, 1,
    ("constant",), ("all",), "blade", "material",
)  # fmt: skip
OFFSET = Family(
    "offset", "an instrument reads too much or too little", "reading", "y", "plus", None, 0,
    ("constant",), ("instrument",), "rotor", "sensor",
)  # fmt: skip
TIMES, SIGMA, BLADES = (0.4, 0.8, 1.2, 1.6, 2.0), 0.1, 16
SPEC = RotorSpec("r", tuple(f"b{b:02d}" for b in range(BLADES)), 1000, 3)


def bent() -> Model:
    base = conjugate(2)

    def formula(x: np.ndarray, t: float) -> np.ndarray:
        return base.surrogate.formulas["y"](x[:, :3], t) + x[:, 3] * t**2  # type: ignore[union-attr]

    asleep = Parameter("bend", "dormant", Prior("uniform", -2.0, 2.0), nominal=0.0)
    network = replace(
        base.network,
        parameters=(*base.network.parameters, asleep),
        families=(BEND, OFFSET),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in network.parameters)
    return Model(network, FormulaModel(inputs, {"y": formula}, "bent"))


MODEL = bent()


def readings(effect: Callable[[int, float], float], seed: int = 4) -> tuple[Inspection, ...]:
    rng = np.random.default_rng(seed)
    s, out = rng.normal(2.0, 0.5), []
    for b in range(BLADES):
        l0, l1 = rng.normal(-1.0, 0.6), rng.normal(0.0, 0.6)
        for i, t in enumerate(TIMES):
            y = 0.8 * s + SLOPES[0] * l0 + SLOPES[1] * t * l1 + effect(b, t)
            y += SIGMA * rng.normal()
            gauge = f"gauge {(b + i) % 2}"
            at = (f"{b}-{i}", f"b{b:02d}", "y", t, np.array([y]))
            own = Inspection(*at, sigma=SIGMA, instrument=gauge)
            out.append(own)
    return tuple(out)


def found(data: tuple[Inspection, ...], model: Model = MODEL) -> Diagnosis:
    work = Workspace()
    state = update(model, SPEC, data, workspace=work)
    case = Case(SPEC, data, {b: Facts() for b in SPEC.blades}, dealt=199)
    return diagnose(model, state, case, workspace=work)


def exact_bend(data: tuple[Inspection, ...]) -> tuple[float, float]:
    """Mean and sd of the bend under a flat prior, all else integrated out."""
    names = ["s", "bend", *[f"{p}{b}" for b in range(BLADES) for p in "lm"]]
    prior = np.diag([0.25, 1e6, *[0.36] * (2 * BLADES)])
    mean = np.array([2.0, 0.0, *[-1.0, 0.0] * BLADES])
    x = np.zeros((len(data), len(names)))
    for row, r in enumerate(data):
        b = int(r.blade[1:])
        x[row, :2] = 0.8, r.time_h**2
        x[row, 2 + 2 * b : 4 + 2 * b] = SLOPES[0], SLOPES[1] * r.time_h
    y = np.array([r.values[0] for r in data])
    precision = np.linalg.inv(prior) + x.T @ x / SIGMA**2
    covariance = np.linalg.inv(precision)
    centre = mean + covariance @ x.T @ (y - x @ mean) / SIGMA**2
    return float(centre[1]), float(np.sqrt(covariance[1, 1]))


def test_a_dormant_input_that_acts_is_named_woken_and_sized_as_the_exact_posterior_has_it() -> None:
    data = readings(lambda b, t: 0.25 * t**2)
    one = found(data)
    assert (one.verdict.word, one.verdict.names) == ("effect", ("bend",))
    mean, sd = exact_bend(data)
    (effect,) = one.effects
    assert effect.mean == pytest.approx(mean, abs=0.1 * sd)
    assert effect.sd == pytest.approx(sd, rel=0.1)
    assert one.after[0].network.parameter("bend").level == "shared"
    assert one.after[0].network.parameter("bend").prior.low == 0.0
    assert one.verdict.held
    assert all(h.agrees for h in one.verdict.held)
    case = Case(SPEC, data, {b: Facts() for b in SPEC.blades})
    told = to_json(one, case, None, pictures(one, case))
    assert told["claimed"] is True
    assert {one["by"] for one in told["placebos"]} == {"other blades", "other readings"}
    assert all(one["stands"] and one["effect"] == "bend" for one in told["placebos"])
    (drawn,) = told["pictures"]["amplitudes"]
    assert drawn["name"] == "bend"
    assert drawn["quantiles"][0] < effect.mean < drawn["quantiles"][-1]
    assert told["effects"][0]["amplitude"]["mean"] == effect.mean


def test_without_it_nothing_is_missing() -> None:
    one = found(readings(lambda b, t: 0.0))
    assert one.verdict.word == "adequate"
    assert one.after == one.before


def test_courses_are_of_blades_on_the_rotor_with_the_hours_at_which_each_was_read_last() -> None:
    """A blade has left; another was read last by a scan, which is no row of the pictures."""
    data = readings(lambda b, t: 0.0)
    one = found(data)
    facts = {b: Facts() for b in SPEC.blades}
    case = Case(SPEC, data, facts, dealt=199, serving=SPEC.blades[1:])
    case.__dict__["read_h"] = {**case.read_h, "b01": 2.5}
    told = pictures(one, case)["courses"]
    assert told["blades"] == list(SPEC.blades[1:])
    assert told["now_h"] == [2.5, *[TIMES[-1]] * (BLADES - 2)]
    assert len(told["before"]["mean"]) == BLADES - 1
    steps = np.diff(told["time_h"])
    assert np.all(np.diff(steps) > 0), "fine where creep is fast"
    assert told["time_h"][-1] == pytest.approx(MODEL.surrogate.horizon_h)
    everybody = pictures(one, replace(case, serving=()))["courses"]
    assert everybody["before"]["mean"][1:] == told["before"]["mean"]


def test_what_only_half_of_the_blades_have_is_not_given_the_name_of_what_all_have() -> None:
    one = found(readings(lambda b, t: 0.5 * t**2 * (b % 2), seed=5))
    assert one.first.word != "adequate"
    assert one.verdict.word == "unattributed"
    assert any("two halves of the blades" in why for why in one.verdict.reasons)


def test_the_halves_are_what_refuses_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The control: without them the name would be given."""
    monkeypatch.setattr(Case, "halves", lambda *args: ())
    one = found(readings(lambda b, t: 0.5 * t**2 * (b % 2), seed=5))
    assert any(effect.cell.name == "bend" for effect in one.effects)


def test_a_claim_is_dropped_where_the_same_effect_at_other_blades_gains_as_much(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lost = Placebo("bend", "other blades", 190, 80, 9.0, 9.5)
    monkeypatch.setattr(Case, "placebos", lambda *given: (lost,))
    one = found(readings(lambda b, t: 0.25 * t**2))
    assert (one.verdict.word, one.verdict.names) == ("unattributed", ())
    assert one.verdict.reasons[0] == lost.told
    assert one.placebos == (lost,)


def test_the_verdict_follows_the_instruments_label_and_not_the_order_or_the_ids() -> None:
    data = readings(lambda b, t: 0.0)

    def off(label: str) -> tuple[Inspection, ...]:
        return tuple(
            replace(r, values=r.values + 0.3 * (r.instrument == label), id=f"x{i * 7919 % 1000}")
            for i, r in enumerate(reversed(data))
        )

    for label in ("gauge 0", "gauge 1"):
        one = found(off(label))
        assert one.verdict.word in ("effect", "not separable")
        named = {f"offset (instrument {label})"}
        # With two gauges one is too long or the other too short.
        assert one.verdict.names
        assert named <= set(one.verdict.names)
    again = found(tuple(sorted(off("gauge 1"), key=lambda r: r.values[0])))
    assert to_json(again, Case(SPEC, data, {})) == to_json(one, Case(SPEC, data, {}))


@pytest.mark.parametrize(("shift", "leaves"), [(0.0, True), (0.3, False)])
def test_what_could_not_be_told_apart_leaves_where_chance_explains_the_rest(
    shift: float, leaves: bool
) -> None:
    """An offset of either gauge, beside a bend that is sure; with 0.3 it is really there."""
    data = tuple(
        replace(r, values=r.values + shift * (r.instrument == "gauge 1"))
        for r in readings(lambda b, t: 0.25 * t**2)
    )
    work = Workspace()
    case = Case(SPEC, data, {b: Facts() for b in SPEC.blades}, dealt=199)
    search = Search(MODEL, update(MODEL, SPEC, data, workspace=work), case, work, lambda *a: None)
    bend = Cell(BEND, "constant", "all")
    offsets = [Cell(OFFSET, "constant", "instrument", f"gauge {k}") for k in (0, 1)]
    taken = search.calibrated((bend, offsets[0]))
    assert taken is not None
    sure = Turn((Hypothesis((0,), (bend.name,), 9.0, 1.0),), (bend.name,), {}, (bend,))
    names = [c.name for c in offsets]
    either = tuple(Hypothesis((i,), (n,), 9.0, 0.5) for i, n in enumerate(names))
    open_ = Turn(either, (names[0],), {}, tuple(offsets), (bend,))
    fewer = without_open(search, taken, [sure, open_])
    assert (fewer is not None) is leaves
    if fewer is not None:
        assert fewer.rest.effects == (bend,)
        assert fewer.p > LEFT
        assert fewer.told.startswith(names[0])
    told = replace(either[0], weight=0.95), replace(either[1], weight=0.05)
    assert without_open(search, taken, [sure, replace(open_, hypotheses=told)]) is None
    assert without_open(search, taken, [open_]) is None  # nothing is sure: it stays, and is said


@pytest.mark.parametrize(("more", "word"), [(0.0, "effect"), (0.3, "unattributed")])
def test_where_the_only_family_is_taken_what_is_left_is_asked_without_names(
    more: float, word: str
) -> None:
    """With `more`, all readings of the third visit are off by it, which no family could name."""
    alone = Model(replace(MODEL.network, families=(BEND,)), MODEL.surrogate)
    one = found(readings(lambda b, t: 0.5 * t**2 + more * (t == TIMES[2])), alone)
    assert [e.cell.name for e in one.effects] == ["bend"]
    assert one.verdict.word == word
    assert (one.verdict.after is not None and one.verdict.after <= LEFT) is (more > 0)
    nothing = Model(replace(MODEL.network, families=()), MODEL.surrogate)
    with pytest.raises(InputError, match="nothing to look for"):
        found(readings(lambda b, t: 0.0), nothing)


def test_a_networks_own_families_stand_in_for_the_built_in_ones_of_the_same_input() -> None:
    network = MODEL.network
    assert families_for(network)[-2:] == (BEND, OFFSET)
    own = replace(
        FAMILIES[0], name="wear of ours", of="s"
    )  # another family of an input that a built-in one does not concern
    assert len(families_for(replace(network, families=(own,)))) == len(FAMILIES) + 1
    coated = Parameter("tbc_thickness", "dormant", Prior("uniform", 0.5, 2.0), nominal=1.0)
    wears = replace(FAMILIES[0], name="wear of ours")
    coated_network = replace(network, parameters=(*network.parameters, coated), families=(wears,))
    names = [f.name for f in families_for(coated_network)]
    assert "wear of ours" in names
    assert "coating wear" not in names
    assert "coating spallation" not in names


def test_families_are_in_the_networks_document_and_have_to_concern_what_it_has() -> None:
    told = MODEL.network.to_json()
    assert Network.from_json(told) == MODEL.network
    assert "families" not in conjugate(2).network.to_json()
    with pytest.raises(InputError, match="cooling"):
        replace(MODEL.network, families=(replace(BEND, of="cooling"),))
    with pytest.raises(InputError, match="twice"):
        replace(MODEL.network, families=(BEND, BEND))


def test_only_what_is_constant_and_the_same_for_all_wakes_a_dormant_input() -> None:
    everywhere = Cell(BEND, "constant", "all")
    assert frees(everywhere, MODEL.network)
    assert amplitude(everywhere, MODEL.network) == ("bend", 0.0)
    one_blade = Cell(replace(BEND, whom=("blade",)), "constant", "blade", "b01")
    assert not frees(one_blade, MODEL.network)
    with pytest.raises(InputError, match="needs simulation runs"):
        with_effects(MODEL, [one_blade], {}, {"y": SIGMA})
    awake = with_effects(MODEL, [everywhere], {}, {"y": SIGMA})
    assert not frees(everywhere, awake.network)
    down = Cell(replace(BEND, sign=-1), "constant", "all")
    assert with_effects(MODEL, [down], {}, {}).network.parameter("bend").prior.high == 0.0


def test_what_is_lost_of_a_dormant_input_that_wakes_is_below_zero_and_told_so() -> None:
    """Its amplitude is the parameter's own, less its nominal value: "lost" would turn it round."""
    losing = Model(
        replace(MODEL.network, families=(replace(BEND, sign=-1), OFFSET)), MODEL.surrogate
    )
    data = readings(lambda b, t: -0.25 * t**2)
    one = found(data, losing)
    assert one.verdict.names == ("bend",)
    (told,) = to_json(one, Case(SPEC, data, {b: Facts() for b in SPEC.blades}))["effects"]
    assert told["amplitude"]["mean"] < -0.15
    assert (told["amplitude"]["of"], told["amplitude"]["unit"]) == ("added to bend", "1")


def test_a_provisional_state_is_not_diagnosed() -> None:
    data = readings(lambda b, t: 0.0)
    state = update(MODEL, SPEC, data)
    state.meta["sealed"] = False
    with pytest.raises(InputError, match="provisional"):
        module_function(MODEL, state, Case(SPEC, data, {}))
    assert shared_posterior(state.meta, state.arrays.__getitem__).names


def test_an_amplitude_that_leans_on_the_end_of_its_room_is_not_accepted() -> None:
    """A bend of 0.25 where the runs end at 0.15; with room to 2 it is named."""
    asleep = replace(MODEL.network.parameter("bend"), prior=Prior("uniform", -2.0, 0.15))
    parameters = tuple(asleep if p.name == "bend" else p for p in MODEL.network.parameters)
    narrow = Model(replace(MODEL.network, parameters=parameters), MODEL.surrogate)
    one = found(readings(lambda b, t: 0.25 * t**2), narrow)
    assert "bend" in {e.cell.name for e in one.effects}
    assert (one.verdict.word, one.verdict.names) == ("unattributed", ())
    assert "the amplitude of bend leans on 0.15, no room: the runs end there" in one.verdict.reasons


@pytest.mark.parametrize("effect", [0.25, 0.0])
def test_where_what_blades_share_leans_on_the_end_of_its_prior_it_is_told(effect: float) -> None:
    """The prior of `s` ends far below where it is."""
    data = readings(lambda b, t: effect * t**2)
    free = found(data)
    assert free.verdict.word == ("effect" if effect else "adequate")
    assert not any("leans" in why for why in free.verdict.reasons)
    own = replace(MODEL.network.parameter("s"), prior=Prior("uniform", 0.0, 1.4))
    parameters = tuple(own if p.name == "s" else p for p in MODEL.network.parameters)
    cut = found(data, Model(replace(MODEL.network, parameters=parameters), MODEL.surrogate))
    assert cut.verdict.word == free.verdict.word
    told = "s leans on 1.4, the high end of its prior: what is found may stand for what lies beyond"
    assert any(why.startswith(told) for why in cut.verdict.reasons)


def test_readings_that_are_one_value_in_all_blades_are_told_whatever_is_found() -> None:
    data = readings(lambda b, t: 0.0)
    same = {t: data[i].values for i, t in enumerate(TIMES)}
    one = found(tuple(replace(r, values=same[r.time_h]) for r in data))
    told = [why for why in one.verdict.reasons if f"in {BLADES} of {BLADES} blades at" in why]
    assert len(told) == len(TIMES)
    assert not any("copied" in why for why in found(data).verdict.reasons)


def test_what_is_adopted_may_be_found_again_under_another_name_in_the_network() -> None:
    cell = Cell(OFFSET, "constant", "instrument", "gauge 1")
    noise, facts = {"y": SIGMA}, {b: Facts() for b in SPEC.blades}
    once = with_effects(MODEL, [cell], facts, noise)
    assert amplitude(cell, MODEL.network)[0] == cell.name
    again = replace(cell, shape="linear")
    name, _ = amplitude(again, once.network)
    assert name == f"{cell.name} 2"
    twice = with_effects(once, [again], facts, noise)
    assert [b.name for b in twice.network.biases] == [cell.name, name]
    assert twice.network.parameter(name).level == "shared"


def test_a_name_whose_evidence_rested_on_what_has_left_is_weighed_without_it() -> None:
    """`first` was taken, `second` had all evidence beside it, and then `first` left."""
    first, second, third = (Cell(OFFSET, "constant", "instrument", g) for g in "abc")
    state = update(MODEL, SPEC, readings(lambda b, t: 0.0))

    def rival(gained: float, *effects: Cell) -> Rival:
        return Rival(effects, MODEL, lambda: state, gained)

    def word(alone: float, other: float) -> str | None:
        """What is claimed of `second`, which gains `alone`, and `third` gains `other`."""
        made = (
            rival(9.0, first), rival(alone, second), rival(other, third),
            rival(30.0, first, second), rival(20.0, first, third),
        )  # fmt: skip
        case = Case(SPEC, (), {})
        search = Search(MODEL, state, case, Workspace(), lambda *a: None)
        search.known = {frozenset(one.effects): one for one in made}
        weights = ((second, 30.0, 0.9999), (third, 20.0, 0.0001))
        found = tuple(
            Hypothesis((i,), (c.name,), gain, w) for i, (c, gain, w) in enumerate(weights)
        )
        turn = Turn(found, (second.name,), {}, (second, third), (first,))
        assert search.standing(turn, made[3]) is turn
        return search.standing(turn, made[1]).claim(second.name)

    assert word(29.0, 10.0) == second.name
    assert word(29.0, 40.0) is None, "another one gains more where the first is not there"
    assert word(9.0, 0.0) is None, "the first gains as much alone"


def test_a_posterior_with_more_than_two_effects_is_looked_for_where_it_is_expected_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = Case(SPEC, readings(lambda b, t: 0.0), {b: Facts() for b in SPEC.blades}, (BEND, OFFSET))
    state = update(MODEL, SPEC, case.readings)
    search = Search(MODEL, state, case, Workspace(), lambda what, done, total: None)
    cells = (
        Cell(BEND, "constant", "all"),
        *(Cell(OFFSET, "constant", "instrument", f"gauge {k}") for k in range(2)),
    )
    alone: list[bool] = []

    def begun(*given: object, start: Start, **more: object) -> None:
        alone.append(start.alone)
        raise InputError("posterior", 0, "is not wanted", "look at the start")

    monkeypatch.setattr("core.diagnosis.search.begun", begun)
    for count in (1, 2, 3):
        assert search.calibrated(cells[:count], lambda: Start.of(MODEL, state)) is None
    assert alone == [False, False, True]
