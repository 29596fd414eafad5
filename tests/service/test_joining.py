"""A blade that joins the lot of an adopted effect has the effect, too."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner

from core.diagnosis.adopt import parameter_name
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.network import Network, Parameter
from core.observation import Inspection
from core.prior import Prior
from service.adopted import ADOPTION, JOINING, Adopted, Sheet, adopted_at, part_of
from service.bootstrap import make_worker
from service.cli import app as commands
from service.diagnose_command import adopted_line
from service.digests import digest_of_json
from service.handlers import blades as joining
from service.handlers.blades import add_blade, retire_blade
from service.handlers.diagnoses import find_diagnosis, request_diagnosis
from service.handlers.rotors import create_rotor, view_rotor
from service.handlers.transfer_in import import_rotor
from service.handlers.transfer_out import export_rotor
from service.ports import BladeRecord, Event, Json
from service.settings import Settings
from service.store.audit import audit
from service.store.engine import snapshot
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from service.worker.replay import replay
from tests.service.adopting import Lots

Make = Callable[..., Inspection]
Post = Callable[..., int]
LOTS = {"B1": "L1", "B2": "L1", "B3": "L2", "B4": "L2"}
TRUE = {name: 0.4 + 0.1 * number for number, name in enumerate([*LOTS, "B8", "B9"])}  # at 50,000 h


@pytest.fixture
def science() -> Lots:
    return Lots()


@pytest.fixture
def rotor(store: SqlStore) -> str:
    """Two lots of two blades."""
    own = [BladeRecord(name, lot=lot) for name, lot in LOTS.items()]
    create_rotor(store, "r1", "rotor-blade", own, 64, 7)
    return "r1"


def read(reading: Make, blade: str, lot: str, campaign: str = "c", off: float = 0.0) -> list[Any]:
    """Four readings along the blade's line; of lot L1 they are 0.1 mm longer."""
    return [
        reading(
            f"{blade}-{campaign}{k}",
            blade=blade,
            time_h=8e3 * k,
            value=TRUE[blade] * 8e3 * k / 5e4 + Lots.SIZE * (lot == "L1") + off,
            campaign=f"{campaign}{k}",
        )
        for k in range(1, 5)
    ]


@pytest.fixture
def named(
    store: SqlStore,
    science: Lots,
    rotor: str,
    settings: Settings,
    post: Post,
    reading: Make,
    worker: Worker,
) -> str:
    """The id of a diagnosis that names the lot."""
    for blade, lot in LOTS.items():
        post(rotor, *read(reading, blade, lot))
    worker.drain()
    return diagnosed(store, science, settings)


def diagnosed(store: SqlStore, science: Lots, settings: Settings) -> str:
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    make_worker(store, science, settings, "diagnoser-1", "diagnose").drain()
    return job.id


@pytest.fixture
def adopted(api: httpx.Client, named: str, worker: Worker) -> str:
    """The same, adopted and computed."""
    api.post(f"/v1/rotors/r1/diagnoses/{named}/adoption").raise_for_status()
    worker.drain()
    return named


@pytest.fixture
def second(
    store: SqlStore,
    science: Lots,
    settings: Settings,
    adopted: str,
    post: Post,
    reading: Make,
    worker: Worker,
) -> str:
    """A second diagnosis, with the lot's effect in the model: a campaign is off."""
    for blade, lot in LOTS.items():
        post("r1", *read(reading, blade, lot, "off", 0.3)[:1])
    worker.drain()
    return diagnosed(store, science, settings)


def concerned(store: SqlStore) -> list[list[str]]:
    """The blades of each bias in the rotor's network."""
    network = view_rotor(store, "r1").adopted.network or {}
    biases = network.get("effects", {}).get("biases", ())
    return [one["blades"] for one in biases if "blades" in one]


def at_the_end(api: httpx.Client, blade: str) -> float:
    path = f"/v1/rotors/r1/blades/{blade}/prediction?times=50000"
    return float(api.get(path).json()["mean"][0])


