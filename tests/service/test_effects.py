"""Diagnoses by the real science, on blades given by a formula, through a worker."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import Engine

from core.builtin import creep_specimens
from core.builtin.paper_network import rotor_blade_network
from core.calibration.state import RotorState
from core.diagnosis import FAMILIES, Case, Diagnosis, Facts
from core.diagnosis.adopt import with_effects
from core.diagnosis.grammar import Cell
from core.diagnosis.verdict import judge
from core.errors import InputError
from core.model import Model, rotor_blade, rotor_blade_wide
from core.observation import Inspection
from core.prior import Prior
from core.surrogate.formula import FormulaInput, FormulaModel
from service import effects
from service.bootstrap import make_worker
from service.diagnose_command import lines_of
from service.errors import FaultsError
from service.handlers import reads
from service.handlers.adoptions import adopt, back_out
from service.handlers.blades import retire_blade
from service.handlers.diagnoses import cancel_diagnosis, find_diagnosis, request_diagnosis
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor, view_rotor
from service.ports import BladeRecord, Json, Which
from service.report.page import report
from service.science import CoreScience
from service.settings import Settings
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from service.variant import effects_between, vary, with_more
from service.worker import heed
from service.worker.job_lease import JobLease
from service.worker.lease import release
from service.worker.residuals import Residuals
from tests.service.smooth import elongation, formula_science
from tests.service.test_diagnoses import FAMILY

BLADES, VISITS, NOISE = 6, (8000.0, 16_000.0, 24_000.0), 0.004


@pytest.fixture
def database_url(sqlite_url: str) -> str:
    """The science is the same on both databases, and takes a minute."""
    return sqlite_url


def made(database_url: str) -> SqlStore:
    """Six blades of two lots, on a migrated database."""
    opened = SqlStore(open_engine(database_url))
    register_builtins(opened, formula_science())
    blades = [BladeRecord(f"B{b}", lot=f"L{b % 2}") for b in range(BLADES)]
    create_rotor(opened, "r1", "rotor-blade", blades, 400, 7)
    return opened


@pytest.fixture
def fleet(settings: Settings) -> Iterator[SqlStore]:
    opened = made(settings.database_url)
    yield opened
    opened.close()


def in_file(file: Path) -> Settings:
    """The settings of the tests, of a database in a file."""
    url = f"sqlite:///{file}"
    given = {"lease_s": 30.0, "retry_base_s": 0.0, "seal_after_s": 0.0}
    return Settings(database_url=url, science="fake", **given)


def visits(off: float) -> list[Item]:
    """Readings of six blades at three visits; the second visit reads `off` noises too long."""
    rng = np.random.default_rng(20310504)
    found = []
    for b in range(BLADES):
        x = np.array([[1.0 + 0.05 * rng.normal(), 0.87, 0.3 * rng.normal(), 0.3 * rng.normal()]])
        for k, h in enumerate(VISITS):
            y = float(elongation(x, h)[0]) + NOISE * rng.normal() + NOISE * off * (k == 1)
            reading = Inspection(
                f"{b}-{k}",
                f"B{b}",
                "elongation",
                h,
                np.array([y]),
                sigma=NOISE,
                campaign=f"visit {k}",
            )
            found.append(Item("", reading))
    return found


def diagnosed(fleet: SqlStore, settings: Settings, off: float) -> Json:
    post_inspections(fleet, "r1", visits(off))
    science = formula_science()
    job, _ = request_diagnosis(fleet, science, "r1", (), compare=True, horizon_h=None)
    worker, steps = make_worker(fleet, science, settings, "d", "diagnose"), []
    tell = worker.jobs.progress

    def noting(*given: Any) -> Any:
        told = tell(*given)

        def step(what: str, done: int, total: int) -> None:
            told(what, done, total)
            steps.append((done, total))

        return step

    worker.jobs.progress = noting  # type: ignore[method-assign]
    worker.drain()
    ended = find_diagnosis(fleet, "r1", job.id)
    assert ended.status == "done", ended.error
    assert ended.result is not None
    return {"rotor": "r1", "result": ended.result, "steps": steps}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, sqlite_template: Path) -> Json:
    """The diagnosis of a visit that read five noises too long, made once."""
    file = tmp_path_factory.mktemp("whole") / "bladetwin.db"
    settings = in_file(shutil.copy(sqlite_template, file))
    opened = made(settings.database_url)
    told = diagnosed(opened, settings, 5.0)
    opened.close()
    return told


def test_a_campaign_that_read_five_noises_too_long_is_named_with_its_amplitude(
    whole: Json,
) -> None:
    told, found = whole, whole["result"]
    assert (found["verdict"], found["names"]) == ("effect", ["campaign offset (campaign visit 1)"])
    size = found["effects"][0]["amplitude"]
    assert abs(size["mean"] - 5 * NOISE) < 3 * size["sd"] < 3 * NOISE
    assert found["readings"] == {"delivered": 18, "used": 18}
    assert (
        found["models"]["after"] != found["models"]["before"] == found["rests_on"]["model_digest"]
    )
    compared = found["before_after"]
    assert compared["held_out"] == ["1-2", "3-2", "5-2"]
    assert compared["after"]["log_score"] > compared["before"]["log_score"]
    shown = "\n".join(lines_of(told))
    assert "rotor r1: effect" in shown
    said = re.search(r"campaign offset \(campaign visit 1\): (\S+)", shown)
    assert said is not None, shown
    assert float(said[1]) == pytest.approx(size["mean"], rel=0.01)
    assert "3 readings that neither model used" in shown


def test_its_steps_go_forward_to_one_end(whole: Json) -> None:
    done, totals = zip(*whole["steps"], strict=True)
    assert len(done) > 5
    assert list(done) == sorted(done)
    assert len(set(totals)) == 1
    assert 0 == done[0] < done[-1] < totals[0]


def test_the_same_blades_without_the_offset_are_adequate(
    fleet: SqlStore, settings: Settings
) -> None:
    """The negative control: nothing is claimed, and nothing compared."""
    found = diagnosed(fleet, settings, 0.0)["result"]
    assert (found["verdict"], found["effects"], found["before_after"]) == ("adequate", [], None)
    assert found["p"] > 0.05


def test_one_that_is_cancelled_within_a_step_ends_there(
    fleet: SqlStore, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The real science heeds that between two blades' messages, long before its first step ends."""
    post_inspections(fleet, "r1", visits(0.0))
    science = formula_science()
    job, _ = request_diagnosis(fleet, science, "r1", (), compare=True, horizon_h=None)
    asked, still_holds = list[str](), heed.still_holds

    def cancelling(engine: Engine, lease: JobLease) -> None:
        asked.append(lease.id)
        if len(asked) == 2:
            cancel_diagnosis(fleet, "r1", job.id)
        still_holds(engine, lease)

    monkeypatch.setattr(heed, "ASK_S", 0.0)
    monkeypatch.setattr(heed, "still_holds", cancelling)
    make_worker(fleet, science, settings, "d", "diagnose").run_once()
    ended = find_diagnosis(fleet, "r1", job.id)
    assert ended.progress is not None
    assert (ended.status, ended.progress["what"]) == ("cancelled", "calibration")
    assert asked == [job.id] * 2


