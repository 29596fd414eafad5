"""Everything that is read of a rotor, held against its version and against what was read before."""

from __future__ import annotations

import csv
from collections import Counter
from io import BytesIO

import httpx
from hypothesis import strategies as st
from pyarrow.parquet import read_table

from tests.service.machine.log import Log, blades
from tests.service.machine.steps import act, rotors
from tests.service.modelled import FIRST, Json, Modelled

Asked = dict[str, str]
OF_ROTOR: tuple[tuple[str, Asked], ...] = (
    ("posterior", {}),
    ("posterior", {"format": "netcdf"}),
    ("draws", {"count": "3"}),
    ("series", {"times": "8000,24000"}),
    ("field", {"quantity": "ceeq", "times": "8000", "blades": "B1"}),
    ("plan", {"count": "1"}),
    ("life", {"limit": "0.3", "times": "8000,24000"}),
)
OF_BLADE: tuple[tuple[str, Asked], ...] = (
    ("posterior", {}),
    ("draws", {"count": "3", "format": "netcdf"}),
    ("prediction", {"times": "8000,24000"}),
    ("prediction", {"times": "8000", "format": "csv"}),
    ("prediction", {"times": "8000", "format": "sensorthings"}),
    ("life", {"limit": "0.3"}),
    ("field", {"quantity": "ceeq", "time_h": "8000"}),
    ("field", {"quantity": "ceeq", "time_h": "8000", "format": "vtu"}),
    ("field", {"quantity": "deformation", "times": "8000", "format": "npz"}),
    ("field", {"quantity": "ceeq", "times": "8000", "format": "arrow"}),
)
OPEN = ("/", "/models", "/models/rotor-blade", "/operations", "/healthz", "/readyz")
PAGES = ("", "/readings", "/blades/B1", "/blades/B1/3d", "/residuals", "/diagnoses", "/diagnoses/0")