def test_a_blade_of_the_lot_has_the_effect_and_one_of_another_has_not(
    api: httpx.Client, store: SqlStore, adopted: str, worker: Worker, post: Post, reading: Make
) -> None:
    for blade, lot in (("B8", "L2"), ("B9", "L1")):
        answer = api.post("/v1/rotors/r1/blades", json={"id": blade, "lot": lot})
        assert answer.status_code == 202, answer.text
        post("r1", *read(reading, blade, lot))
    worker.drain()
    rotor = api.get("/v1/rotors/r1").json()
    assert concerned(store) == [["B1", "B2", "B9"]]
    (effect,) = rotor["effects"]
    assert (effect["joined"], effect["untold"]) == (["B9"], [])
    for blade in ("B8", "B9"):
        bands = api.get(f"/v1/rotors/r1/blades/{blade}/prediction?times=50000").json()
        assert bands["rests_on"]["untold"] == []
        assert bands["mean"][0] == pytest.approx(TRUE[blade], abs=0.03)
    first, last = api.get("/v1/rotors/r1/adoptions").json()["items"]
    assert (first["what"], first["blade"]) == ("adoption", None)
    assert (last["what"], last["blade"], last["diagnosis"]) == ("joining", "B9", adopted)
    assert [one["name"] for one in last["effects"]] == [effect["name"]]
    assert (last["networks"]["before"], last["models"]) == (first["networks"]["after"], None)
    assert last["networks"]["after"] == rotor["network"]
    told = api.get(f"/v1/rotors/r1/diagnoses/{adopted}").json()["adoption"]
    assert told == first, "it is in force by its adoption, whoever joined since"
    again = api.post(f"/v1/rotors/r1/diagnoses/{adopted}/adoption")
    assert again.headers["idempotent-replayed"] == "true"


