"""Where names share the evidence, somebody who knows which it is adopts an alternative."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from sqlalchemy import update
from typer.testing import CliRunner

from core.observation import Inspection
from service.cli import app as commands
from service.client import Client
from service.handlers.diagnoses import find_diagnosis
from service.handlers.rotors import view_rotor
from service.handlers.transfer_in import import_rotor
from service.handlers.transfer_out import export_rotor
from service.ports import Json
from service.store import tables as t
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.service.adopting import Doubtful
from tests.service.test_adoption import OFF, bands, called, diagnosed, refused, visits

Make = Callable[..., Inspection]
Post = Callable[..., int]
C2, C3 = "campaign offset (campaign c2)", "campaign offset (campaign c3)"
WHY = "the scanner's log of outage 2"


@pytest.fixture
def science() -> Doubtful:
    return Doubtful()


@pytest.fixture
def doubtful(
    store: SqlStore,
    science: Doubtful,
    rotor: str,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
) -> str:
    """The path of the adoption of a diagnosis whose names share the evidence; c2 is off."""
    post(rotor, *visits(reading, OFF))
    worker.drain()
    found = diagnosed(store, science, diagnoser)
    result = find_diagnosis(store, rotor, found).result or {}
    assert (result["verdict"], result["names"]) == ("not separable", [C2, C3])
    return f"/v1/rotors/r1/diagnoses/{found}/adoption"


def own(store: SqlStore, path: str) -> str:
    return path.split("/")[-2]


@pytest.mark.parametrize(("number", "name", "campaign"), [(1, C2, "c2"), (2, C3, "c3")])
def test_the_chosen_one_is_in_the_model_as_it_was_calibrated_and_goes_out_bit_for_bit(
    api: httpx.Client,
    store: SqlStore,
    doubtful: str,
    worker: Worker,
    number: int,
    name: str,
    campaign: str,
) -> None:
    before, was = called(store), bands(api)
    sent = api.post(doubtful, json={"alternative": number, "because": WHY})
    assert sent.status_code == 202, sent.text
    told = sent.json()["adoption"]
    result = find_diagnosis(store, "r1", own(store, doubtful)).result or {}
    calibrated = result["alternatives"]["each"][number - 1]["adoption"]["model"]
    assert told["models"] == {"before": result["models"]["before"], "after": calibrated}
    assert told["chosen"] == {"alternative": number, "because": WHY}
    with store.read() as tx:
        (heard,) = [n.payload for n in tx.outbox.after("r1", 0, 100) if n.kind == "adopted"]
    assert heard["chosen"] == told["chosen"]
    assert heard["posted_by"] == told["posted_by"] == "loopback"
    assert told["unasked"] is False
    worker.drain()
    rotor = api.get("/v1/rotors/r1").json()
    (effect,) = rotor["effects"]
    assert (effect["name"], effect["chosen"]) == (name, told["chosen"])
    assert rotor["network"]["effects"]["biases"][0]["campaign"] == campaign
    after = bands(api)
    assert after["rests_on"]["model_digest"] == calibrated
    truth = 0.5 * 1.0  # mm at 50,000 h; to choose the wrong one does not help
    nearer = abs(after["mean"][1] - truth) < 0.25 * abs(was["mean"][1] - truth)
    assert nearer is (campaign == "c2")
    assert api.delete(doubtful).status_code == 202
    worker.drain()
    assert called(store) == before


def test_without_a_choice_a_set_is_no_claim_and_the_refusal_says_how_to_choose(
    api: httpx.Client, store: SqlStore, doubtful: str
) -> None:
    told = refused(api.post(doubtful))
    assert "separate" in told["detail"]
    assert "its `alternative`, and `because`" in told["detail"]
    assert view_rotor(store, "r1").rotor.head_seq == 12


@pytest.mark.parametrize("several", [[C2, C3], []])
def test_too_many_names_to_be_an_answer_are_chosen_from_as_well(
    api: httpx.Client, store: SqlStore, doubtful: str, several: list[str]
) -> None:
    """The refusal did not say so where the verdict has no name."""
    result = find_diagnosis(store, "r1", own(store, doubtful)).result or {}
    changed = {"verdict": "unattributed", "names": [], "several": several}
    changed |= {} if several else {"alternatives": None}
    with transaction(store.engine, write=True) as connection:
        which = t.job.c.id == own(store, doubtful)
        given = json.dumps(result | changed)
        connection.execute(update(t.job).where(which).values(result=given))
    assert ("`alternative`" in refused(api.post(doubtful))["detail"]) is bool(several)
    sent = api.post(doubtful, json={"alternative": 1, "because": WHY})
    assert sent.status_code == (202 if several else 409), sent.text


@pytest.mark.parametrize(
    ("body", "field", "words"),
    [
        ({"alternative": 3, "because": WHY}, "alternative", "is none of its 2 alternatives"),
        ({"alternative": 1}, "because", "is missing"),
        ({"because": WHY}, "alternative", "is missing"),
        ({"alternative": 0, "because": WHY}, "alternative", "greater"),
        ({"alternative": 1, "because": ""}, "because", "at least 1"),
        ({"alternative": 1.5, "because": WHY}, "alternative", "integer"),
        ({"number": 1, "because": WHY}, "number", "not"),
    ],
)
def test_what_is_no_choice_is_refused_and_nothing_is_changed(
    api: httpx.Client, store: SqlStore, doubtful: str, body: Json, field: str, words: str
) -> None:
    sent = api.post(doubtful, json=body)
    assert sent.status_code == 422, sent.text
    (fault,) = sent.json()["faults"]
    assert field in fault["field"], fault
    assert words in sent.text
    assert view_rotor(store, "r1").rotor.head_seq == 12


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"alternatives": None}, "has no alternatives to choose from"),
        ({"alternatives": {"each": [{"effects": []}]}}, "of a release that did not say"),
        ({"models": {"before": "another", "after": "another"}}, "it was made for model another"),
    ],
)
def test_a_diagnosis_that_has_none_to_adopt_is_refused_with_what_to_do(
    api: httpx.Client, store: SqlStore, doubtful: str, change: Json, words: str
) -> None:
    """One of an older release, one that was not asked to compare, one of another model."""
    result = find_diagnosis(store, "r1", own(store, doubtful)).result or {}
    with transaction(store.engine, write=True) as connection:
        given = json.dumps(result | change)
        which = t.job.c.id == own(store, doubtful)
        connection.execute(update(t.job).where(which).values(result=given))
    told = refused(api.post(doubtful, json={"alternative": 1, "because": WHY}))
    assert words in told["detail"]
    assert view_rotor(store, "r1").rotor.head_seq == 12


def test_the_same_choice_gives_its_entry_again_and_another_has_to_wait_for_the_back_out(
    api: httpx.Client, doubtful: str
) -> None:
    first = api.post(doubtful, json={"alternative": 2, "because": WHY})
    again = api.post(doubtful, json={"alternative": 2, "because": "in other words"})
    assert again.json() == first.json()
    assert again.headers["idempotent-replayed"] == "true"
    for other in ({"alternative": 1, "because": WHY}, None):
        told = refused(api.post(doubtful, json=other))
        assert "its alternative 2 is in the model, by entry 13" in told["detail"]
        assert "backs it out first" in told["detail"]
    assert api.delete(doubtful).status_code == 202
    sent = api.post(doubtful, json={"alternative": 1, "because": WHY})
    assert (sent.status_code, sent.json()["adoption"]["effects"][0]["name"]) == (202, C2)
    listed = api.get("/v1/rotors/r1/adoptions").json()["items"]
    chosen = [one["chosen"] and one["chosen"]["alternative"] for one in listed]
    assert chosen == [2, None, 1]


def test_what_is_adopted_as_claimed_is_not_chosen_once_more(
    api: httpx.Client, store: SqlStore, doubtful: str
) -> None:
    result = find_diagnosis(store, "r1", own(store, doubtful)).result or {}
    claim = result["alternatives"]["each"][0]["adoption"]
    claimed = {"verdict": "effect", "adds": claim["adds"], "effects": claim["effects"]}
    claimed |= {"models": result["models"] | {"after": claim["model"]}}
    with transaction(store.engine, write=True) as connection:
        which = t.job.c.id == own(store, doubtful)
        given = json.dumps(result | claimed)
        connection.execute(update(t.job).where(which).values(result=given))
    assert api.post(doubtful).json()["adoption"]["chosen"] is None
    told = refused(api.post(doubtful, json={"alternative": 1, "because": WHY}))
    assert "what it claims is in the model" in told["detail"]


def test_a_rotor_that_adopts_by_itself_chooses_nothing(
    api: httpx.Client,
    store: SqlStore,
    science: Doubtful,
    rotor: str,
    post: Post,
    reading: Make,
    worker: Worker,
    diagnoser: Worker,
) -> None:
    api.post("/v1/rotors/r1/policy", json={"adopt": "effect"}).raise_for_status()
    post(rotor, *visits(reading, OFF))
    worker.drain()
    found = diagnosed(store, science, diagnoser)
    assert (find_diagnosis(store, rotor, found).result or {})["verdict"] == "not separable"
    assert api.get("/v1/rotors/r1/adoptions").json()["items"] == []


def test_why_it_was_chosen_goes_with_the_rotor(
    api: httpx.Client,
    store: SqlStore,
    science: Doubtful,
    doubtful: str,
    worker: Worker,
    tmp_path: Path,
) -> None:
    api.post(doubtful, json={"alternative": 2, "because": WHY}).raise_for_status()
    worker.drain()
    export_rotor(store, "r1", tmp_path / "r1.zip", "test")
    import_rotor(store, science, tmp_path / "r1.zip", "r2")
    worker.drain()
    (effect,) = view_rotor(store, "r2").adopted.effects
    assert effect["chosen"] == {"alternative": 2, "because": WHY}


def test_commands_and_client_choose_and_tell_why(
    api: httpx.Client, store: SqlStore, doubtful: str, worker: Worker
) -> None:
    url, found = str(api.base_url), own(store, doubtful)
    run = lambda *words: CliRunner().invoke(commands, [*words, "--url", url])  # noqa: E731
    told = run("adopt", "r1", found, "--alternative", "2", "--because", WHY)
    assert told.exit_code == 0, told.output
    assert f"alternative 2, because: {WHY}" in told.stdout
    assert f"{C3}: " in told.stdout
    assert told.stdout.count(" mm added to elongation\n") == 1, "the chosen one has its unit"
    worker.drain()
    (line,) = [x for x in run("inspect", "r1").stdout.splitlines() if x.startswith("  effect ")]
    assert line.endswith(f"alternative 2, because: {WHY}")
    wrong = run("adopt", "r1", found, "--back-out", "--alternative", "2")
    assert wrong.exit_code != 0
    assert view_rotor(store, "r1").rotor.head_seq == 13
    with Client(url) as twin:
        twin.back_out("r1", found)
        assert twin.adopt("r1", found, alternative=1, because=WHY)["adoption"]["seq"] == 15
