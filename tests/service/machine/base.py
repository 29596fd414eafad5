"""The state machine of `test_machine`: a client with a key, and the model beside.

The rules lie in the other modules, each a subclass: `log` (requests about readings and blades,
workers that work, crash and race), `reads`, `moments`, `streams`, `hooks`, `journeys`, `adoptions`,
`models` and `keys`; `Whole` has all of them.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import httpx
from hypothesis import assume
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize
from sqlalchemy import text

from service.access import SCOPES
from service.api.scopes import RULES, Found, Table
from service.bootstrap import make_worker
from service.handlers.keys import create_key
from service.settings import Settings
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from tests.service.machine.steps import Key, act, asking, rotor_body, rotors
from tests.service.modelled import FIRST, Json, Modelled
from tests.service.naming import Naming

Row = tuple[str, str, int, tuple[int, int] | None]  # method, path, status, entries appended
ROUTES = Table(RULES)


class Machine(RuleBasedStateMachine):
    """Requests, workers that work, crash and race, and the model beside."""

    http: httpx.Client
    store: SqlStore
    elsewhere: SqlStore
    service: Settings
    science: Naming
    folder: Path
    number = 0
    fresh = 0
    requests: Counter[str]

    @initialize(own=st.integers(0, 2**32))
    def begin(self, own: int) -> None:
        assume(own)  # the simplest sequence of all is tried first, and tells nothing
        Machine.number += 1
        self.prefix = f"s{Machine.number}"
        self.model: dict[str, Modelled] = {}
        self.heads: dict[str, int] = {}
        self.trails: dict[str, list[Row]] = {}
        self.key = self.new_key(SCOPES)
        self.workers = [
            make_worker(self.store, self.science, self.service, f"{self.prefix}{n}") for n in "xy"
        ]
        self.diagnoser = make_worker(
            self.store, self.science, self.service, f"{self.prefix}d", "diagnose"
        )
        self.create("a", 64)
        first = {"blade": "B1", "quantity": "elongation", "time_h": 500.0, "value": 0.1}
        many = [first | {"id": f"in-{c}", "campaign": c} for c in ("c1", "c2")]
        self.posted("a", many, json={"inspections": many})

    def step(self, one: tuple[str, Json]) -> None:
        name, given = one
        getattr(self, name)(**given)

    def id(self, rotor: str) -> str:
        return self.prefix + rotor

    def path(self, rotor: str, *parts: str) -> str:
        return "/".join(["/v1/rotors", self.id(rotor), *parts])

    def new_key(self, scopes: Sequence[str], only: Sequence[str] = ()) -> Key:
        made, token = create_key(self.store, "machine", scopes, only)
        return Key(made.id, token, made.scopes, made.rotors)

    def send(self, method: str, path: str, by: Key | None = None, **given: Any) -> httpx.Response:
        """A request with a key (None: that which may do everything); the audit trail's row of it
        and its route are remembered."""
        key = by or self.key
        headers = {"Authorization": f"Bearer {key.token}"} | given.pop("headers", {})
        answer = self.http.request(method, path, headers=headers, **given)
        self.count(method, path, answer)
        if method != "GET" and answer.status_code != 401:
            self.trails.setdefault(key.id, []).append(self.row(method, path, answer))
        return answer

    def count(self, method: str, path: str, answer: httpx.Response) -> None:
        route = ROUTES.find(method, path)
        assert isinstance(route, Found)
        self.requests[f"{route.name} {answer.status_code}"] += 1
        assert answer.status_code < 500, answer.text

    def row(self, method: str, path: str, answer: httpx.Response) -> Row:
        """What the audit trail has to say of a request that changes something, or was to."""
        rotor = path.removeprefix("/v1/rotors/").partition("/")[0]
        before = self.heads.get(rotor, 0)
        head = answer.json().get("head_seq", before)
        self.heads[rotor] = max(before, head)
        appended = (before + 1, head) if head > before else None
        return method, path, answer.status_code, appended

    def pages_of(self, path: str, size: int, **asked: str) -> list[Json]:
        """What a list holds, page by page."""
        found: list[Json] = []
        cursor: str | None = None
        while True:
            params = asked | {"limit": str(size)} | ({} if cursor is None else {"cursor": cursor})
            page = self.send("GET", path, params=params).json()
            assert len(page["items"]) <= size
            found += page["items"]
            cursor = page["next"]
            if cursor is None:
                return found

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

    def posted(self, rotor: str, given: list[Json], by: Key | None = None, **request: Any) -> None:
        answer = self.send("POST", self.path(rotor, "inspections"), by, **request)
        model = self.model.get(rotor)
        if model is None:
            assert answer.status_code == 404
            return
        if wrong := model.wrong(given):
            assert answer.status_code == 422
            assert len(answer.json()["faults"]) >= wrong
            return
        self.expect(answer, model.append([(r["id"], r) for r in given], (by or self.key).id))

    def drain(self, which: int = 0) -> None:
        """Everything is applied and sealed, every job done, and residuals are those of now."""
        self.workers[which].drain()
        self.diagnoser.drain()

    def expire(self) -> None:
        with transaction(self.store.engine, write=True) as connection:
            connection.execute(
                text("UPDATE cursor SET lease_until = 1.0 WHERE lease_until IS NOT NULL")
            )

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

    def listed(self, path: str, size: int) -> list[tuple[int, str, str]]:
        items = self.pages_of(path, size)
        return [(item["seq"], item["id"], item["status"]) for item in items]

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
