"""The whole HTTP API against a model of it, by random sequences of requests (Hypothesis).

The model is a list of entries per rotor, a few lines of Python; it predicts the answer to every
request: which are accepted and with which number, which are repetitions, which conflict, which are
refused; what an If-Match or an Idempotency-Key makes of it; and that a version which was seen once
reads the same ever after. After each sequence every acknowledged reading is in the list exactly
once with the status that the model says, every page size gives the same list, the tables hold what
the chaos study asks of them, and a rotor that got the same entries in another order is sealed with
the same bits.

A few sequences by default; MACHINE_SEQUENCES=1000 in the environment makes a long run of it.
"""

from __future__ import annotations

import json
import os
import random
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, Phase, Verbosity
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    rule,
    run_state_machine_as_test,
)
from sqlalchemy import text

from service.bootstrap import make_worker
from service.errors import LostLeaseError
from service.settings import Settings
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.studies.chaos.check import check
from service.studies.chaos.twin import Descent
from service.worker import claiming, update
from service.worker import lease as leases
from tests.chaos import mutants

Json = dict[str, Any]
FIRST = ("B1", "B2")
SEQUENCES = int(os.environ.get("MACHINE_SEQUENCES", "5"))
STEPS = 25
rotors = st.sampled_from(["a", "b"])
names = st.sampled_from([f"i{n}" for n in range(8)])
blades = st.sampled_from(["B1", "B1", "B2", "B3"])
readings = st.fixed_dictionaries(
    {
        "id": names,
        "blade": blades,
        "quantity": st.just("elongation"),
        "time_h": st.sampled_from([1000.0, 24000.0]),
        "value": st.sampled_from([0.11, 0.2]),
    },
    optional={"replaces": names},
)


class Crash(Exception):
    """The worker dies here."""


@dataclass
class Modelled:
    """A rotor as the model has it: its log, and its blades with the facts that they came with."""

    particles: int
    created: bool = False
    entries: list[tuple[str, Json]] = field(default_factory=list)
    blades: set[str] = field(default_factory=lambda: set(FIRST))
    versions: dict[int, Json] = field(default_factory=dict)  # as they were seen first

    def seq(self, name: str) -> int:
        """Number of an entry, counted from 1; 0: it is not there."""
        return next((i for i, (known, _) in enumerate(self.entries, 1) if known == name), 0)

    def append(self, items: list[tuple[str, Json]]) -> tuple[int, list[int], bool]:
        """(status, numbers, whether all are repetitions): all or nothing."""
        before, numbers = len(self.entries), []
        for name, content in items:
            seq = self.seq(name)
            if seq and self.entries[seq - 1][1] != content:
                del self.entries[before:]
                return 409, [], False
            if not seq:
                self.entries.append((name, content))
                seq = len(self.entries)
            numbers.append(seq)
        return 202, numbers, len(self.entries) == before

    def wrong(self, given: list[Json]) -> int:
        """Of readings to be posted, how many are refused."""
        faults = [r for r in given if r["blade"] not in self.blades or r.get("replaces") == r["id"]]
        named = {r["id"]: r["replaces"] for r in given if "replaces" in r}
        links = {n: c.get("replaces") for n, c in self.entries if "/" not in n} | named

        def around(own: str) -> bool:
            passed, above = set[str](), links.get(own)
            while above is not None and above != own and above not in passed:
                passed.add(above)
                above = links.get(above)
            return above == own

        return len(faults) or int(any(around(own) for own in named))

    def listed(self) -> list[tuple[int, str, str]]:
        """(number, id, status) of every reading."""
        gone = {n.partition("/")[2] for n, _ in self.entries if n.startswith("retraction/")}
        own = [(i, n, c) for i, (n, c) in enumerate(self.entries, 1) if "/" not in n]
        names = {n: c.get("replaces") for _, n, c in own}
        over = set()
        for tip in names.keys() - gone:
            above, passed = names[tip], {tip}
            while above is not None and above not in passed:
                passed.add(above)
                above = names.get(above)
            over |= passed - {tip}
        return [
            (i, n, "retracted" if n in gone else "replaced" if n in over else "counts")
            for i, n, _ in own
        ]


