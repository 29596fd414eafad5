"""An export of which one field has another type is refused in one line, or means nothing else."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest

from core.errors import BladetwinError
from core.observation import Inspection
from service.api.rotor_answers import view_out
from service.api.routers.adoptions import adoption_out
from service.bootstrap import make_worker
from service.digests import as_created, digest_of_json, digest_of_rotor
from service.handlers.adoptions import adopt, history
from service.handlers.blades import add_blade, retire_blade
from service.handlers.diagnoses import request_diagnosis
from service.handlers.inspections import Item, post_inspections, retract
from service.handlers.policy import decide
from service.handlers.rotors import create_rotor, view_rotor
from service.handlers.transfer_in import import_rotor
from service.handlers.transfer_out import export_rotor
from service.ports import BladeRecord
from service.settings import Settings
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from tests.service.adopting import Lots
from tests.service.test_joining import LOTS, Make, read
from tests.service.test_transfer import Members, agreed, packed, sign, unpacked

Place = tuple[str | int, ...]
Rows = dict[str, list[Any]]
OTHERS: tuple[Any, ...] = (None, 7, "text", [1], {"a": 1})
ALIKE = {("log.jsonl", n) for n in range(1, 15)} | {("blades.jsonl", n) for n in (1, 3)}
NETWORK = {
    "quantities": {
        "elongation": {
            "discrepancy": {
                "kind": "constant",
                "prior": {"kind": "uniform", "low": -0.1, "high": 0.1},
            },
            "by_instrument": True,
        }
    },
    "forgetting_h": 20_000.0,
}


@pytest.fixture
def elsewhere(tmp_path: Path, sqlite_template: Path) -> Iterator[SqlStore]:
    """An empty database, of the kind that is written in least time."""
    shutil.copy(sqlite_template, tmp_path / "elsewhere.db")
    opened = SqlStore(open_engine(f"sqlite:///{tmp_path / 'elsewhere.db'}"))
    yield opened
    opened.close()


@pytest.fixture
def database_url(tmp_path: Path, sqlite_template: Path) -> str:
    """Of what is exported: the file is the same on both databases."""
    shutil.copy(sqlite_template, tmp_path / "here.db")
    return f"sqlite:///{tmp_path / 'here.db'}"


@pytest.fixture
def science() -> Lots:
    return Lots()


@pytest.fixture
def adopted(
    store: SqlStore, science: Lots, settings: Settings, reading: Make, tmp_path: Path
) -> Path:
    """Of a rotor with a network of its own, and an effect of a lot in it since the last entry."""
    blades = [BladeRecord(name, lot=lot) for name, lot in LOTS.items()]
    create_rotor(store, "r1", "rotor-blade", blades, 64, 7, network=NETWORK)
    for blade, lot in LOTS.items():
        post_inspections(store, "r1", [Item("", one) for one in read(reading, blade, lot)])
    make_worker(store, science, settings, "w").drain()
    job, _ = request_diagnosis(store, science, "r1", (), compare=True, horizon_h=None)
    make_worker(store, science, settings, "d", "diagnose").drain()
    adopt(store, science, "r1", job.id)
    export_rotor(store, "r1", tmp_path / "adopted.zip", "test")
    return tmp_path / "adopted.zip"


@pytest.fixture
def whole(
    store: SqlStore, science: Lots, settings: Settings, reading: Make, adopted: Path, tmp_path: Path
) -> Path:
    """The same with a policy and an entry of every kind, sealed."""
    add_blade(store, "r1", BladeRecord("B9", lot="L1", slot="9", time_h0=5.0))
    more = {"sigma": 0.01, "instrument": "gauge", "observed_at": "2031-05-04T10:00Z"}
    scan = {"time_h": 9000.0, "nodes": np.array([3, 9]), "sigma": 0.1}
    sent = [
        reading("x", blade="B9", **more),
        Inspection("scan", "B9", "deformation", values=np.full((2, 3), 0.1), **scan),
        reading("y", blade="B9", replaces="x"),
    ]
    for one in sent:
        post_inspections(store, "r1", [Item("", one)])
    retract(store, "r1", "y")
    retire_blade(store, "r1", "B3")
    decide(store, "r1", "effect", "alarm")
    make_worker(store, science, settings, "w").drain()
    export_rotor(store, "r1", tmp_path / "whole.zip", "test")
    return tmp_path / "whole.zip"


def rows_of(members: Members) -> Rows:
    """Every object of the file; of an entry its body, too."""
    found = {name: [json.loads(one) for one in data.splitlines()] for name, data in members.items()}
    for entry in found["log.jsonl"]:
        entry["body"] = json.loads(entry["body"])
    return found


def places(value: Any, at: Place = ()) -> Iterator[tuple[Place, Any]]:
    """Every field below, by its path."""
    inside: Any = ()
    if isinstance(value, dict):
        inside = value.items()
    elif isinstance(value, list):
        inside = enumerate(value)
    for key, one in inside:
        if len(at) > 1:
            yield (*at, key), one
        yield from places(one, (*at, key))


def changed(rows: Rows, place: Place, other: Any) -> Members:
    """The file with one field changed, and every digest made to agree where one can be made."""
    rows = deepcopy(rows)
    holder: Any = rows
    for key in place[:-1]:
        holder = holder[key]
    holder[place[-1]] = other
    for number, entry in enumerate(rows["log.jsonl"]):
        body = entry["body"]
        entry["body"] = digest_of_json(body)[0] if isinstance(body, dict) else body
        if place[:3] == ("log.jsonl", number, "body"):
            entry["digest"] = digest_of(entry["kind"], body)
    told = rows["rotor.json"][0]
    if place[0] in ("rotor.json", "blades.jsonl") and place[-1] != "digest":
        with suppress(Exception):
            first = as_created([BladeRecord(**one) for one in rows["blades.jsonl"]])
            asks = (told["particles"], told["seed"], told["network"])
            told["digest"] = digest_of_rotor(told["id"], told["model"], first, *asks)
    lines = {
        name: b"".join(json.dumps(one).encode() + b"\n" for one in own)
        for name, own in rows.items()
    }
    if place[0] != "manifest.json":
        return agreed(lines)
    return lines if place[-1] == "sha256" else lines | {"manifest.json": sign(rows[place[0]][0])}


def digest_of(kind: str, body: Any) -> str:
    """As whoever forges it would make it."""
    if kind != "inspection":
        return digest_of_json(body)[1]
    with suppress(Exception):
        return Inspection.from_json(body).digest()
    return "0"


def others(now: Any) -> Iterator[Any]:
    """Values of other types, the field's own as a text among them."""
    for other in (*OTHERS, json.dumps(now)):
        if type(other) is not type(now):
            yield other