def test_a_diagnosis_that_another_worker_goes_on_with_says_the_same(
    fleet: SqlStore, settings: Settings, whole: Json
) -> None:
    """Its first worker dies in the fifth step; what it had found is not searched again."""
    post_inspections(fleet, "r1", visits(5.0))
    job, _ = request_diagnosis(fleet, formula_science(), "r1", (), compare=True, horizon_h=None)
    first = make_worker(fleet, formula_science(), settings, "first", "diagnose")
    tell, steps = first.jobs.progress, list[str]()

    def dying(*given: Any) -> Any:
        told = tell(*given)

        def step(what: str, done: int, total: int) -> None:
            told(what, done, total)
            steps.append(what)
            if len(steps) == 5:
                raise SystemExit

        return step

    first.jobs.progress = dying  # type: ignore[method-assign]
    with pytest.raises(SystemExit):
        first.drain()
    release(fleet.engine, "first")
    make_worker(fleet, formula_science(), settings, "second", "diagnose").drain()
    ended = find_diagnosis(fleet, "r1", job.id)
    assert (ended.status, ended.attempts) == ("done", 2)
    assert ended.result == whole["result"]


def test_adopted_by_the_real_science_the_worker_s_model_is_the_diagnosed_one_and_backs_out(
    fleet: SqlStore, settings: Settings
) -> None:
    """Another process, which knows the database alone, builds the model with the offset in it."""
    post_inspections(fleet, "r1", visits(5.0))
    make_worker(fleet, formula_science(), settings).drain()
    before = view_rotor(fleet, "r1").state
    job, _ = request_diagnosis(fleet, formula_science(), "r1", (), compare=False, horizon_h=None)
    make_worker(fleet, formula_science(), settings, "d", "diagnose").drain()
    change = adopt(fleet, formula_science(), "r1", job.id)
    make_worker(fleet, formula_science(), settings).drain()
    after = view_rotor(fleet, "r1").state
    assert before is not None
    assert after is not None
    assert after.sealed
    assert before.meta["model"] == change.body["models"]["before"]
    assert after.meta["model"] == change.body["models"]["after"] != before.meta["model"]
    assert after.meta["log_evidence"] > before.meta["log_evidence"] + 5
    found = reads.basis(fleet, formula_science(), "r1", Which())
    told = reads.posterior(fleet, formula_science(), found)["parameters"]
    size = told["campaign offset (campaign visit 1)"]
    assert abs(size["mean"] - 5 * NOISE) < 3 * size["sd"] < 3 * NOISE
    back_out(fleet, formula_science(), "r1", job.id)
    make_worker(fleet, formula_science(), settings).drain()
    again = view_rotor(fleet, "r1").state
    assert again is not None
    assert again.digest == before.digest


