"""Requests, CSV and archives that nobody wrote by hand: refused in words, never a failure.

A short version by default. FUZZ_EXAMPLES=120 in the environment makes over 10,000 requests from
the OpenAPI document, and as many files, of it; FUZZ_OUT=FOLDER keeps what was answered
(tests/claims/results/contract).
"""

from __future__ import annotations

import json
import os
import random
import time
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager
from importlib import import_module
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path

import httpx
import pytest

from core.archive.opening import opened
from core.archive.table import convert_table
from core.archive.take import take
from core.archive.trial import tried
from core.errors import BladetwinError, ModelError
from core.observation import Inspection
from service.api.csv_rows import CSV_EXAMPLE
from service.fake import FakeScience
from service.handlers.transfer_in import import_rotor
from service.handlers.transfer_out import export_rotor
from service.store.unit_of_work import SqlStore
from service.studies.result import commit
from service.worker.loop import Worker
from tests.exchanger import network, points, write_table
from tests.patience import PATIENCE_S
from tests.service.test_contract import READING, answered

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "1"))
SEED = 20310504
HANGS_S = PATIENCE_S  # of a file of 12 kB
BUSY_S = 3.0  # the same of a processor's time, which other processes take nothing of
Serving = Callable[..., AbstractContextManager[httpx.Client]]
FRAGMENTS = (
    *(",", '"', "\n", "\r\n", "\x00", ";", "=1+1", "NaN", "1e999", "-", "\ufeff", "i3", "B01"),
    *("id", "value", "node", "' OR 1=1", "🙂", "\x1a", " ", "𝟙", "1_0", "0x10", "i3," * 50),
)


def keep(name: str, url: str, told: dict[str, object]) -> None:
    out = os.environ.get("FUZZ_OUT")
    if out is not None:
        kind = url.partition(":")[0].partition("+")[0]
        Path(out).mkdir(parents=True, exist_ok=True)
        head: dict[str, object] = {"seed": SEED, "examples": EXAMPLES, "database": kind}
        head["commit"] = commit()
        (Path(out) / f"{name}-{kind}.json").write_text(json.dumps(head | told, indent=1) + "\n")


def spoilt(chosen: random.Random, data: bytes) -> bytes:
    """Some bytes changed, cut, moved, repeated, or replaced by what readers stumble over."""
    for _ in range(chosen.randint(1, 6)):
        at = chosen.randrange(len(data) + 1)
        to = min(len(data), at + chosen.randint(1, 12))
        change = chosen.randrange(5)
        if change == 0 and data:
            data = data[:at] + bytes([chosen.randrange(256)]) + data[at + 1 :]
        elif change == 1:
            data = data[:at] + data[to:]
        elif change == 2:
            data = data[:at] + data[at:to] * chosen.randint(2, 5) + data[to:]
        elif change == 3:
            data = data[:at] + chosen.choice(FRAGMENTS).encode() + data[at:]
        else:
            cut = chosen.randrange(len(data) + 1)
            data = data[cut:] + data[:cut]
    return data


def test_requests_from_the_document_are_answered_as_it_says(
    serving: Serving, rotor: str, worker: Worker, store: SqlStore, database_url: str
) -> None:
    worker.drain()
    with serving(rate_per_s=0.0) as client:
        client.post("/v1/rotors/r1/inspections", json=READING)
        worker.drain()
        request = {"families": [], "compare": True, "horizon_h": 5e4, "through_seq": 1}
        with store.write() as tx:
            tx.records.put_job("d1", "diagnose", request, "r1")
        seen = answered(client, client.get("/openapi.json").json(), {}, EXAMPLES)
    statuses = Counter[int]()
    for told in seen.values():
        statuses.update(told)
    assert not [status for status in statuses if status >= 500]
    assert sum(statuses.values()) > 70 * EXAMPLES
    by_route = {k: dict(sorted(v.items())) for k, v in sorted(seen.items())}
    keep("requests", database_url, {"requests": sum(statuses.values()), "answers": by_route})


def test_fuzzed_csv_is_stored_or_refused_in_words(
    api: httpx.Client, rotor: str, store: SqlStore, database_url: str
) -> None:
    chosen = random.Random(SEED)
    lines = CSV_EXAMPLE.replace("B01", "B1").strip().split("\n")
    statuses, stored = Counter[int](), 0
    for number in range(100 * EXAMPLES):
        rows = [lines[1].replace("i3", f"f{number}-{i}") for i in range(chosen.randint(1, 3))]
        body = spoilt(chosen, "\n".join([lines[0], *rows]).encode())
        kind = chosen.choice(["text/csv", "text/csv", "text/csv; charset=utf-16", "text/plain"])
        answer = api.post("/v1/rotors/r1/inspections", content=body, headers={"content-type": kind})
        statuses[answer.status_code] += 1
        assert answer.status_code in (202, 400, 409, 415, 422), (body, answer.text)
        if answer.status_code == 202:
            stored += len({item["seq"] for item in answer.json()["items"]})
        else:
            assert answer.json()["detail"], body
    with store.read() as tx:
        assert tx.records.rotor("r1").head_seq <= stored, "what was refused left an entry"
    assert {202, 422} <= set(statuses)
    told = {"files": sum(statuses.values()), "answers": dict(sorted(statuses.items()))}
    keep("csv", database_url, told)