def rotor_body(rotor: str, particles: int) -> Json:
    blades = [{"id": b} for b in FIRST]
    fixed = {"model": "rotor-blade", "blades": blades, "seed": 7}
    return {"id": rotor, "particles": particles} | fixed


class Machine(RuleBasedStateMachine):
    """Requests, workers that work, crash and race, and the model beside."""

    http: httpx.Client
    store: SqlStore
    service: Settings
    number = 0
    keys = 0
    requests: Counter[str]

    @initialize()
    def begin(self) -> None:
        Machine.number += 1
        self.prefix = f"s{Machine.number}"
        self.model: dict[str, Modelled] = {}
        self.workers = [
            make_worker(self.store, Descent(provisional=True), self.service, f"{self.prefix}{n}")
            for n in "xy"
        ]
        self.create("a", 64)

    def id(self, rotor: str) -> str:
        return self.prefix + rotor

    def path(self, rotor: str, *parts: str) -> str:
        return "/".join(["/v1/rotors", self.id(rotor), *parts])

    def send(self, method: str, path: str, **given: Any) -> httpx.Response:
        answer = self.http.request(method, path, **given)
        route = path.replace(self.prefix, "").split("/")
        self.requests[f"{method} {'/'.join(route[:3])} {answer.status_code}"] += 1
        assert answer.status_code < 500, answer.text
        return answer

    def expect(self, answer: httpx.Response, told: tuple[int, list[int], bool]) -> None:
        status, numbers, again = told
        assert answer.status_code == status, (answer.status_code, told, answer.text)
        if status == 202:
            assert [item["seq"] for item in answer.json()["items"]] == numbers
            assert answer.json()["head_seq"] == max(numbers)
            assert ("idempotent-replayed" in answer.headers) == again

    @rule(rotor=rotors, particles=st.sampled_from([64, 64, 64, 32]))
    def create(self, rotor: str, particles: int) -> None:
        answer = self.send("POST", "/v1/rotors", json=rotor_body(self.id(rotor), particles))
        there = self.model.setdefault(rotor, Modelled(particles))
        if there.particles != particles:
            assert answer.status_code == 409, answer.text
            return
        assert answer.status_code == 201, answer.text
        assert ("idempotent-replayed" in answer.headers) == there.created
        there.created = True

    def posted(self, rotor: str, given: list[Json], **request: Any) -> None:
        answer = self.send("POST", self.path(rotor, "inspections"), **request)
        model = self.model.get(rotor)
        if model is None:
            assert answer.status_code == 404
            return
        if wrong := model.wrong(given):
            assert answer.status_code == 422
            assert len(answer.json()["faults"]) >= wrong
            return
        self.expect(answer, model.append([(r["id"], r) for r in given]))

    @rule(rotor=rotors, one=readings)
    def post_one(self, rotor: str, one: Json) -> None:
        self.posted(rotor, [one], json=one)

    @rule(rotor=rotors, many=st.lists(readings, min_size=1, max_size=4))
    def post_many(self, rotor: str, many: list[Json]) -> None:
        self.posted(rotor, many, json={"inspections": many})

    @rule(rotor=rotors, many=st.lists(readings, min_size=1, max_size=4))
    def post_csv(self, rotor: str, many: list[Json]) -> None:
        columns = ["id", "blade", "quantity", "time_h", "value", "replaces"]
        lines = [",".join(str(row.get(c, "")) for c in columns) for row in many]
        content = "\n".join([",".join(columns), *lines])
        self.posted(rotor, many, content=content, headers={"content-type": "text/csv"})

    @rule(rotor=rotors, one=readings, between=st.booleans())
    def post_if_it_stands(self, rotor: str, one: Json, between: bool) -> None:
        """If-Match: accepted where nothing came between, else nothing is done."""
        model = self.model.get(rotor)
        if model is None:
            return
        header = {"If-Match": self.send("GET", self.path(rotor)).headers["etag"]}
        if not between:
            self.posted(rotor, [one], json=one, headers=header)
            return
        self.keys += 1
        fresh = {"blade": "B1", "quantity": "elongation", "time_h": 500.0, "value": 0.1}
        self.post_one(rotor, fresh | {"id": f"n{self.keys}"})
        if not model.wrong([one]):
            path = self.path(rotor, "inspections")
            assert self.send("POST", path, json=one, headers=header).status_code == 412

    @rule(rotor=rotors, one=readings, other=readings)
    def post_with_a_key(self, rotor: str, one: Json, other: Json) -> None:
        """Idempotency-Key: sent again it is answered again; another request with it is refused."""
        self.keys += 1
        path = self.path(rotor, "inspections")
        asked = {"headers": {"Idempotency-Key": f"{self.prefix}-{self.keys}"}}
        first = self.send("POST", path, json=one, **asked)
        model = self.model.get(rotor)
        if model is None or model.wrong([one]):
            assert first.status_code == (404 if model is None else 422)
            return
        self.expect(first, model.append([(one["id"], one)]))
        if first.status_code != 202:
            return
        again = self.send("POST", path, json=one, **asked)
        assert (again.status_code, again.json()) == (202, first.json())
        assert "idempotent-replayed" in again.headers
        if other != one:
            assert self.send("POST", path, json=other, **asked).status_code == 422

    @rule(rotor=rotors)
    def look_back(self, rotor: str) -> None:
        """Every version that was seen reads as it did."""
        model = self.model.get(rotor)
        for version, seen in ({} if model is None else model.versions).items():
            told = self.send("GET", self.path(rotor), params={"version": version}).json()
            assert told["posterior"] == seen

    @rule(rotor=rotors, fault=st.sampled_from(["{", '{"inspections": []}', '{"id": "i1"}', "[]"]))
    def post_nonsense(self, rotor: str, fault: str) -> None:
        answer = self.send("POST", self.path(rotor, "inspections"), content=fault)
        assert answer.status_code in (400, 422), answer.text

    @rule(rotor=rotors, name=names)
    def retract(self, rotor: str, name: str) -> None:
        answer = self.send("POST", self.path(rotor, "inspections", name, "retraction"))
        model = self.model.get(rotor)
        if model is None or not model.seq(name):
            assert answer.status_code == 404
            return
        self.expect(answer, model.append([(f"retraction/{name}", {})]))

    @rule(rotor=rotors, blade=blades, slot=st.sampled_from([None, None, "1"]))
    def join(self, rotor: str, blade: str, slot: str | None) -> None:
        body = {"id": blade} | ({} if slot is None else {"slot": slot})
        answer = self.send("POST", self.path(rotor, "blades"), json=body)
        model = self.model.get(rotor)
        if model is None:
            assert answer.status_code == 404
        elif blade in FIRST:
            self.expect(answer, (202, [0], True) if slot is None else (409, [], False))
        else:
            told = model.append([(f"blade/{blade}", {"slot": slot})])
            model.blades |= {blade} if told[0] == 202 else set()
            self.expect(answer, told)

    @rule(rotor=rotors, blade=blades)
    def retire(self, rotor: str, blade: str) -> None:
        answer = self.send("POST", self.path(rotor, "blades", blade, "retirement"))
        model = self.model.get(rotor)
        if model is None or blade not in model.blades:
            assert answer.status_code == 404
        else:
            self.expect(answer, model.append([(f"retirement/{blade}", {})]))

    @rule(rotor=rotors)
    def retry(self, rotor: str) -> None:
        answer = self.send("POST", self.path(rotor, "retry"))
        assert answer.status_code == (202 if rotor in self.model else 404)

    @rule(which=st.integers(0, 1))
    def work(self, which: int) -> None:
        self.workers[which].drain()

    @rule(which=st.integers(0, 1))
    def work_a_little(self, which: int) -> None:
        self.workers[which].updater.run_once()

    @rule(which=st.integers(0, 1), point=st.sampled_from(["advance", "write_state"]))
    def crash(self, which: int, point: str) -> None:
        """A worker dies in its commit; its lease runs out."""
        module: Any = leases if point == "advance" else update
        real = getattr(module, point)

        def dying(*given: Any, **named: Any) -> None:
            real(*given, **named)
            raise Crash

        with pytest.MonkeyPatch.context() as patch, suppress(Crash):
            patch.setattr(module, point, dying)
            self.workers[which].updater.run_once()
        self.expire()

    @rule(one=readings, overtaken=st.booleans())
    def race(self, one: Json, overtaken: bool) -> None:
        """An entry comes between a worker's reading and its commit; another worker may, too."""
        first, second = (worker.updater for worker in self.workers)
        lease = claiming.claim(self.store.engine, first.owner, 60.0)
        if lease is None:
            return
        task = first.read(lease)
        state = first.compute(task, quick=not lease.sealing)
        self.post_one("a", one)
        if overtaken:
            self.expire()
            second.run_once()
        with suppress(LostLeaseError):
            first.commit(lease, task, state, first.change(task, state))

    def expire(self) -> None:
        with transaction(self.store.engine, write=True) as connection:
            connection.execute(
                text("UPDATE cursor SET lease_until = 1.0 WHERE lease_until IS NOT NULL")
            )

    @rule(rotor=rotors, which=st.integers(0, 1))
    def wait(self, rotor: str, which: int) -> None:
        self.workers[which].drain()
        model = self.model.get(rotor)
        head = 0 if model is None else len(model.entries)
        answer = self.send("GET", self.path(rotor), params={"wait_for": head, "timeout": 1})
        if model is None:
            assert answer.status_code == 404
            return
        told = answer.json()
        assert (told["head_seq"], told["applied_seq"]) == (head, head)
        assert told["status"] == "current"
        assert told["posterior"]["sealed"]
        seen = told["posterior"]
        assert model.versions.setdefault(seen["version"], seen) == seen
        assert {b["id"] for b in told["blades"]} == model.blades
        gone = {n.partition("/")[2] for n, _ in model.entries if n.startswith("retirement/")}
        assert {b["id"] for b in told["blades"] if b["retired"]} == gone

    @rule(rotor=rotors, size=st.integers(1, 5))
    def pages(self, rotor: str, size: int) -> None:
        model = self.model.get(rotor)
        if model is not None:
            assert self.listed(self.path(rotor, "inspections"), size) == model.listed()

    @rule(rotor=rotors, name=names)
    def look(self, rotor: str, name: str) -> None:
        answer = self.send("GET", self.path(rotor, "inspections", name))
        model = self.model.get(rotor)
        if model is None or not model.seq(name):
            assert answer.status_code == 404
            return
        told, content = answer.json(), model.entries[model.seq(name) - 1][1]
        assert (told["seq"], told["id"], told["status"]) in model.listed()
        assert told["values"] == [content["value"]]

    def listed(self, path: str, size: int) -> list[tuple[int, str, str]]:
        found: list[tuple[int, str, str]] = []
        cursor: str | None = None
        while True:
            params = {"limit": str(size)} | ({} if cursor is None else {"cursor": cursor})
            page = self.send("GET", path, params=params).json()
            assert len(page["items"]) <= size
            found += [(item["seq"], item["id"], item["status"]) for item in page["items"]]
            cursor = page["next"]
            if cursor is None:
                return found

    def teardown(self) -> None:
        if not hasattr(self, "model"):
            return
        self.expire()
        self.workers[0].drain()
        for rotor, model in self.model.items():
            path = self.path(rotor)
            assert self.listed(f"{path}/inspections", 50) == model.listed()
            again = self.permuted(f"{self.id(rotor)}-permuted", model)
            told = [self.send("GET", one).json() for one in (path, f"/v1/rotors/{again}")]
            assert [one["applied_seq"] for one in told] == [len(model.entries)] * 2
            assert all(one["posterior"]["sealed"] for one in told)
            assert told[0]["posterior"]["state_digest"] == told[1]["posterior"]["state_digest"]

    def permuted(self, rotor: str, model: Modelled) -> str:
        """The same entries in another order: what needs another one after it, that is all."""
        self.send("POST", "/v1/rotors", json=rotor_body(rotor, model.particles))
        left = list(model.entries)
        random.Random(rotor).shuffle(left)
        there, base = set(FIRST), f"/v1/rotors/{rotor}"
        while left:
            for name, content in list(left):
                kind, _, target = name.rpartition("/")
                needs = target if kind else content["blade"]
                if kind != "blade" and needs not in there:
                    continue
                if kind == "blade":
                    given = {k: v for k, v in content.items() if v is not None}
                    answer = self.send("POST", f"{base}/blades", json={"id": target} | given)
                elif kind == "retirement":
                    answer = self.send("POST", f"{base}/blades/{target}/retirement")
                elif kind == "retraction":
                    answer = self.send("POST", f"{base}/inspections/{target}/retraction")
                else:
                    answer = self.send("POST", f"{base}/inspections", json=content)
                assert answer.status_code == 202, answer.text
                there.add(target)
                left.remove((name, content))
        self.workers[0].drain()
        return rotor