class Reads(Log):
    """Answers that rest on a version are its own, the same bytes whenever they are asked for."""

    @act(
        3,
        rotor=rotors,
        blade=blades,
        what=st.sampled_from([*(one for one, _ in OF_ROTOR), "prediction"]),
        back=st.integers(0, 3),
    )
    def read(self, rotor: str, blade: str, what: str, back: int) -> None:
        """One question of the rotor, and of a blade; of today and of `back` versions ago."""
        model = self.model.get(rotor)
        if model is None:
            answer = self.send("GET", self.path(rotor, "posterior"))
            assert answer.status_code == 404
            return
        now = self.send("GET", self.path(rotor)).json()
        version = now["version"] - back
        for parts, asked in self.questions(blade, what):
            answer = self.send("GET", self.path(rotor, *parts), params=asked)
            self.judge(model, answer, now, parts)
            if answer.status_code == 200:
                self.as_before(model, parts, asked, now["version"], answer)
                tag = {"If-None-Match": answer.headers["etag"]}
                again = self.send("GET", self.path(rotor, *parts), params=asked, headers=tag)
                assert (again.status_code, again.content) == (304, b"")
            if version > 0:
                older = self.send(
                    "GET", self.path(rotor, *parts), params=asked | {"version": str(version)}
                )
                if older.status_code == 200:
                    self.as_before(model, parts, asked, version, older)
                else:
                    refused = 404 if parts[0] == "blades" else 422 if parts[0] == "plan" else None
                    assert older.status_code == refused

    @staticmethod
    def questions(blade: str, what: str) -> list[tuple[tuple[str, ...], Asked]]:
        of_rotor = [((name,), asked) for name, asked in OF_ROTOR if name == what]
        return of_rotor + [
            (("blades", blade, name), asked) for name, asked in OF_BLADE if name == what
        ]

    @staticmethod
    def judge(model: Modelled, answer: httpx.Response, now: Json, parts: tuple[str, ...]) -> None:
        """404: no such blade; 409: not yet; 422: nothing runs that could be inspected; else it
        rests on the newest version."""
        named = parts[1] if parts[0] == "blades" else FIRST[0]
        joined = {*FIRST, *model.of_kind("blade", now["applied_seq"])}
        if named not in model.blades:
            assert answer.status_code == 404, answer.text
        elif now["version"] == 0 or named not in joined:
            assert answer.status_code == 409, answer.text
        elif parts == ("plan",) and joined <= {*model.of_kind("retirement", now["applied_seq"])}:
            assert answer.status_code == 422, answer.text
        else:
            assert answer.status_code == 200, answer.text
            if answer.headers["content-type"] == "application/json":
                basis, seen = answer.json()["rests_on"], now["posterior"]
                for name in ("version", "through_seq", "sealed", "state_digest", "events_digest"):
                    assert basis[name] == seen[name]

    @staticmethod
    def as_before(
        model: Modelled,
        parts: tuple[str, ...],
        asked: Asked,
        version: int,
        answer: httpx.Response,
    ) -> None:
        """The same bytes, whether the version is asked for by its number or was the newest."""
        question = (f"{'/'.join(parts)} {asked}", version)
        assert model.reads.setdefault(question, answer.content) == answer.content
        tags, tag = model.tags.setdefault(str(answer.url), {}), answer.headers["etag"]
        assert tags.setdefault(version, tag) == tag
        assert len(set(tags.values())) == len(tags)

    @act(rotor=rotors, size=st.integers(1, 3))
    def glance(self, rotor: str, size: int) -> None:
        """Blades with how many of their readings count, and every version there was."""
        model = self.model.get(rotor)
        if model is None:
            for part in ("blades", "versions", "residuals"):
                assert self.send("GET", self.path(rotor, part)).status_code == 404
            return
        now = self.send("GET", self.path(rotor)).json()
        versions = self.pages_of(self.path(rotor, "versions"), size + 5)
        assert [one["version"] for one in versions] == list(range(now["version"], 0, -1))
        for one in versions:
            seen = model.versions.get(one["version"], {})
            assert {name: one[name] for name in seen} == seen
        self.compare_residuals(rotor, model, now)
        self.compare_files(rotor, model)
        if not versions:
            assert self.send("GET", self.path(rotor, "blades")).status_code == 409
            return
        told = {one["id"]: one for one in self.pages_of(self.path(rotor, "blades"), size)}
        assert told.keys() == {b["id"] for b in now["blades"] if b["added_seq"] <= now_ends(now)}
        every = Counter(c["blade"] for n, c in model.entries if "/" not in n)
        counting = Counter(c["blade"] for c in model.counting().values())
        for blade, one in told.items():
            read = one["readings"]
            assert read["counting"] == counting[blade]
            assert read["counting"] + read["overruled"] == every[blade]

    def compare_residuals(self, rotor: str, model: Modelled, now: Json) -> None:
        """Of a version that is kept: a row for each reading that counted then, none for others."""
        told = self.send("GET", self.path(rotor, "residuals")).json()
        basis = told["as_of"]
        current = basis is not None and basis["version"] == now["version"]
        assert told["pending"] or current or told["error"] is not None or not model.entries
        assert not told["pending"] or model.entries
        if basis is None:
            assert told["items"] == []
            return
        items = self.pages_of(self.path(rotor, "residuals"), 3)
        counted = model.counting(basis["through_seq"])
        assert sorted(one["inspection"] for one in items) == sorted(counted)

    def compare_files(self, rotor: str, model: Modelled) -> None:
        """Of readings: those that count, or all with their status."""
        path, counting = self.path(rotor, "inspections"), list(model.counting())
        text = self.send("GET", path, params={"format": "csv"}).text
        assert [row["id"] for row in csv.DictReader(text.splitlines())] == counting
        things = self.send("GET", path, params={"format": "sensorthings"})
        assert things.status_code == 200, things.text
        table = self.send("GET", path, params={"format": "parquet"}).content
        rows = read_table(BytesIO(table)).to_pylist()
        assert [(r["seq"], r["id"], r["status"]) for r in rows] == model.listed()

    @act(rotor=rotors)
    def look_around(self, rotor: str) -> None:
        """What needs no rotor, and the pages."""
        for path in (*OPEN, *(f"/rotors/{self.id(rotor)}{part}" for part in PAGES)):
            answer = self.send("GET", path)
            assert answer.status_code == 200, (path, answer.text)
        page = self.send("GET", "/").text
        name = page.partition("/assets/")[2].partition('"')[0]
        assert self.send("GET", f"/assets/{name}").status_code == 200
        assert self.send("GET", "/openapi.json").json()["openapi"].startswith("3.")
        self.compare_operations()

    def compare_operations(self) -> None:
        """Nothing else goes on in the database: what waits is what this machine's rotors have."""
        told = self.send("GET", "/v1/operations").json()["gauges"]
        listed = self.pages_of("/v1/rotors", 40)
        own = [one for one in listed if one["id"].startswith(self.prefix)]
        assert {self.id(rotor) for rotor in self.model} <= {one["id"] for one in own}
        assert told["rotors"] == len(listed)
        assert told["applied"] == sum(one["applied_seq"] for one in listed)
        assert told["backlog"] == sum(one["head_seq"] - one["applied_seq"] for one in listed)
        assert told["versions"] == sum(one["version"] for one in listed)
        assert told["blocked"] == 0
        metrics = self.send("GET", "/metrics").text
        assert f"bladetwin_rotors {told['rotors']}" in metrics
        for rotor, model in self.model.items():
            (row,) = [one for one in own if one["id"] == self.id(rotor)]
            assert row["head_seq"] == len(model.entries)

    def teardown(self) -> None:
        super().teardown()
        for rotor, model in getattr(self, "model", {}).items():
            for what in sorted({name for name, _ in OF_ROTOR + OF_BLADE}):
                self.read(rotor, "B1", what, 1)
            self.glance(rotor, 2)
            residuals = self.send("GET", self.path(rotor, "residuals")).json()
            assert not residuals["pending"]
            for _, name, _ in model.listed()[-3:]:
                self.look(rotor, name)
            for _, name, _ in model.listed()[:1]:
                self.retract(rotor, name)
            self.wait(rotor, 1)
            self.glance(rotor, 1)


def now_ends(now: Json) -> int:
    """The last entry of the newest version."""
    return int(now["posterior"]["through_seq"])