CONSTANT = {"target": "input", "whom": ["all"], "shapes": ["constant"]}
GROWTH = (0.0, 0.005, 0.02, 0.045, 0.08)  # of the elongation, in all blades alike


def growing() -> list[Item]:
    """Six blades at five visits, which run ever longer than they creep."""
    rng = np.random.default_rng(20310505)
    found = []
    for b in range(BLADES):
        x = np.array([[1.0 + 0.05 * rng.normal(), 0.87, 0.3 * rng.normal(), 0.3 * rng.normal()]])
        for k, growth in enumerate(GROWTH):
            hour = 6000.0 * (k + 1)
            y = float(elongation(x, hour)[0]) * (1.0 + growth) + NOISE * rng.normal()
            at = (f"{b}-{k}", f"B{b}", "elongation", hour, np.array([y]))
            found.append(Item("", Inspection(*at, sigma=NOISE, campaign=f"visit {k}")))
    return found


@pytest.fixture(scope="module")
def without_name(
    tmp_path_factory: pytest.TempPathFactory, sqlite_template: Path
) -> tuple[Path, str, Json]:
    """A diagnosis of growing blades whose verdict is that no name will do, made once: a database,
    the job in it and its result.
    """

    def no_name(model: Model, state: RotorState, case: Case, *_: Any) -> Diagnosis:
        first = judge(case.scan(model, state), case.spec.seed, dealt=case.dealt)
        nothing = replace(first, word="unattributed", names=(), reasons=("no name will do",))
        return Diagnosis(nothing, first, (model, state), (model, state), (), 0.0, ())

    file = tmp_path_factory.mktemp("nameless") / "bladetwin.db"
    settings = in_file(shutil.copy(sqlite_template, file))
    fleet = made(settings.database_url)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effects, "diagnose", no_name)
        post_inspections(fleet, "r1", growing())
        make_worker(fleet, formula_science(), settings).drain()
        job, _ = request_diagnosis(fleet, formula_science(), "r1", (), compare=True, horizon_h=None)
        make_worker(fleet, formula_science(), settings, "d", "diagnose").drain()
    ended = find_diagnosis(fleet, "r1", job.id)
    fleet.close()
    assert ended.status == "done", ended.error
    assert ended.result is not None
    return file, job.id, ended.result