def run(
    http: httpx.Client, store: SqlStore, settings: Settings, sequences: int, **given: Any
) -> Counter[str]:
    """Run the machine; how often each kind of request was answered with each status."""
    patient = {"max_attempts": 100, "keep_versions": 10_000, "keep_events": 10_000}
    service, requests = settings.model_copy(update=patient), Counter[str]()
    fields = {"http": http, "store": store, "service": service, "requests": requests}
    wired = type("Wired", (Machine,), fields)
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
    run_state_machine_as_test(wired, settings=profile)
    return requests


def test_every_answer_is_what_the_model_predicts(
    api: httpx.Client, store: SqlStore, settings: Settings
) -> None:
    seen = run(api, store, settings, SEQUENCES)
    statuses = {one.rpartition(" ")[2] for one in seen}
    assert {"200", "201", "202", "404", "409", "412", "422"} <= statuses
    seen_in_tables(store)
    if os.environ.get("MACHINE_SEQUENCES"):
        told_of = {"sequences": SEQUENCES, "steps": STEPS, "requests": sum(seen.values())}
        print(json.dumps(told_of | {"answers": dict(sorted(seen.items()))}))


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
@pytest.mark.parametrize(
    "mutant", ["digest_not_compared", "repetition_not_known", "no_fence", "cursor_to_the_head"]
)
def test_a_broken_rule_is_noticed_by_the_machine(
    api: httpx.Client,
    store: SqlStore,
    settings: Settings,
    mutant: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mutants.BREAK[mutant](monkeypatch.setattr)
    with pytest.raises(AssertionError):
        run_and_look(api, store, settings)


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
    api: httpx.Client,
    store: SqlStore,
    settings: Settings,
    name: str,
    broken: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(name, broken)
    with pytest.raises(AssertionError):
        run_and_look(api, store, settings)


def run_and_look(api: httpx.Client, store: SqlStore, settings: Settings) -> None:
    run(api, store, settings, 40, phases=[Phase.generate], report_multiple_bugs=False)
    seen_in_tables(store)


def seen_in_tables(store: SqlStore) -> None:
    """What the lists hold is compared with the model; here versions with the entries below them."""
    with store.read() as tx:
        every = "SELECT rotor_id, event_id, seq FROM event"
        told = {(r, e): s for r, e, s in tx.connection.execute(text(every))}
    assert check(store, told).faults == {}
