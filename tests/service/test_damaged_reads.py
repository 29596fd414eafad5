"""What was damaged in the database is served to nobody: reads say what it is and what to do."""

from __future__ import annotations

from collections.abc import Callable

import httpx
import pytest
from sqlalchemy import text

from core.observation import Inspection
from service.handlers.listing import FEW
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker

Post = Callable[..., int]
Reading = Callable[..., Inspection]
ROTOR = "/v1/rotors/r1"
READS = (
    *("", "?version=1", "/posterior", "/blades", "/blades/B1/posterior"),
    *("/blades/B1/prediction?times=1000", "/plan?blade=B1", "/life?limit=1"),
)


@pytest.fixture
def worn(
    api: httpx.Client, rotor: str, worker: Worker, post: Post, reading: Reading
) -> httpx.Client:
    """A client of a rotor with a version, which a blade has joined."""
    post(rotor, reading("a", value=0.11))
    api.post(f"{ROTOR}/blades", json={"id": "B9"}).raise_for_status()
    worker.drain()
    return api


@pytest.mark.parametrize(
    ("change", "path"),
    [
        ("body = replace(body, '0.11', '0.12')", "/plan?blade=B1"),
        ("kind = 'of-2040'", "/plan?blade=B1"),
        ("kind = 'adoption'", ""),
        ("kind = 'adoption'", "/blades/B1/prediction?times=1000"),
        ("body = replace(body, '0.11', '0.12')", "/inspections"),
        ("body = replace(body, '0.11', '0.12')", "/inspections/a"),
        ("body = replace(body, 'B1', 'B2')", "/inspections?blade=B1"),
        ("blade = 'B2'", "/inspections"),
        ("body = 'x'", "/inspections"),
    ],
)
def test_a_read_over_a_damaged_entry_names_it(
    api: httpx.Client,
    store: SqlStore,
    rotor: str,
    worker: Worker,
    post: Post,
    reading: Reading,
    change: str,
    path: str,
) -> None:
    post(rotor, reading("a", value=0.11))
    worker.drain()
    with transaction(store.engine, write=True) as connection:
        done = connection.execute(text(f"UPDATE event SET {change} WHERE rotor_id = 'r1'"))
        assert done.rowcount == 1
    answer = api.get(f"{ROTOR}{path}")
    assert answer.status_code == 503, answer.text
    assert answer.json()["type"].endswith("damaged")
    assert answer.json()["faults"][0]["value"] == "a"


def test_a_long_reading_that_a_list_shows_short_is_held_against_its_columns(
    api: httpx.Client, store: SqlStore, rotor: str
) -> None:
    scan = {"id": "s", "blade": "B1", "quantity": "deformation", "time_h": 8000.0}
    scan |= {"nodes": list(range(FEW + 1)), "values": (FEW + 1) * [[0.1, 0.2, 0.3]]}
    api.post(f"{ROTOR}/inspections", json=scan).raise_for_status()
    (one,) = api.get(f"{ROTOR}/inspections").json()["items"]
    assert one["count"] == FEW + 1
    with transaction(store.engine, write=True) as connection:
        connection.execute(text("UPDATE event SET time_h = time_h + 1.0 WHERE event_id = 's'"))
    answer = api.get(f"{ROTOR}/inspections")
    assert (answer.status_code, answer.json()["faults"][0]["value"]) == (503, "s")


@pytest.mark.parametrize("path", READS)
@pytest.mark.parametrize(
    ("change", "whose"),
    [
        ("UPDATE rotor SET seed = seed + 1", "rotor r1"),
        ("UPDATE rotor SET head_seq = head_seq + 1", "head_seq"),
        ("UPDATE blade SET coating_lot = 'another' WHERE id = 'B2'", "rotor r1"),
        ("UPDATE blade SET coating_lot = 'another' WHERE id = 'B9'", "blade B9"),
        ("UPDATE blade SET retired_seq = 2 WHERE id = 'B1'", "blade B1"),
        ("DELETE FROM blade WHERE id = 'B9'", "blade B9"),
    ],
)
def test_a_read_of_a_damaged_rotor_says_what_is_damaged(
    worn: httpx.Client,
    store: SqlStore,
    change: str,
    whose: str,
    path: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also of a rotor at rest, which no worker looks at."""
    with transaction(store.engine, write=True) as connection:
        assert connection.execute(text(change)).rowcount == 1
    answer = worn.get(f"{ROTOR}{path}")
    assert answer.status_code == 503, answer.text
    assert answer.json()["type"].endswith("damaged")
    assert whose in answer.json()["detail"]
    monkeypatch.setattr("service.store.creation.check", lambda *given: None)
    assert worn.get(f"{ROTOR}{path}").status_code == 200, "without the comparison nobody sees it"


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE rotor SET particles = particles + 1",
        "UPDATE blade SET known = '{}' WHERE id = 'B1'",
        "UPDATE blade SET retired_seq = NULL WHERE id = 'B1'",
        "DELETE FROM blade WHERE id = 'B1'",
    ],
)
def test_what_was_sound_is_compared_again_when_it_reads_otherwise(
    worn: httpx.Client, store: SqlStore, worker: Worker, change: str
) -> None:
    """Also where it reads as it did when it was compared, and the blade has left since."""
    for path in READS:
        assert worn.get(f"{ROTOR}{path}").status_code == 200
    if "retired" in change:
        worn.post(f"{ROTOR}/blades/B1/retirement").raise_for_status()
        worker.drain()
    with transaction(store.engine, write=True) as connection:
        assert connection.execute(text(change)).rowcount == 1
    answer = worn.get(f"{ROTOR}/blades/B1/posterior?version=1")
    assert answer.status_code == 503, answer.text
    assert answer.json()["type"].endswith(":damaged")


def test_a_blocked_rotor_still_says_why(
    worn: httpx.Client, store: SqlStore, rotor: str, worker: Worker, post: Post, reading: Reading
) -> None:
    with transaction(store.engine, write=True) as connection:
        connection.execute(text("UPDATE rotor SET seed = seed + 1"))
    post(rotor, reading("b", time_h=9000.0))
    worker.drain()
    told = worn.get(ROTOR).raise_for_status().json()
    assert told["status"] == "blocked"
    assert "rotor r1" in told["last_error"]["error"]
    assert worn.get(f"{ROTOR}/posterior").status_code == 503
