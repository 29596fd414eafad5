"""The whole HTTP API against a model of it, by random sequences of requests (Hypothesis).

The model is a list of entries per rotor, a few lines of Python; it predicts the answer to every
request: which are accepted and with which number, which are repetitions, which conflict, which are
refused; what an If-Match or an Idempotency-Key makes of it; and that a version which was seen once
reads the same ever after. Every request is sent with a key, and the audit trail has to know it.
What lies beside the log has rules of its own (`tests.service.machine`): everything that is read,
moments, event streams, webhooks, exported files, diagnoses and adoptions, models and jobs, keys.
After each sequence every acknowledged reading is in the list exactly once with the status that the
model says, every page size gives the same list, the tables hold what the chaos study asks of them,
and a rotor that got the same entries in another order is sealed with the same bits. Every route of
the service has to have answered with what was asked for.

A few sequences by default; MACHINE_SEQUENCES=1000 in the environment makes a long run of it.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, Phase, Verbosity, seed
from hypothesis import settings as hypothesis_settings
from hypothesis.stateful import rule, run_state_machine_as_test
from sqlalchemy import text

from service.api.scopes import RULES
from service.settings import Settings
from service.store.unit_of_work import SqlStore
from service.studies.chaos.check import check
from tests.chaos import mutants
from tests.service.machine.base import Machine
from tests.service.machine.log import Log
from tests.service.machine.mutants import MUTANTS, Mutant
from tests.service.machine.steps import acts
from tests.service.machine.whole import Whole
from tests.service.naming import Naming, made_again

SEQUENCES = int(os.environ.get("MACHINE_SEQUENCES", "5"))
STEPS = 40
FIRST_SEED = 26  # each sequence has its own: of one seed, most are variations of others
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
def http(serving: Callable[..., AbstractContextManager[httpx.Client]]) -> Iterator[httpx.Client]:
    """A service that asks everybody for a key, and whose silent streams give a sign of life."""
    with serving(keys="always", rate_burst=10**9, heartbeat_s=0.05) as client:
        yield client


@pytest.fixture
def run(
    http: httpx.Client,
    store: SqlStore,
    elsewhere: SqlStore,
    science: Naming,
    settings: Settings,
    tmp_path: Path,
) -> Run:
    """Run the machine; how often each kind of request was answered with each status."""
    patient = {"max_attempts": 100, "keep_versions": 10_000, "keep_events": 10_000}
    fields: dict[str, Any] = {"http": http, "store": store, "elsewhere": elsewhere}
    fields |= {"service": settings.model_copy(update=patient), "science": science}

    def go(
        sequences: int, machine: type[Machine] = Whole, first: int = FIRST_SEED, **given: Any
    ) -> Counter[str]:
        requests = Counter[str]()
        own = fields | {"folder": tmp_path, "requests": requests}
        own["step"] = rule(one=acts(machine))(machine.step)
        profile = hypothesis_settings(
            max_examples=1,
            stateful_step_count=STEPS,
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
            verbosity=Verbosity.quiet,
            **given,
        )
        for number in range(sequences):
            wired = seed(first + number)(type("Wired", (machine,), own))
            run_state_machine_as_test(wired, settings=profile)
        return requests

    return go


def test_every_answer_is_what_the_model_predicts(run: Run, store: SqlStore) -> None:
    seen = run(SEQUENCES)
    statuses = {one.rpartition(" ")[2] for one in seen}
    assert {"200", "201", "202", "403", "404", "409", "412", "422"} <= statuses
    went = {one.rpartition(" ")[0] for one in seen if one.rpartition(" ")[2] < "300"}
    assert RULES.keys() - went == set(), "every route has answered with what was asked for"
    seen_in_tables(store)
    if os.environ.get("MACHINE_SEQUENCES"):
        told_of = {"sequences": SEQUENCES, "steps": STEPS, "requests": sum(seen.values())}
        told_of |= {"routes": sorted(RULES), "answers": dict(sorted(seen.items()))}
        print(json.dumps(told_of))


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
@pytest.mark.parametrize(
    ("mutant", "first"),
    [
        ("digest_not_compared", 28),
        ("repetition_not_known", FIRST_SEED),
        ("no_fence", 27),
        ("cursor_to_the_head", 28),
    ],
)
def test_a_broken_rule_is_noticed_by_the_machine(
    run: Run,
    store: SqlStore,
    mutant: str,
    first: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mutants.BREAK[mutant](monkeypatch.setattr)
    with pytest.raises(AssertionError):
        run_and_look(run, store, first=first)


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


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda one: one.words)
def test_a_broken_rule_beside_the_log_is_noticed_by_the_machine(
    run: Run, store: SqlStore, mutant: Mutant, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutant.name, mutant.broken)
    with pytest.raises(AssertionError):
        run_and_look(run, store, mutant.machine, mutant.first or FIRST_SEED)


def run_and_look(
    run: Run, store: SqlStore, machine: type[Machine] = Log, first: int = FIRST_SEED
) -> None:
    """Forty sequences from a seed on; what is broken is noticed by one of the first, or in the
    tables after it.
    """
    for number in range(40):
        run(1, machine, first + number, phases=[Phase.generate], report_multiple_bugs=False)
        seen_in_tables(store)


def seen_in_tables(store: SqlStore) -> None:
    """What the lists hold is compared with the model; here versions with the entries below them."""
    with store.read() as tx:
        every = "SELECT rotor_id, event_id, seq FROM event"
        told = {(r, e): s for r, e, s in tx.connection.execute(text(every))}
    assert check(store, told, again=made_again).faults == {}