@pytest.fixture
def nameless(
    without_name: tuple[Path, str, Json], settings: Settings
) -> Iterator[tuple[SqlStore, str, Json]]:
    """The same, in a database of the test's own."""
    file, job, found = without_name
    shutil.copy(file, settings.database_url.removeprefix("sqlite:///"))
    opened = SqlStore(open_engine(settings.database_url))
    yield opened, job, found
    opened.close()


def test_a_lack_without_a_name_widens_the_bands_by_a_discrepancy_that_is_adopted_and_backs_out(
    nameless: tuple[SqlStore, str, Json], settings: Settings
) -> None:
    fleet, job, found = nameless
    wide = found["widened"]
    assert (found["verdict"], found["claimed"], found["names"]) == ("unattributed", False, [])
    assert wide["borne_out"]
    assert 0.05 < wide["share"] < 1.0
    assert wide["sd"]["after"] > wide["sd"]["before"]
    assert f"{wide['share']:.0%} of the variance" in found["reasons"][-1]
    assert "it names no cause" in found["reasons"][-1]
    assert found["before_after"] is not None
    before = view_rotor(fleet, "r1").state
    change = adopt(fleet, formula_science(), "r1", job)
    assert change.body["models"] == found["models"]
    assert change.body["after"] == {
        "quantities": {"elongation": {"discrepancy": wide["discrepancy"]}}
    }
    assert [one["name"] for one in change.body["effects"]] == ["discrepancy (elongation)"]
    make_worker(fleet, formula_science(), settings).drain()
    after = view_rotor(fleet, "r1").state
    assert before is not None
    assert after is not None
    assert after.meta["model"] == found["models"]["after"] != before.meta["model"]
    assert after.meta["log_evidence"] - before.meta["log_evidence"] == pytest.approx(
        wide["gained_nat"], abs=0.3
    )
    back_out(fleet, formula_science(), "r1", job)
    make_worker(fleet, formula_science(), settings).drain()
    again = view_rotor(fleet, "r1").state
    assert again is not None
    assert again.digest == before.digest


def test_the_report_says_how_much_wider_and_that_it_is_no_cause(
    nameless: tuple[SqlStore, str, Json],
) -> None:
    _, job, found = nameless
    page = report(found, "r1", job, None)
    assert "that names no cause" in page
    assert "can be adopted" in page
    quiet = {**found, "widened": {**found["widened"], "borne_out": False}}
    assert "can be adopted" not in report(quiet, "r1", job, None)


def test_residuals_of_the_real_science_alarm_where_a_campaign_is_off(
    fleet: SqlStore, settings: Settings
) -> None:
    post_inspections(fleet, "r1", visits(8.0))
    make_worker(fleet, formula_science(), settings).drain()
    assert Residuals(fleet, formula_science(), settings, "d").run_once()
    with fleet.read() as tx:
        kept = tx.records.residuals("r1")
    assert kept.error is None
    assert kept.body is not None
    assert len(kept.body["residuals"]) == 18, "all counted"
    assert all(0 <= one["pit"] <= 1 for one in kept.body["residuals"])
    loud = [(one["grouping"], one["value"]) for one in kept.body["tests"] if one["alarm"]]
    assert ("campaign", "visit 1") in loud
    found = reads.basis(fleet, formula_science(), "r1", Which())
    assert kept.body["rests_on"]["model_digest"] == found.card.digest
    assert kept.version == found.state.version