def take_each(pipe: Connection) -> None:
    """Takes the files whose places come over the pipe, and says what became of each."""
    for late in ("h5netcdf", "h5py", "xarray"):
        import_module(late)  # which the first file would else wait for
    pipe.send("ready")
    while True:
        file, into = pipe.recv()
        try:
            with opened(file) as source:
                take(source, network(), into)
        except BladetwinError as error:
            pipe.send(type(error).__name__)
        else:
            pipe.send("taken")


class Taker:
    """Takes files in a process of its own; one that hangs or breaks off there is told."""

    def __init__(self) -> None:
        self.here: Connection | None = None
        self.process: SpawnProcess | None = None

    def __call__(self, file: Path, into: Path) -> str:
        if self.here is None:
            context = get_context("spawn")
            self.here, there = context.Pipe()
            self.process = context.Process(target=take_each, args=(there,), daemon=True)
            self.process.start()
            there.close()
            assert self.here.recv() == "ready"
        self.here.send((file, into))
        try:
            if self.answers(self.here):
                return str(self.here.recv())
            told = "hangs"
        except EOFError:
            told = "broke off"
        self.close()
        return told

    def answers(self, here: Connection) -> bool:
        """Whether it answers, or breaks off, before it has computed or waited for too long."""
        begun, end = self.busy_s(), time.monotonic() + HANGS_S
        while not here.poll(0.1):
            if time.monotonic() > end or self.busy_s() - begun > BUSY_S:
                return False
        return True

    def busy_s(self) -> float:
        """Processor time that it has had."""
        assert self.process is not None
        told = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(told[11]) + int(told[12])) / os.sysconf("SC_CLK_TCK")

    def close(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.join()
        self.here = self.process = None


def test_runs_with_changed_bytes_are_refused_in_words_or_taken(tmp_path: Path) -> None:
    """What hangs the HDF5 library, or breaks it off, is refused by the trial before."""
    chosen, outcomes, took = random.Random(SEED), Counter[str](), Taker()
    convert_table(write_table(tmp_path / "runs.csv", points(12)), tmp_path / "runs.nc")
    whole, file = (tmp_path / "runs.nc").read_bytes(), tmp_path / "spoilt.nc"
    for number in range(60 * EXAMPLES):
        changed = bytearray(whole)
        for _ in range(chosen.randint(1, 3)):
            changed[chosen.randrange(len(changed))] = chosen.randrange(256)
        file.write_bytes(bytes(changed))
        told = took(file, tmp_path / f"taken-{number}")
        outcomes[told] += 1
        if told in ("hangs", "broke off"):
            with pytest.raises(ModelError, match="is damaged: the HDF5 library"):
                tried(file, 5.0)
    took.close()
    keep(
        "runs", "none", {"files": sum(outcomes.values()), "answers": dict(sorted(outcomes.items()))}
    )
    assert set(outcomes) <= {"ModelError", "RunsError", "InputError", "taken", "hangs", "broke off"}
    assert outcomes["ModelError"] > 0 < outcomes["taken"], outcomes


@pytest.fixture
def exported(
    store: SqlStore, rotor: str, post: Callable[..., int], reading: Callable[..., Inspection]
) -> Callable[[Path], bytes]:
    def write(folder: Path) -> bytes:
        post(rotor, *(reading(f"i{n}", time_h=1000.0 + n) for n in range(5)))
        export_rotor(store, rotor, folder / "whole.zip", "0")
        return (folder / "whole.zip").read_bytes()

    return write


def test_fuzzed_archives_are_refused_in_words_and_leave_nothing(
    store: SqlStore,
    science: FakeScience,
    exported: Callable[[Path], bytes],
    tmp_path: Path,
    database_url: str,
) -> None:
    chosen, whole, file = random.Random(SEED), exported(tmp_path), tmp_path / "spoilt.zip"
    outcomes = Counter[str]()
    for number in range(100 * EXAMPLES):
        file.write_bytes(spoilt(chosen, whole))
        try:
            done = import_rotor(store, science, file, f"copy-{number}")
        except BladetwinError as error:
            outcomes[type(error).__name__] += 1
            with store.read() as tx:
                assert f"copy-{number}" not in [r.id for r in tx.records.rotors("copy", 10_000)]
        else:
            outcomes["imported"] += 1
            assert done.to_json()["entries"] == 5
    assert outcomes["BundleError"] > 50 * EXAMPLES
    told = {"files": sum(outcomes.values()), "answers": dict(sorted(outcomes.items()))}
    keep("archives", database_url, told)