def test_without_the_entry_its_bands_are_off_and_it_is_named(
    api: httpx.Client,
    store: SqlStore,
    adopted: str,
    worker: Worker,
    post: Post,
    reading: Make,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What the entry is for; so it was before there was one."""
    monkeypatch.setattr(joining, "join_effects", lambda *given: None)
    add_blade(store, "r1", BladeRecord("B9", lot="L1"))
    post("r1", *read(reading, "B9", "L1"))
    worker.drain()
    assert concerned(store) == [["B1", "B2"]]
    assert at_the_end(api, "B9") > TRUE["B9"] + 0.1
    assert api.get("/v1/rotors/r1").json()["effects"][0]["untold"] == ["B9"]


def test_a_blade_joins_once_however_often_it_is_posted(
    api: httpx.Client, store: SqlStore, adopted: str
) -> None:
    told = [api.post("/v1/rotors/r1/blades", json={"id": "B9", "lot": "L1"}) for _ in range(2)]
    assert [one.status_code for one in told] == [202, 202]
    assert len(api.get("/v1/rotors/r1/adoptions").json()["items"]) == 2


def test_a_back_out_takes_the_effect_from_those_who_joined_as_well(
    api: httpx.Client, store: SqlStore, named: str, worker: Worker
) -> None:
    """As if it had never been adopted; who joins then joins nothing."""
    add_blade(store, "r1", BladeRecord("B8", lot="L2"))
    path = f"/v1/rotors/r1/diagnoses/{named}/adoption"
    api.post(path).raise_for_status()
    add_blade(store, "r1", BladeRecord("B9", lot="L1"))
    worker.drain()
    assert concerned(store) == [["B1", "B2", "B9"]]
    api.delete(path).raise_for_status()
    worker.drain()
    view = view_rotor(store, "r1")
    assert (view.adopted.network, view.adopted.effects) == (None, [])
    add_blade(store, "r1", BladeRecord("B7", lot="L1"))
    listed = api.get("/v1/rotors/r1/adoptions").json()["items"]
    assert [one["what"] for one in listed] == ["adoption", "joining", "back-out"]
    told = api.get(f"/v1/rotors/r1/diagnoses/{named}").json()["adoption"]
    assert told["what"] == "back-out"


def test_what_lies_above_is_backed_out_and_the_blade_stays_in_what_lies_below(
    api: httpx.Client,
    store: SqlStore,
    adopted: str,
    second: str,
    worker: Worker,
) -> None:
    sent = api.post(f"/v1/rotors/r1/diagnoses/{second}/adoption")
    assert sent.status_code == 202, sent.text
    add_blade(store, "r1", BladeRecord("B9", lot="L1"))
    worker.drain()
    assert concerned(store) == [["B1", "B2", "B9"]]
    assert len((view_rotor(store, "r1").adopted.network or {})["effects"]["biases"]) == 2
    with store.read() as tx:
        below = adopted_at(tx, tx.records.rotor("r1")).sheets
    assert [sheet.diagnosis for sheet in below] == [adopted, second]
    api.delete(f"/v1/rotors/r1/diagnoses/{second}/adoption").raise_for_status()
    worker.drain()
    assert concerned(store) == [["B1", "B2", "B9"]]
    assert api.get("/v1/rotors/r1").json()["effects"][0]["joined"] == ["B9"]
    api.delete(f"/v1/rotors/r1/diagnoses/{adopted}/adoption").raise_for_status()
    worker.drain()
    assert view_rotor(store, "r1").adopted.network is None


def put_back(api: httpx.Client, worker: Worker, diagnosis: str) -> Json:
    """Backed out, computed, adopted again and computed; the answer to the latter."""
    path = f"/v1/rotors/r1/diagnoses/{diagnosis}/adoption"
    api.delete(path).raise_for_status()
    worker.drain()
    sent = api.post(path)
    assert sent.status_code == 202, sent.text
    again = api.post(path)
    assert again.headers["idempotent-replayed"] == "true"
    assert again.json() == sent.json()
    worker.drain()
    told: Json = sent.json()
    return told


def sealed(store: SqlStore) -> tuple[Any, list[Json], str]:
    """The rotor's network, its effects but for their entries, and what its state is called by."""
    view = view_rotor(store, "r1")
    assert view.state is not None
    assert view.state.sealed
    effects = [
        {k: v for k, v in one.items() if k not in ("seq", "at")} for one in view.adopted.effects
    ]
    return view.adopted.network, effects, view.state.digest


def sound(store: SqlStore, science: Lots, worker: Worker, tmp_path: Path) -> None:
    """The log gives the rotor again, here and where its file is imported."""
    with snapshot(store.engine) as connection:
        assert audit(connection, "r1") == []
    file = tmp_path / "r1.zip"
    export_rotor(store, "r1", file, "test")
    import_rotor(store, science, file, "r2")
    worker.drain()
    there, here = view_rotor(store, "r2"), view_rotor(store, "r1")
    assert there.adopted == here.adopted
    assert there.state is not None
    assert here.state is not None
    assert there.state.digest == here.state.digest
    assert replay(store, science, "r1")["same"] is True


def test_what_is_backed_out_is_put_back_as_it_was_with_the_blade_that_joined(
    api: httpx.Client,
    store: SqlStore,
    science: Lots,
    adopted: str,
    worker: Worker,
    post: Post,
    reading: Make,
    tmp_path: Path,
) -> None:
    """Network and sealed state, bit for bit; it was refused for B9."""
    for blade, lot in (("B8", "L2"), ("B9", "L1")):
        add_blade(store, "r1", BladeRecord(blade, lot=lot))
        post("r1", *read(reading, blade, lot))
    worker.drain()
    was = sealed(store)
    assert was[1][0]["joined"] == ["B9"]
    told = put_back(api, worker, adopted)
    assert sealed(store) == was
    assert told["head_seq"] == told["adoption"]["seq"] + 1 == view_rotor(store, "r1").rotor.head_seq
    assert told["joined"] == ["B9"]
    said = CliRunner().invoke(commands, ["adopt", "r1", adopted, "--url", str(api.base_url)]).stdout
    assert "joined since, of its lot, and have it, too: B9" in said
    line = adopted_line(told)  # of `diagnose --adopt`
    assert line == f"adopted, with entry {told['adoption']['seq']}; the new version follows"
    listed = api.get("/v1/rotors/r1/adoptions").json()["items"]
    assert [(one["what"], one["blade"]) for one in listed[-2:]] == [
        ("adoption", None),
        ("joining", "B9"),
    ]
    assert listed[-1]["networks"]["after"] == was[0]
    sound(store, science, worker, tmp_path)


def test_a_blade_that_joins_while_the_effect_is_out_has_it_once_it_is_back(
    api: httpx.Client,
    store: SqlStore,
    science: Lots,
    adopted: str,
    worker: Worker,
    post: Post,
    reading: Make,
    tmp_path: Path,
) -> None:
    """As one that joined before has; one that left, too, for its readings count."""
    path = f"/v1/rotors/r1/diagnoses/{adopted}/adoption"
    api.delete(path).raise_for_status()
    for blade in ("B9", "B8"):
        add_blade(store, "r1", BladeRecord(blade, lot="L1"))
        post("r1", *read(reading, blade, "L1"))
    retire_blade(store, "r1", "B8")
    worker.drain()
    told = api.post(path).json()
    assert (told["head_seq"], told["joined"]) == (told["adoption"]["seq"] + 2, ["B9", "B8"])
    worker.drain()
    assert concerned(store) == [["B1", "B2", "B8", "B9"]]
    assert api.get("/v1/rotors/r1").json()["effects"][0]["joined"] == ["B9", "B8"]
    assert at_the_end(api, "B9") == pytest.approx(TRUE["B9"], abs=0.03)
    sound(store, science, worker, tmp_path)


def test_a_diagnosis_is_adopted_as_if_it_had_been_before_a_blade_of_the_lot_joined(
    api: httpx.Client, store: SqlStore, named: str, worker: Worker, post: Post, reading: Make
) -> None:
    add_blade(store, "r1", BladeRecord("B9", lot="L1"))
    post("r1", *read(reading, "B9", "L1"))
    path = f"/v1/rotors/r1/diagnoses/{named}/adoption"
    told = api.post(path).json()["adoption"]
    models = api.get(f"/v1/rotors/r1/diagnoses/{named}").json()["result"]["models"]
    assert (told["models"], told["readings_since"]) == (models, 4)
    worker.drain()
    assert concerned(store) == [["B1", "B2", "B9"]]
    assert at_the_end(api, "B9") == pytest.approx(TRUE["B9"], abs=0.03)


def test_what_lies_above_an_effect_that_a_blade_joined_is_put_back_too(
    api: httpx.Client,
    store: SqlStore,
    science: Lots,
    adopted: str,
    second: str,
    worker: Worker,
    tmp_path: Path,
) -> None:
    """It was made for a model that did not concern the new blade; both are what they were."""
    api.post(f"/v1/rotors/r1/diagnoses/{second}/adoption").raise_for_status()
    add_blade(store, "r1", BladeRecord("B9", lot="L1"))
    worker.drain()
    was = sealed(store)
    assert len(was[1]) == 2
    put_back(api, worker, second)
    assert sealed(store) == was
    told = api.get("/v1/rotors/r1/adoptions").json()["items"][-1]
    found = api.get(f"/v1/rotors/r1/diagnoses/{second}").json()["result"]["models"]
    now = api.get("/v1/rotors/r1/blades/B1/prediction").json()["rests_on"]["model_digest"]
    assert told["what"] == "adoption"
    assert told["models"]["after"] == now
    assert not {*told["models"].values()} & {*found.values()}, "the models of now, with B9"
    for one in (second, adopted):
        api.delete(f"/v1/rotors/r1/diagnoses/{one}/adoption").raise_for_status()
    for one in (adopted, second):
        api.post(f"/v1/rotors/r1/diagnoses/{one}/adoption").raise_for_status()
    worker.drain()
    assert sealed(store) == was
    sound(store, science, worker, tmp_path)


@pytest.mark.parametrize("clock", ["blade", "rotor"])
def test_a_blade_that_joins_while_a_rotor_is_diagnosed_that_adopts_by_itself(
    store: SqlStore, settings: Settings, post: Post, reading: Make, worker: Worker, clock: str
) -> None:
    """It has the effect; none is adopted that runs by the rotor's hours, and it is said."""

    class Joined(Lots):
        def diagnose(self, *given: Any) -> Json:
            add_blade(store, "r1", BladeRecord("B9", lot="L1"))
            found = super().diagnose(*given)
            found["effects"][0]["clock"] = clock
            return found

    own = [BladeRecord(name, lot=lot) for name, lot in LOTS.items()]
    create_rotor(store, "r1", "rotor-blade", own, 64, 7, None, "effect")
    for blade, lot in LOTS.items():
        post("r1", *read(reading, blade, lot))
    worker.drain()
    job = find_diagnosis(store, "r1", diagnosed(store, Joined(), settings))
    worker.drain()
    view = view_rotor(store, "r1")
    if clock == "blade":
        assert "not_adopted" not in (job.result or {})
        assert view.adopted.effects[0]["joined"] == ["B9"]
    else:
        refused = (job.result or {})["not_adopted"]
        assert "B9 joined since" in refused
        assert "at which of these their own began is not known" in refused
        assert (view.adopted.effects, view.rotor.head_seq) == ([], 17), "B9 alone"


def test_versions_before_have_the_network_of_then_and_all_is_made_again_from_the_log(
    api: httpx.Client,
    store: SqlStore,
    science: Lots,
    adopted: str,
    worker: Worker,
    tmp_path: Path,
) -> None:
    before = api.get("/v1/rotors/r1").json()
    add_blade(store, "r1", BladeRecord("B9", lot="L1"))
    worker.drain()
    now = api.get("/v1/rotors/r1").json()
    assert now["version"] > before["version"]
    then = api.get(f"/v1/rotors/r1?version={before['version']}").json()
    assert then["network"] == before["network"]
    with snapshot(store.engine) as connection:
        assert audit(connection, "r1") == []
    file = tmp_path / "r1.zip"
    export_rotor(store, "r1", file, "test")
    import_rotor(store, science, file, "r2")
    worker.drain()
    assert view_rotor(store, "r2").adopted == view_rotor(store, "r1").adopted
    again, first = view_rotor(store, "r2").state, view_rotor(store, "r1").state
    assert again is not None
    assert first is not None
    assert again.digest == first.digest
    assert replay(store, science, "r1")["same"] is True


WEAR: Json = {"name": "wear (lot L1)", "whom": "lot", "value": "L1", "clock": "blade"}
PART: Json = {"name": "wear (lot L1)", "blades": ["B1"]}


def with_wear() -> Adopted:
    """A rotor's model with one effect of a lot."""
    after = {"effects": {"drifts": [PART], "biases": [], "parameters": []}}
    body = {"number": 1, "diagnosis": "d1", "effects": [WEAR], "before": None, "after": after}
    return Adopted(None).after(entry(ADOPTION, body))


def entry(kind: str, body: Json) -> Event:
    text, digest = digest_of_json(body)
    return Event(f"{kind}/{body['number']}", kind, text, digest, seq=body["number"])


def test_only_effects_of_its_lot_by_its_own_hours_are_joined() -> None:
    (sheet,) = with_wear().sheets
    assert sheet.joins(BladeRecord("B9", lot="L1")) == [WEAR]
    assert sheet.joins(BladeRecord("B9", lot="L2")) == sheet.joins(BladeRecord("B9")) == []
    for other in ({"clock": "rotor"}, {"clock": "event"}, {"whom": "all"}, {"whom": "blade"}):
        assert replace(sheet, effects=(WEAR | other,)).joins(BladeRecord("B9", lot="L1")) == []
    coating = replace(sheet, effects=(WEAR | {"whom": "coating_lot"},))
    assert coating.joins(BladeRecord("B9", coating_lot="L1"))
    assert not coating.joins(BladeRecord("B9", lot="L1"))
    assert replace(sheet, parts=frozenset()).joins(BladeRecord("B9", lot="L1")) == []


def test_an_entry_that_does_more_than_let_a_blade_join_is_damage() -> None:
    now = with_wear()
    (sheet,) = now.sheets
    body = now.joining(sheet, [WEAR], "B9")
    assert now.after(entry(JOINING, body)).effects[0]["joined"] == ["B9"]
    more = json.loads(json.dumps(body["after"]))
    more["effects"]["drifts"][0]["blades"].append("B7")
    for wrong, why in (
        ({"after": more}, "more than to put"),
        ({"after": now.network}, "more than to put"),
        ({"blade": "B8"}, "more than to put"),
        ({"effects": []}, "not those"),
        ({"effects": [WEAR | {"value": "L2"}]}, "not those"),
        ({"diagnosis": "d2"}, "not adopted"),
        ({"number": 1}, "number 1"),
        ({"before": None}, "another network"),
        ({"extra": 1}, "more than to put"),
    ):
        with pytest.raises(ValueError, match=why):
            now.after(entry(JOINING, body | wrong))


@pytest.mark.parametrize("lot", ["L1", "L1.2", "A@3", "(b)", "7 2"])
def test_the_part_of_an_effect_is_the_one_that_the_diagnosis_adds(lot: str) -> None:
    network = Network("n", (), ())
    for family in FAMILIES:
        cell = Cell(family, "linear", "lot", lot)
        names = []
        for _ in range(3):  # adopted again and again, each numbered
            names.append(parameter_name(cell, network))
            prior = Prior("normal", -1.0, 1.0, 0.0, 0.5)
            new = Parameter(names[-1], "shared", prior, nominal=0.0)
            network = Network("n", (*network.parameters, new), ())
        for name in names:
            assert part_of({"name": cell.name}, [name, "another"]) == name
        assert part_of({"name": cell.name}, [f"{name} of" for name in names]) is None
        assert part_of({"name": cell.name}, []) is None


def test_a_sheet_knows_what_it_added_that_concerns_some_blades_only() -> None:
    after: Json = {"effects": {"drifts": [PART, {"name": "all"}], "biases": [], "parameters": []}}
    body = {"number": 1, "diagnosis": "d1", "effects": [WEAR], "before": None, "after": after}
    (sheet,) = Adopted(None).after(entry(ADOPTION, body)).sheets
    assert isinstance(sheet, Sheet)
    assert sheet.parts == {PART["name"]}
