"""The whole HTTP API against a model of it, by random sequences of requests (Hypothesis).

The model is a list of entries per rotor, a few lines of Python; it predicts the answer to every
request: which are accepted and with which number, which are repetitions, which conflict, which are
refused; what an If-Match or an Idempotency-Key makes of it; and that a version which was seen once
reads the same ever after. What lies beside the log has rules of its own (`machine_beside`):
moments, webhooks, exported files, diagnoses and adoptions. After each sequence every acknowledged
reading is in the list exactly once with the status that the model says, every page size gives the
same list, the tables hold what the chaos study asks of them, and a rotor that got the same entries
in another order is sealed with the same bits.

A few sequences by default; MACHINE_SEQUENCES=1000 in the environment makes a long run of it.
"""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, Phase, Verbosity
from hypothesis import settings as hypothesis_settings
from hypothesis.stateful import rule, run_state_machine_as_test
from sqlalchemy import ColumnElement, and_, text

from service.adopted import Adopted, adopted_at
from service.ports import Event, RotorRecord, Transaction
from service.settings import Settings
from service.store import tables as t
from service.store.log import SqlLog
from service.store.unit_of_work import SqlStore
from service.studies.chaos.check import check
from service.worker.claiming import rested
from tests.chaos import mutants
from tests.service.machine import Machine, acts
from tests.service.machine_beside import Adoptions, Hooks, Journeys, Moments, Whole
from tests.service.naming import Naming, made_again

SEQUENCES = int(os.environ.get("MACHINE_SEQUENCES", "6"))
STEPS = 40
Run = Callable[..., Counter[str]]


@pytest.fixture
def science() -> Naming:
    return Naming(provisional=True)


@pytest.fixture
def settings(settings: Settings, tmp_path: Path) -> Settings:
    key_file = tmp_path / "webhook_key"
    key_file.write_text("7d" * 32 + "\n")
    return settings.model_copy(update={"webhook_key_file": str(key_file)})


@pytest.fixture
def run(
    api: httpx.Client,
    store: SqlStore,
    elsewhere: SqlStore,
    science: Naming,
    settings: Settings,
    tmp_path: Path,
) -> Run:
    """Run the machine; how often each kind of request was answered with each status."""
    patient = {"max_attempts": 100, "keep_versions": 10_000, "keep_events": 10_000}
    fields: dict[str, Any] = {"http": api, "store": store, "elsewhere": elsewhere}
    fields |= {"service": settings.model_copy(update=patient), "science": science}

    def go(sequences: int, machine: type[Machine] = Whole, **given: Any) -> Counter[str]:
        requests = Counter[str]()
        own = fields | {"folder": tmp_path, "requests": requests}
        profile = hypothesis_settings(
            max_examples=sequences,
            stateful_step_count=STEPS,
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
            verbosity=Verbosity.quiet,
            derandomize=True,
            **given,
        )
        own["step"] = rule(one=acts(machine))(machine.step)
        run_state_machine_as_test(type("Wired", (machine,), own), settings=profile)
        return requests

    return go


def test_every_answer_is_what_the_model_predicts(run: Run, store: SqlStore) -> None:
    seen = run(SEQUENCES)
    statuses = {one.rpartition(" ")[2] for one in seen}
    assert {"200", "201", "202", "404", "409", "412", "422"} <= statuses
    changed = {"webhooks 201", "rotors/diagnoses/adoption 202"}
    assert {f"POST {one}" for one in changed} <= seen.keys()
    seen_in_tables(store)
    if os.environ.get("MACHINE_SEQUENCES"):
        told_of = {"sequences": SEQUENCES, "steps": STEPS, "requests": sum(seen.values())}
        print(json.dumps(told_of | {"answers": dict(sorted(seen.items()))}))


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
@pytest.mark.parametrize(
    "mutant", ["digest_not_compared", "repetition_not_known", "no_fence", "cursor_to_the_head"]
)
def test_a_broken_rule_is_noticed_by_the_machine(
    run: Run,
    store: SqlStore,
    mutant: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mutants.BREAK[mutant](monkeypatch.setattr)
    with pytest.raises(AssertionError):
        run_and_look(run, store)


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
@pytest.mark.parametrize(
    ("name", "broken"),
    [
        ("service.api.gate.guard_of", lambda request, rotor: None),
        ("service.api.repeats.fingerprint", lambda request, body: 64 * "0"),
        ("service.store.answers.SqlAnswers.begin", lambda self, *given: None),
    ],
    ids=["If-Match ignored", "every request the first one", "no request known again"],
)
def test_a_broken_manner_is_noticed_by_the_machine(
    run: Run,
    store: SqlStore,
    name: str,
    broken: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(name, broken)
    with pytest.raises(AssertionError):
        run_and_look(run, store)


restore = SqlLog.restore


def came_now(self: SqlLog, rotor_id: str, events: Sequence[Event]) -> None:
    restore(self, rotor_id, [replace(one, received_at=time.time()) for one in events])


def effects_of_now(tx: Transaction, rotor: RotorRecord, through: int | None = None) -> Adopted:
    return adopted_at(tx, rotor)


def due_out_of_turn(longest_s: float) -> ColumnElement[bool]:
    """Whatever of its rotor rests before it."""
    return and_(t.delivery.c.status == "pending", rested(t.delivery.c.not_before, longest_s))


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
@pytest.mark.parametrize(
    ("machine", "name", "broken"),
    [
        (Moments, "service.store.states.end_of", lambda at: at + 3600.0),
        (Hooks, "service.store.outbox.tell", lambda *given: None),
        (Hooks, "service.worker.deliver.due", due_out_of_turn),
        (Hooks, "service.store.webhooks._knows", lambda row, rotor: True),
        (Journeys, "service.store.log.SqlLog.restore", came_now),
        (Journeys, "service.handlers.transfer._same", lambda *given: None),
        (Adoptions, "service.handlers.adoptions.readings_since", lambda *given: 0),
        (Adoptions, "service.handlers.rotors.adopted_at", effects_of_now),
    ],
    ids=[
        "every moment is now",
        "webhooks told nothing",
        "deliveries out of turn",
        "webhooks told of every rotor",
        "imported entries came now",
        "imports not compared",
        "adoptions of readings that are gone",
        "effects of today in old versions",
    ],
)
def test_a_broken_rule_beside_the_log_is_noticed_by_the_machine(
    run: Run,
    store: SqlStore,
    machine: type[Machine],
    name: str,
    broken: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(name, broken)
    with pytest.raises(AssertionError):
        run_and_look(run, store, machine)


def run_and_look(run: Run, store: SqlStore, machine: type[Machine] = Machine) -> None:
    run(10, machine, phases=[Phase.generate], report_multiple_bugs=False)
    seen_in_tables(store)


def seen_in_tables(store: SqlStore) -> None:
    """What the lists hold is compared with the model; here versions with the entries below them."""
    with store.read() as tx:
        every = "SELECT rotor_id, event_id, seq FROM event"
        told = {(r, e): s for r, e, s in tx.connection.execute(text(every))}
    assert check(store, told, again=made_again).faults == {}
