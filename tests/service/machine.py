"""The state machine of `test_machine`: requests, workers that work, crash and race.

What lies beside the log and the workers (moments, webhooks, files, diagnoses) adds its rules in
`machine_beside`.
"""

from __future__ import annotations

import inspect
import random
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize
from sqlalchemy import text

from service.api.routers.diagnoses import EXAMPLE
from service.bootstrap import make_worker
from service.errors import LostLeaseError
from service.settings import Settings
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.worker import claiming, update
from service.worker import lease as leases
from tests.service.modelled import FIRST, Json, Modelled
from tests.service.naming import Naming

Act = Callable[..., None]
rotors = st.sampled_from(["a", "a", "b"])
names = st.sampled_from([f"i{n}" for n in range(8)])
blades = st.sampled_from(["B1", "B1", "B2", "B3"])
campaigns = st.sampled_from(["c1", "c2"])
readings = st.fixed_dictionaries(
    {
        "id": names,
        "blade": blades,
        "quantity": st.just("elongation"),
        "time_h": st.sampled_from([1000.0, 24000.0]),
        "value": st.sampled_from([0.11, 0.2]),
    },
    optional={"replaces": names, "campaign": campaigns},
)


def act(weight: int = 1, **given: st.SearchStrategy[Any]) -> Callable[[Act], Act]:
    """A step of the machine, how often it is taken beside others, and what it is given."""

    def mark(step: Act) -> Act:
        step.__dict__["given"] = weight * [st.fixed_dictionaries(given)]
        return step

    return mark


def acts(machine: type[Machine]) -> st.SearchStrategy[tuple[str, Json]]:
    """Any of its steps. (Rules of Hypothesis are switched off at random, most of them in most
    sequences, which leaves little of a few short ones.)"""
    found = {name: getattr(step, "given", []) for name, step in inspect.getmembers(machine)}
    return st.one_of([st.tuples(st.just(n), one) for n, given in found.items() for one in given])


class Crash(Exception):
    """The worker dies here."""


def rotor_body(rotor: str, particles: int) -> Json:
    blades = [{"id": b} for b in FIRST]
    fixed = {"model": "rotor-blade", "blades": blades, "seed": 7}
    return {"id": rotor, "particles": particles} | fixed


def asking(campaign: str) -> Json:
    """A diagnosis that looks for a campaign's offset (`naming`)."""
    return {"families": [EXAMPLE["families"][0] | {"name": campaign}]}


