"""Whoever looks at a rotor is told which readings behind its adopted effects count no longer."""

from __future__ import annotations

import random
from collections.abc import Callable

import httpx
import pytest
from typer.testing import CliRunner

from core.log import Entry, effective
from core.observation import Inspection
from service.bootstrap import make_worker
from service.cli import app as commands
from service.entries import entries_of
from service.handlers.adoptions import adopt, back_out
from service.handlers.diagnoses import request_diagnosis
from service.handlers.inspections import retract
from service.handlers.no_longer import no_longer
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from tests.service.adopting import Offsets

Make = Callable[..., Inspection]
Post = Callable[..., int]
NAME = "campaign offset (campaign c2)"
OFF = {"c2": 0.1}


@pytest.fixture
def science() -> Offsets:
    return Offsets()


def by_the_fold(entries: list[Entry], through: int, head: int) -> list[str]:
    """The same by reading the whole log."""
    then = {one.id for one in effective(e for e in entries if e.seq <= through)}
    return sorted(then - {one.id for one in effective(e for e in entries if e.seq <= head)})


@pytest.mark.parametrize("seed", range(6))
def test_what_counts_no_longer_is_what_the_whole_log_says(
    store: SqlStore, rotor: str, reading: Make, post: Post, seed: int
) -> None:
    """Chains, early corrections, corrections of what is retracted, retracted corrections."""
    chance, ids = random.Random(seed), [f"i{n}" for n in range(14)]
    gone: set[str] = set()
    for number, name in enumerate(chance.sample(ids, len(ids))):
        below = ids[: ids.index(name)]  # no circles: they are refused
        named = chance.choice(below) if below and chance.random() < 0.6 else None
        post(
            rotor,
            reading(name, time_h=1e3 * (number + 1), replaces=named),
        )
        with store.read() as tx:
            there = {e.event_id for e in tx.log.entries(rotor, 0, 99, 99) if e.kind == "inspection"}
        if chance.random() < 0.4 and (left := sorted(there - gone)):
            gone.add(found := chance.choice(left))
            retract(store, rotor, found)
    with store.read() as tx:
        log = tx.log.entries(rotor, 0, 99, 99)
        entries, head = entries_of(log), log[-1].seq
        told = {
            (k, n): no_longer(tx, rotor, k, n) for n in range(1, head + 1) for k in range(n + 1)
        }
    assert told == {which: by_the_fold(entries, *which) for which in told}
    assert any(told.values())


def test_an_effect_whose_readings_were_retracted_since_says_which(
    api: httpx.Client,
    store: SqlStore,
    settings: Settings,
    science: Offsets,
    rotor: str,
    reading: Make,
    post: Post,
) -> None:
    """At the rotor, in `inspect`; not for versions before, nor once it is backed out."""
    worker = make_worker(store, science, settings, "w")
    diagnoser = make_worker(store, science, settings, "d", "diagnose")
    hours = {f"c{k}": 8e3 * k for k in (1, 2, 3, 4)}
    for blade in ("B1", "B2", "B3"):
        post(rotor, *(
            reading(
                f"{blade}-{c}", blade=blade, time_h=h, campaign=c, value=h / 1e5 + OFF.get(c, 0.0)
            )
            for c, h in hours.items()
        ))  # fmt: skip
    asked, _ = request_diagnosis(store, science, rotor, (), compare=True, horizon_h=None)
    diagnoser.drain()
    adopt(store, science, rotor, asked.id)
    post(rotor, reading("late", time_h=4e4, value=0.4))
    worker.drain()

    def told(version: int | None = None) -> list[str]:
        which = {} if version is None else {"version": str(version)}
        (effect,) = api.get(f"/v1/rotors/{rotor}", params=which).json()["effects"]
        assert effect["name"] == NAME
        lost: list[str] = effect["no_longer"]
        return lost

    def lines() -> list[str]:
        url = str(api.base_url)
        return CliRunner().invoke(commands, ["inspect", rotor, "--url", url]).stdout.splitlines()

    said = "           2 of the readings it was found with count no longer (B1-c2, B2-c2)"
    assert told() == []
    assert said not in lines()
    before, tag = (
        api.get(f"/v1/rotors/{rotor}").json()["version"],
        api.get(f"/v1/rotors/{rotor}").headers["etag"],
    )
    retract(store, rotor, "late")  # the diagnosis never saw it
    retract(store, rotor, "B1-c2")
    post(rotor, reading("B2-c2b", blade="B2", time_h=1.6e4, value=0.16, replaces="B2-c2"))
    worker.drain()
    assert told() == ["B1-c2", "B2-c2"]
    assert told(before) == [], "then they counted"
    assert said in lines()
    assert api.get(f"/v1/rotors/{rotor}").headers["etag"] != tag
    retract(store, rotor, "B2-c2b")
    worker.drain()
    assert told() == ["B1-c2"], "retracting a correction brings back what it corrected"
    back_out(store, science, rotor, asked.id)
    worker.drain()
    assert api.get(f"/v1/rotors/{rotor}").json()["effects"] == []