def test_effects_through_the_creep_are_the_same_model_after_a_journey_as_json() -> None:
    """Wear of a lot by the blade's hours, and fouling by the rotor's, on the shipped surrogate."""
    base = rotor_blade()
    box = {"tbc_thickness": (1.0, 1.3), "t1t_rate": (0.85, 0.95)}
    narrow = replace(
        base.network,
        parameters=tuple(
            replace(p, prior=Prior("uniform", *box[p.name])) if p.name in box else p
            for p in base.network.parameters
        ),
    )
    before = Model.of(narrow, base.surrogate)
    families = {f.name: f for f in FAMILIES}
    facts = {
        "B1": Facts(coating_lot="C1"),
        "B2": Facts(coating_lot="C2"),
        "B3": Facts(coating_lot="C2", offset_h=8000.0),
    }
    worn = Cell(families["coating wear"], "linear", "coating_lot", "C2")
    fouled = Cell(families["fouling"], "early", "all")
    after = with_effects(before, [worn, fouled], facts, {})
    science = CoreScience(model=before)
    card = science.builtin("rotor-blade")
    told = with_more(None, effects_between(before.network, after.network))
    varied = science.vary(card, json.loads(json.dumps(told)))
    assert varied.digest == after.digest != card.digest
    assert {d.blades for d in varied.network.drifts} == {("B2", "B3"), None}
    told["effects"]["drifts"][0]["blades"] = ["B2"]
    assert science.vary(card, told).digest != after.digest, "the negative control"
    with pytest.raises(InputError, match="effects on top"):
        effects_between(after.network, before.network)


def test_a_family_of_an_input_that_the_model_has_not_is_refused_before_anything_is_queued(
    fleet: SqlStore,
) -> None:
    science = formula_science()
    worn = FAMILY | CONSTANT | {"of": "tbc_thickness", "name": "worn"}
    for families, at in (
        ([worn | {"shapes": ["linear"]}], r"families\[0\].shapes"),  # a formula follows none
        ([worn, worn | {"name": "other", "of": "wall_loss"}], r"families\[1\].of"),
        ([worn, worn], r"families\[1\].name"),
    ):
        with pytest.raises(InputError, match=at):
            request_diagnosis(fleet, science, "r1", families, compare=True, horizon_h=None)
    assert request_diagnosis(fleet, science, "r1", [worn], compare=True, horizon_h=None)[1]


@pytest.mark.parametrize(
    "changes",
    [
        {"size": 1e300},
        {"how": "times", "size": 11.0},
        CONSTANT | {"of": "t1t_rate", "size": 0.21},
        {"size": 1e-9},
        {"how": "times", "size": 1e-6},
        CONSTANT | {"of": "t1t_rate", "size": 2e-13},
    ],
)
def test_a_family_of_more_than_there_is_or_than_any_reading_shows_is_refused(
    fleet: SqlStore, changes: Json
) -> None:
    """Of 1e300 mm nothing can be computed: the test of chance had p = 0 in a sound rotor. One of
    1e-12 of the range was looked for, and never found."""
    science = formula_science()
    with pytest.raises(InputError, match=r"families\[0\].size"):
        request_diagnosis(fleet, science, "r1", [FAMILY | changes], compare=True, horizon_h=None)
    fits = FAMILY | CONSTANT | {"of": "t1t_rate", "size": 0.19}
    assert request_diagnosis(fleet, science, "r1", [fits], compare=True, horizon_h=None)[1]


@pytest.mark.parametrize("shapes", [["linear"], ["constant", "step"]])
@pytest.mark.parametrize("of", ["wall_loss", "tertiary"])
def test_a_course_of_what_no_finite_elements_run_in_time_is_refused(
    of: str, shapes: list[str]
) -> None:
    lost = FAMILY | CONSTANT | {"of": of, "name": "lost", "size": 0.05}
    with pytest.raises(InputError, match=r"families\[0\].shapes") as caught:
        effects.families_of(rotor_blade_wide(), [lost | {"shapes": shapes}])
    assert f"{of} does not" in caught.value.problem
    assert effects.families_of(rotor_blade_wide(), [lost])[0].of == of
    cool = lost | {"of": "cooling_flow", "shapes": shapes}
    assert effects.families_of(rotor_blade_wide(), [cool]), "the negative control"