class Machine(RuleBasedStateMachine):
    """Requests, workers that work, crash and race, and the model beside."""

    http: httpx.Client
    store: SqlStore
    elsewhere: SqlStore
    service: Settings
    science: Naming
    folder: Path
    number = 0
    keys = 0
    requests: Counter[str]

    @initialize()
    def begin(self) -> None:
        Machine.number += 1
        self.prefix = f"s{Machine.number}"
        self.model: dict[str, Modelled] = {}
        self.workers = [
            make_worker(self.store, self.science, self.service, f"{self.prefix}{n}") for n in "xy"
        ]
        self.diagnoser = make_worker(
            self.store, self.science, self.service, f"{self.prefix}d", "diagnose"
        )
        self.create("a", 64)
        first = {"blade": "B1", "quantity": "elongation", "time_h": 500.0, "value": 0.1}
        self.post_many("a", [first | {"id": f"in-{c}", "campaign": c} for c in ("c1", "c2")])

    def step(self, one: tuple[str, Json]) -> None:
        name, given = one
        getattr(self, name)(**given)

    def id(self, rotor: str) -> str:
        return self.prefix + rotor

    def path(self, rotor: str, *parts: str) -> str:
        return "/".join(["/v1/rotors", self.id(rotor), *parts])

    def send(self, method: str, path: str, **given: Any) -> httpx.Response:
        answer = self.http.request(method, path, **given)
        _, _, kind, *rest = path.split("/")
        route = "/".join([kind, *(part for part in rest[1:] if part.isalpha())])
        self.requests[f"{method} {route} {answer.status_code}"] += 1
        assert answer.status_code < 500, answer.text
        return answer

    def expect(self, answer: httpx.Response, told: tuple[int, list[int], bool]) -> None:
        status, numbers, again = told
        assert answer.status_code == status, (answer.status_code, told, answer.text)
        if status == 202:
            assert [item["seq"] for item in answer.json()["items"]] == numbers
            assert answer.json()["head_seq"] == max(numbers)
            assert ("idempotent-replayed" in answer.headers) == again

    @act(rotor=rotors, particles=st.sampled_from([64, 64, 64, 32]))
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

    @act(rotor=rotors, one=readings)
    def post_one(self, rotor: str, one: Json) -> None:
        self.posted(rotor, [one], json=one)

    @act(rotor=rotors, many=st.lists(readings, min_size=1, max_size=4))
    def post_many(self, rotor: str, many: list[Json]) -> None:
        self.posted(rotor, many, json={"inspections": many})

    @act(rotor=rotors, many=st.lists(readings, min_size=1, max_size=4))
    def post_csv(self, rotor: str, many: list[Json]) -> None:
        columns = ["id", "blade", "quantity", "time_h", "value", "replaces", "campaign"]
        lines = [",".join(str(row.get(c, "")) for c in columns) for row in many]
        content = "\n".join([",".join(columns), *lines])
        self.posted(rotor, many, content=content, headers={"content-type": "text/csv"})

    @act(2, rotor=rotors, one=readings, between=st.booleans())
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

    @act(rotor=rotors, one=readings, other=readings)
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

    @act(rotor=rotors)
    def look_back(self, rotor: str) -> None:
        """Every version that was seen reads as it did."""
        model = self.model.get(rotor)
        if model is None:
            return
        for version, seen in model.versions.items():
            told = self.send("GET", self.path(rotor), params={"version": version}).json()
            assert told["posterior"] == seen
            self.compare(model, told)

    @act(rotor=rotors, fault=st.sampled_from(["{", '{"inspections": []}', '{"id": "i1"}', "[]"]))
    def post_nonsense(self, rotor: str, fault: str) -> None:
        answer = self.send("POST", self.path(rotor, "inspections"), content=fault)
        assert answer.status_code in (400, 422), answer.text

    @act(rotor=rotors, name=names)
    def retract(self, rotor: str, name: str) -> None:
        answer = self.send("POST", self.path(rotor, "inspections", name, "retraction"))
        model = self.model.get(rotor)
        if model is None or not model.seq(name):
            assert answer.status_code == 404
            return
        self.expect(answer, model.append([(f"retraction/{name}", {})]))

    @act(rotor=rotors, blade=blades, slot=st.sampled_from([None, None, "1"]))
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

    @act(rotor=rotors, blade=blades)
    def retire(self, rotor: str, blade: str) -> None:
        answer = self.send("POST", self.path(rotor, "blades", blade, "retirement"))
        model = self.model.get(rotor)
        if model is None or blade not in model.blades:
            assert answer.status_code == 404
        else:
            self.expect(answer, model.append([(f"retirement/{blade}", {})]))

    @act(rotor=rotors)
    def retry(self, rotor: str) -> None:
        answer = self.send("POST", self.path(rotor, "retry"))
        assert answer.status_code == (202 if rotor in self.model else 404)

    @act(which=st.integers(0, 1))
    def work(self, which: int) -> None:
        self.drain(which)

    def drain(self, which: int = 0) -> None:
        """Everything is applied and sealed, and every diagnosis done."""
        self.workers[which].drain()
        while self.diagnoser.jobs.run_once():
            pass

    @act(which=st.integers(0, 1))
    def work_a_little(self, which: int) -> None:
        self.workers[which].updater.run_once()

    @act(which=st.integers(0, 1), point=st.sampled_from(["advance", "write_state"]))
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

    @act(one=readings, overtaken=st.booleans())
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

    @act(2, rotor=rotors, which=st.integers(0, 1))
    def wait(self, rotor: str, which: int) -> None:
        self.drain(which)
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
        self.compare(model, told)

    def compare(self, model: Modelled, told: Json) -> None:
        """A rotor's answer, as it stands or stood, with the model as of the same entry."""
        seen = told["posterior"]
        assert model.versions.setdefault(seen["version"], seen) == seen
        through = seen["through_seq"]
        if seen["sealed"]:
            digest = seen["state_digest"]
            assert model.sealed.setdefault(through, digest) == digest
        joined, gone = (model.of_kind(kind, through) for kind in ("blade", "retirement"))
        assert {b["id"] for b in told["blades"]} == {*FIRST, *joined}
        assert {b["id"] for b in told["blades"] if b["retired"]} == set(gone)
        effects = [(one["diagnosis"], one["value"]) for one in told["effects"]]
        assert effects == model.sheets(through)

    @act(rotor=rotors, size=st.integers(1, 5))
    def pages(self, rotor: str, size: int) -> None:
        model = self.model.get(rotor)
        if model is not None:
            assert self.listed(self.path(rotor, "inspections"), size) == model.listed()

    @act(rotor=rotors, name=names)
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
        self.drain()
        for rotor, model in self.model.items():
            path = self.path(rotor)
            assert self.listed(f"{path}/inspections", 50) == model.listed()
            again = self.permuted(f"{self.id(rotor)}-permuted", model)
            told = [self.send("GET", one).json() for one in (path, f"/v1/rotors/{again}")]
            assert told[0]["applied_seq"] == len(model.entries)
            assert told[1]["applied_seq"] == told[1]["head_seq"]
            assert all(one["posterior"]["sealed"] for one in told)
            self.compare(model, told[0])
            if [one["value"] for one in told[1]["effects"]] == [c for _, c in model.sheets()]:
                digests = {one["posterior"]["state_digest"] for one in told}
                assert len(digests) == 1

    def permuted(self, rotor: str, model: Modelled) -> str:
        """The same entries in another order: what needs another one after it, that is all."""
        self.send("POST", "/v1/rotors", json=rotor_body(rotor, model.particles))
        left = [one for one in model.entries if not one[0].startswith(("adoption/", "back-out/"))]
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
        self.drain()
        for _, campaign in model.sheets():
            asked = self.send("POST", f"{base}/diagnoses", json=asking(campaign))
            self.drain()
            self.send("POST", f"{base}/diagnoses/{asked.json()['diagnosis']['id']}/adoption")
        self.drain()
        return rotor
