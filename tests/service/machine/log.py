"""Readings and blades come and go, and workers apply them, die and race."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import pytest
from hypothesis import strategies as st

from service.errors import LostLeaseError
from service.worker import claiming, new_version
from service.worker import lease as leases
from tests.service.machine.base import Machine
from tests.service.machine.steps import act, rotors
from tests.service.modelled import FIRST, Json

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
    optional={"replaces": names, "campaign": st.sampled_from(["c1", "c2"])},
)


class Crash(Exception):
    """The worker dies here."""


class Log(Machine):
    """Requests, and workers that work, crash and race."""

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
        self.post_fresh(rotor)
        if not model.wrong([one]):
            path = self.path(rotor, "inspections")
            assert self.send("POST", path, json=one, headers=header).status_code == 412

    def post_fresh(self, rotor: str) -> None:
        """A reading that nobody has posted yet."""
        self.fresh += 1
        fresh = {"blade": "B1", "quantity": "elongation", "time_h": 500.0, "value": 0.1}
        self.post_one(rotor, fresh | {"id": f"n{self.fresh}"})

    @act(rotor=rotors, one=readings, other=readings)
    def post_with_a_key(self, rotor: str, one: Json, other: Json) -> None:
        """Idempotency-Key: sent again it is answered again; another request with it is refused."""
        self.fresh += 1
        path = self.path(rotor, "inspections")
        asked = {"headers": {"Idempotency-Key": f"{self.prefix}-{self.fresh}"}}
        first = self.send("POST", path, json=one, **asked)
        model = self.model.get(rotor)
        if model is None or model.wrong([one]):
            assert first.status_code == (404 if model is None else 422)
            return
        self.expect(first, model.append([(one["id"], one)], self.key.id))
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
        self.expect(answer, model.append([(f"retraction/{name}", {})], self.key.id))

    @act(rotor=rotors, blade=blades, slot=st.sampled_from([None, None, "1"]))
    def join(self, rotor: str, blade: str, slot: str | None) -> None:
        body = {"id": blade} | ({} if slot is None else {"slot": slot})
        answer = self.send("POST", self.path(rotor, "blades"), json=body)
        model = self.model.get(rotor)
        if model is None:
            assert answer.status_code == 404
        elif model.seq(f"retirement/{blade}"):
            self.expect(answer, (409, [], False))
        elif blade in FIRST:
            self.expect(answer, (202, [0], True) if slot is None else (409, [], False))
        else:
            told = model.append([(f"blade/{blade}", {"slot": slot})], self.key.id)
            model.blades |= {blade} if told[0] == 202 else set()
            self.expect(answer, told)

    @act(rotor=rotors, blade=blades)
    def retire(self, rotor: str, blade: str) -> None:
        answer = self.send("POST", self.path(rotor, "blades", blade, "retirement"))
        model = self.model.get(rotor)
        if model is None or blade not in model.blades:
            assert answer.status_code == 404
        else:
            self.expect(answer, model.append([(f"retirement/{blade}", {})], self.key.id))

    @act(rotor=rotors)
    def retry(self, rotor: str) -> None:
        answer = self.send("POST", self.path(rotor, "retry"))
        assert answer.status_code == (202 if rotor in self.model else 404)

    @act(rotor=rotors)
    def decide(self, rotor: str) -> None:
        """To adopt by itself, and no longer: nothing ends between the two."""
        for adopt in ("effect", "never"):
            answer = self.send("POST", self.path(rotor, "policy"), json={"adopt": adopt})
            assert answer.status_code == (200 if rotor in self.model else 404)
            if rotor in self.model:
                told = answer.json()
                assert (told["adopt"], told["diagnose"]) == (adopt, "never")
                assert told["policy_since"] is not None

    @act(which=st.integers(0, 1))
    def work(self, which: int) -> None:
        self.drain(which)

    @act(which=st.integers(0, 1))
    def work_a_little(self, which: int) -> None:
        self.workers[which].updater.run_once()

    @act(which=st.integers(0, 1), point=st.sampled_from(["advance", "write_state"]))
    def crash(self, which: int, point: str) -> None:
        """A worker dies in its commit; its lease runs out."""
        module: Any = leases if point == "advance" else new_version
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
        assert told["posted_by"] == model.posters[name]
