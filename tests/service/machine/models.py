"""Models are registered and trained by jobs; a rotor keeps the version that it was created with."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass

from hypothesis import strategies as st

from service.fake.conjugate import fake_network
from tests.service.machine.log import Log
from tests.service.machine.steps import act, rotor_body
from tests.service.modelled import Json

HDF5 = b"\x89HDF\r\n\x1a\n"
BUILTIN = "rotor-blade"
NETWORK = json.dumps(fake_network().to_json())


@dataclass
class Job:
    """A job that was asked for; `version` of the model that it leaves, None: the built-in one."""

    id: str
    model: str
    version: str | None
    done: bool = False


class Models(Log):
    """Runs are uploaded again and again, and jobs do them in their order."""

    def __init__(self) -> None:
        super().__init__()
        self.jobs: list[Job] = []
        self.trained: dict[str, list[str]] = {}  # versions of a model, the newest last
        self.pinned: dict[str, tuple[str, str]] = {}  # rotor: its model and version

    @act(
        5,
        what=st.sampled_from(["builtin", "train", "train", "again", "list", "jobs", "rotor"]),
        name=st.sampled_from(["m1", "m2"]),
        runs=st.sampled_from([b"one", b"two", b"three"]),
        works=st.booleans(),
    )
    def model_of(self, what: str, name: str, runs: bytes, works: bool) -> None:
        if works:
            self.drain()
        if what == "builtin":
            self.register()
        elif what == "train":
            self.train(name, runs)
        elif what == "again":
            for one in (runs, b"other", runs):
                self.train(name, one)
        elif what == "list":
            self.list_models(1 + len(runs))
        elif what == "jobs":
            self.look_at_jobs()
        else:
            self.rotor_of(name)

    def register(self) -> None:
        answer = self.send("POST", "/v1/models", json={"builtin": BUILTIN})
        self.asked_for(answer.status_code, answer.json(), BUILTIN, None)
        assert self.send("POST", "/v1/models", json={"builtin": "none"}).status_code == 422

    def train(self, name: str, runs: bytes) -> None:
        """Runs that are no netCDF are refused, and so is the name of a built-in model."""
        for wrong in ({"id": BUILTIN}, {"runs": b"no file"}):
            given = {"id": self.id(name), "runs": HDF5 + runs} | wrong
            files = {"runs": ("runs.nc", given["runs"])}
            refused = {"id": given["id"], "network": NETWORK}
            answer = self.send("POST", "/v1/models", data=refused, files=files)
            assert answer.status_code == 422, answer.text
        form = {"id": self.id(name), "network": NETWORK}
        files = {"runs": ("runs.nc", HDF5 + runs)}
        answer = self.send("POST", "/v1/models", data=form, files=files)
        artefact = hashlib.sha256(HDF5 + runs).digest()
        self.asked_for(answer.status_code, answer.json(), name, f"fake-{artefact[:4].hex()}")

    def asked_for(self, status: int, told: Json, name: str, version: str | None) -> None:
        assert status == 202, told
        job = told["job"]
        assert job["status"] == "queued"
        assert job["id"] not in {one.id for one in self.jobs}
        self.jobs.append(Job(job["id"], name, version))

    def drain(self, which: int = 0) -> None:
        super().drain(which)
        for job in self.jobs:
            if not job.done and job.version is not None:
                known = self.trained.setdefault(job.model, [])
                known[:] = [one for one in known if one != job.version] + [job.version]
            job.done = True

    def look_at_jobs(self) -> None:
        for job in self.jobs:
            told = self.send("GET", f"/v1/jobs/{job.id}").json()
            assert told["error"] is None
            if job.done or told["status"] == "done":
                assert told["status"] == "done"
                assert told["result"]["model"] == self.named(job.model)
                assert job.version in (None, told["result"]["version"])
        assert self.send("GET", "/v1/jobs/none").status_code == 404

    def named(self, model: str) -> str:
        return model if model == BUILTIN else self.id(model)

    def list_models(self, size: int) -> None:
        """Each with its newest version, and every version by its name."""
        listed = self.pages_of("/v1/models", size)
        found = [one["id"] for one in listed]
        assert found == sorted(set(found))
        told = {one["id"]: one["version"] for one in listed}
        assert BUILTIN in told
        for name in ("m1", "m2"):
            known, path = self.trained.get(name, []), f"/v1/models/{self.id(name)}"
            waits = [job for job in self.jobs if job.model == name and not job.done]
            if not known and not waits:
                assert self.id(name) not in told
                assert self.send("GET", path).status_code == 404
            for version in known:
                one = self.send("GET", path, params={"version": version})
                assert (one.status_code, one.json()["version"]) == (200, version)
            if known and not waits:
                assert told[self.id(name)] == known[-1]
                assert self.send("GET", path).json()["version"] == known[-1]
            missing = self.send("GET", path, params={"version": "fake-none"})
            assert missing.status_code == 404
        surface = self.send("GET", f"/v1/models/{BUILTIN}/surface").json()
        assert max(max(one) for one in surface["triangles"]) < len(surface["points"])

    def rotor_of(self, name: str) -> None:
        """A rotor of a model that was trained has the version that was newest then, for ever."""
        self.drain()
        rotor, known = f"of-{name}", self.trained.get(name)
        body = rotor_body(self.id(rotor), 64) | {"model": self.id(name)}
        answer = self.send("POST", "/v1/rotors", json=body)
        if known is None:
            assert answer.status_code == 422, answer.text
            return
        assert answer.status_code == 201, answer.text
        assert ("idempotent-replayed" in answer.headers) == (rotor in self.pinned)
        pinned = self.pinned.setdefault(rotor, (name, known[-1]))
        assert answer.json()["model_version"] == pinned[1]
        self.drain()
        told = self.send("GET", self.path(rotor, "posterior")).json()["rests_on"]
        assert (told["model"], told["model_version"]) == (self.id(name), pinned[1])

    def teardown(self) -> None:
        super().teardown()
        if hasattr(self, "model"):
            self.look_at_jobs()
            self.list_models(50)