def test_a_family_of_readings_at_many_nodes_is_refused() -> None:
    """No bias can be of them: it shared the evidence with names that can enter the model."""
    scans = FAMILY | {"of": "deformation", "size": 0.01}
    with pytest.raises(InputError, match=r"families\[0\].of = 'deformation' is read at many nodes"):
        effects.families_of(rotor_blade(), [scans])
    (found,) = effects.families_of(rotor_blade(), [scans | {"of": "ceeq", "size": 1e-4}])
    assert found.of == "ceeq"


@dataclass(frozen=True)
class Unnamed(FormulaModel):
    """A mesh without a named node, as users' runs may have."""

    @property
    def named(self) -> dict[str, int]:
        return {}


@pytest.mark.parametrize(("form", "told"), [(FormulaModel, "ceeq"), (Unnamed, "elongation")])
def test_models_are_compared_by_what_they_tell_without_the_number_of_a_node(
    form: type[FormulaModel], told: str
) -> None:
    """CEEQ was read more often, at nodes by their number; a forecast of it would have no node, and
    the diagnosis would end with that, after all calibrations."""
    network = rotor_blade_network()
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in network.parameters)
    model = Model(network, form(inputs, {"elongation": elongation, "ceeq": elongation}, "two"))
    of = {"ceeq": 3, "elongation": 2}
    readings = [
        Inspection(f"{q}{k}", "B", q, 1e3 * (k + 1), np.array([0.1]),
                   np.array([7]) if q == "ceeq" else None)
        for q, count in of.items() for k in range(count)
    ]  # fmt: skip
    assert effects.compared(model, readings) == told
    (made,) = (own for own in network.quantities if own.name == told)
    node = None if made.kind == "scalar" else made.node_among(model.part(told).named)
    assert (node is None) == (told == "elongation")
    assert effects.compared(model, readings[: of["ceeq"]]) == ("ceeq" if told == "ceeq" else "")


def test_a_dormant_input_that_woke_is_told_and_woken_again_in_its_place() -> None:
    before = creep_specimens.network()
    after = creep_specimens.freed(before, {"tertiary": "shared"})
    told = effects_between(before, after)
    assert [(p["name"], p["level"]) for p in told["parameters"]] == [("tertiary", "shared")]
    assert (told["drifts"], told["biases"]) == ([], [])
    assert vary(before, creep_specimens.HORIZON_H, {"effects": told}) == after


def test_only_what_was_dormant_can_wake() -> None:
    before = creep_specimens.network()
    awake = replace(before.parameter("n"), prior=Prior("uniform", 2.0, 3.0))
    told = {"parameters": [asdict(awake)]}
    with pytest.raises(FaultsError, match=r"network\.effects"):
        vary(before, creep_specimens.HORIZON_H, {"effects": told})


def test_forecasts_and_inspections_are_of_blades_that_were_there_when_it_was_asked_for(
    fleet: SqlStore, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One retires before the request, and one after it; both are calibrated."""
    seen: list[Case] = []

    def look(model: Model, state: RotorState, case: Case, *_: Any) -> Diagnosis:
        seen.append(case)
        raise InputError("test", 0, "has seen enough", "go on")

    monkeypatch.setattr(effects, "diagnose", look)
    post_inspections(fleet, "r1", visits(0.0))
    retire_blade(fleet, "r1", "B1")
    request_diagnosis(fleet, formula_science(), "r1", (), compare=True, horizon_h=None)
    retire_blade(fleet, "r1", "B2")
    make_worker(fleet, formula_science(), settings, "d", "diagnose").drain()
    (case,) = seen
    assert case.spec.blades == tuple(f"B{b}" for b in range(BLADES))
    assert case.present == ("B0", "B2", "B3", "B4", "B5")