def imported(store: SqlStore, science: Lots, rows: Rows, place: Place, bad: Path) -> int:
    """How many of the forgeries of a field were taken; each can be read then."""
    taken = 0
    now: Any = rows
    for key in place:
        now = now[key]
    for other in others(now):
        packed(changed(rows, place, other), bad)
        name = f"copy-{uuid4().hex}"
        try:
            done = import_rotor(store, science, bad, name)
        except Exception as error:
            if isinstance(error, BladetwinError) and "\n" not in str(error):
                continue
            raise AssertionError(f"{place} = {other!r}: {type(error).__name__}: {error}") from error
        taken += 1
        assert json.dumps([view_out(view_rotor(store, name)), done.to_json()])
        assert [adoption_out(name, one) for one in history(store, name, 0, 10)]
    return taken


def test_a_field_of_another_type_is_refused_in_one_line(
    elsewhere: SqlStore, science: Lots, whole: Path, tmp_path: Path
) -> None:
    """Deep in a network, an effect or a reading it ended with an AttributeError or a TypeError."""
    rows = rows_of(unpacked(whole))
    every = [p for p, _ in places(rows) if p[:2] not in ALIKE and "before" not in p]
    assert len(every) > 150
    taken = {place: imported(elsewhere, science, rows, place, tmp_path / "x") for place in every}
    assert taken["rotor.json", 0, "origin"] == 2, "negative control: what may be a text may be one"
    for place in (
        ("manifest.json", 0, "state", "digest"),
        ("rotor.json", 0, "network", "quantities"),
        ("log.jsonl", 16, "body", "after", "effects", "biases", 0, "name"),
    ):
        assert taken[place] == 0, place
    packed(changed(rows, ("rotor.json", 0, "seed"), 7), tmp_path / "x")
    assert import_rotor(elsewhere, science, tmp_path / "x").new, "the forger's tools are harmless"


def test_an_effect_that_no_later_entry_contradicts_is_held_against_its_types(
    elsewhere: SqlStore, science: Lots, adopted: Path, tmp_path: Path
) -> None:
    rows = rows_of(unpacked(adopted))
    last = ("log.jsonl", len(rows["log.jsonl"]) - 1, "body")
    every = [place for place, _ in places(rows) if place[:3] == last and len(place) > 3]
    taken = {place: imported(elsewhere, science, rows, place, tmp_path / "x") for place in every}
    for name in ("name", "value", "whom", "clock", "amplitude"):
        assert taken[*last, "effects", 0, name] <= 2, "null, or another text"
    assert taken[*last, "effects", 0] == taken[*last, "effects"] == 0
