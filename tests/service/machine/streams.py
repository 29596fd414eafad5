"""Event streams: each version once, in order, from any event on."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import httpx
from hypothesis import strategies as st

from service.sse import HEARTBEAT, events
from tests.service.machine.log import Log
from tests.service.machine.steps import act, rotors
from tests.service.modelled import Json, Modelled

CHANGES = {"adoption": "adopted", "back-out": "backed-out"}
ENDS = {"diagnosed": "done", "diagnosis-failed": "failed", "diagnosis-cancelled": "cancelled"}
KINDS = {"applied", "residuals", *ENDS, *CHANGES.values()}


class Streams(Log):
    """A client that listens, loses its connection, and goes on."""

    @act(
        3,
        rotor=rotors,
        begins=st.sampled_from(["first", "first", "known", "known", "newest", "future"]),
        which=st.integers(0, 30),
        reconnects=st.booleans(),
    )
    def listen(self, rotor: str, begins: str, which: int, reconnects: bool) -> None:
        model = self.model.get(rotor)
        if model is None:
            answer = self.send("GET", self.path(rotor, "events"))
            assert answer.status_code == 404
        elif begins == "first":
            self.from_the_first(rotor, model)
        elif begins == "newest":
            assert self.told(rotor) == self.from_the_first(rotor, model)[-1:]
        elif begins == "future":
            self.from_nowhere(rotor)
        else:
            self.from_one(rotor, model, which, reconnects)

    def from_the_first(self, rotor: str, model: Modelled) -> list[Json]:
        """What was told before is told again; after it comes what happened since."""
        told = self.told(rotor, after=0)
        assert told[: len(model.notes)] == model.notes
        model.notes = told
        numbers = [one["id"] for one in told]
        assert numbers == sorted(set(numbers))
        assert {one["rotor"] for one in told} <= {self.id(rotor)}
        assert {one["event"] for one in told} <= KINDS
        self.compare_versions(rotor, model, [one for one in told if one["event"] == "applied"])
        for kind, status in ENDS.items():
            ended = [one["diagnosis"] for one in told if one["event"] == kind]
            assert sorted(ended) == sorted(d.id for d in model.diagnoses if d.status == status)
        self.compare_changes(model, told)
        alarms = [one["alarms"] for one in told if one["event"] == "residuals"]
        now = self.send("GET", self.path(rotor, "residuals")).json()["alarms"]
        assert now == (alarms or [0])[-1]
        return told

    @staticmethod
    def compare_changes(model: Modelled, told: list[Json]) -> None:
        """Each entry that adopted or backed out is told once, in order; not those of a file."""
        own = {one.id for one in model.diagnoses}
        assert [
            (one["event"], one["seq"], one["diagnosis"])
            for one in told
            if one["event"] in CHANGES.values()
        ] == [
            (CHANGES[kind], seq, content["diagnosis"])
            for seq, (name, content) in enumerate(model.entries, 1)
            if (kind := name.partition("/")[0]) in CHANGES and content["diagnosis"] in own
        ]

    def compare_versions(self, rotor: str, model: Modelled, told: list[Json]) -> None:
        """Each version is told once; those that were read are as they were read."""
        now = self.send("GET", self.path(rotor)).json()
        assert [one["version"] for one in told] == list(range(1, now["version"] + 1))
        through = [one["through_seq"] for one in told]
        assert through == sorted(through)
        for one in told:
            seen = model.versions.get(one["version"], one)
            assert (one["through_seq"], one["sealed"]) == (seen["through_seq"], seen["sealed"])

    def from_one(self, rotor: str, model: Modelled, which: int, reconnects: bool) -> None:
        """From an event on that was told before, by its number in either place."""
        whole = self.from_the_first(rotor, model)
        if whole:
            at = which % len(whole)
            number = whole[at]["id"]
            header = {"Last-Event-ID": str(number)} if reconnects else {}
            rest = self.told(rotor, after=0 if reconnects else number, headers=header)
            assert rest == whole[at + 1 :]

    def from_nowhere(self, rotor: str) -> None:
        """A number that no event has: the client is told to read the rotor again."""
        told = self.told(rotor, after=2**61)
        assert [one["event"] for one in told] == ["reset"]
        (reset,) = told
        now = self.send("GET", self.path(rotor)).json()
        assert (reset["version"], reset["through_seq"]) == (now["version"], now["applied_seq"])
        assert self.told(rotor, after=reset["id"]) == []

    def told(
        self, rotor: str, after: int | None = None, headers: dict[str, str] | None = None
    ) -> list[Json]:
        """What a stream tells until it falls silent."""
        path = self.path(rotor, "events")
        given = {"Authorization": f"Bearer {self.key.token}"} | (headers or {})
        params = {} if after is None else {"after": after}
        with self.http.stream("GET", path, params=params, headers=given) as answer:
            self.count("GET", path, answer)
            assert answer.status_code == 200
            return list(events(until_silent(answer)))


def until_silent(answer: httpx.Response) -> Iterator[str]:
    return itertools.takewhile(lambda line: line != HEARTBEAT.strip(), answer.iter_lines())
