"""Workers that share an archive: real processes, one of them killed, and claims that are none."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from core.archive import Archive, Input, Mesh, Quantity, Run, layout
from core.archive.claims import Claims, ended, exclusive, owner, started
from core.archive.disk import link_file
from core.archive.shared import SharedRuns
from core.errors import ModelError
from tests.patience import PATIENCE_S, until

RUNS = 12
WORKER = """
import os, sys, time
from pathlib import Path
import numpy as np
import core.archive.claims as claims
from core.archive import Archive, Run
from core.archive.shared import SharedRuns

folder, kind = map(Path, sys.argv[1:3])
log = os.open(folder / "log", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
def note(*words):
    os.write(log, (" ".join(map(str, words)) + "\\n").encode())
def both(word):  # goes on when the other one has come here, too
    note(word)
    while (folder / "log").read_text().split().count(word) < 2:
        time.sleep(0.002)
def alone(name):  # for one of the two
    try:
        return bool(os.open(folder / name, os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return False
real, looks = claims.exclusive, []
def slow(path, text):  # both have looked before one of them writes
    looks.append(path)
    if len(looks) == 1:
        both("looked")
    return bool(path.write_text(text)) if kind.name == "not-exclusive" else real(path, text)
claims.exclusive = slow
archive = Archive.open(folder)
shared = SharedRuns(archive, range(12))
begun = 0
with shared.claims.beating():
    while shared.waiting():
        if (index := shared.take()) is None:
            time.sleep(0.02)
            continue
        note("begin", index, os.getpid())
        begun += 1
        if begun == 1:
            both("computes")  # neither takes all
        if begun == 2 and kind.name == "killed" and alone("doomed"):
            note("waits", index, os.getpid())
            time.sleep(3600)
        time.sleep(0.02)
        run = Run({"x": index / 12}, {"y": np.full(4, float(os.getpid()))})
        note("first" if shared.add(index, run) else "second", index, os.getpid())
"""


@pytest.fixture
def archive(tmp_path: Path) -> Archive:
    return Archive.create(
        tmp_path / "runs",
        inputs=[Input("x", 0.0, 1.0)],
        time_h=(0.0, 1.0, 2.0, 3.0),
        mesh=Mesh.none(),
        seed=1,
        command="",
        quantities=[Quantity("y", "mm", "scalar")],
    )


def run(value: float) -> Run:
    return Run({"x": 0.3}, {"y": np.full(4, value)})


def lines(archive: Archive) -> list[list[str]]:
    file = archive.path / "log"
    return [line.split() for line in file.read_text().splitlines()] if file.exists() else []


def two_workers(archive: Archive, kind: str) -> tuple[Counter[int], Counter[int], int]:
    """How often each run was begun and was published first; the run whose worker was killed."""
    words = [sys.executable, "-c", WORKER, str(archive.path), kind]
    workers = [subprocess.Popen(words) for _ in range(2)]
    lost = -1

    def waits() -> list[list[str]]:
        return [line for line in lines(archive) if line[0] == "waits"]

    try:
        if kind == "killed":
            until("a worker to be killed", waits)
            ((_, index, pid),) = waits()
            os.kill(int(pid), signal.SIGKILL)
            lost = int(index)
        codes = sorted(worker.wait(timeout=PATIENCE_S) for worker in workers)
        assert codes == ([-9, 0] if kind == "killed" else [0, 0])
    finally:
        for worker in workers:
            if worker.poll() is None:
                worker.kill()
                worker.wait()
    told = lines(archive)
    begun = Counter(int(line[1]) for line in told if line[0] == "begin")
    return begun, Counter(int(line[1]) for line in told if line[0] == "first"), lost


def test_two_workers_compute_each_run_once(archive: Archive) -> None:
    begun, first, _ = two_workers(archive, "sound")
    assert begun == first == Counter(range(RUNS))
    assert archive.done() == tuple(range(RUNS))
    pids = {float(archive.read(k).values["y"][0]) for k in range(RUNS)}
    assert len(pids) == 2
    states = [found.state for found in Claims(archive.path / "claims").newest().values()]
    assert states == ["done"] * RUNS


def test_claims_that_are_not_exclusive_let_two_workers_compute_one_run(archive: Archive) -> None:
    """Negative control: the same test, with a claim that overwrites another's."""
    begun, first, _ = two_workers(archive, "not-exclusive")
    assert max(begun.values()) == 2
    assert first == Counter(range(RUNS))  # publishing is exclusive by itself: nothing is rewritten


def test_a_worker_killed_with_9_loses_the_run_in_its_hands_and_no_other(archive: Archive) -> None:
    begun, first, lost = two_workers(archive, "killed")
    assert begun == Counter(range(RUNS)) + Counter([lost])
    assert first == Counter(range(RUNS))
    assert archive.done() == tuple(range(RUNS))
    newest = Claims(archive.path / "claims").newest()
    assert {k: found.generation for k, found in newest.items() if found.generation > 1} == {lost: 2}


class Hours:
    """A clock that is set by hand."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def held_elsewhere(folder: Path, beat: int = 0, machine: str = "another", every: int = 10) -> None:
    told = {"owner": owner() | {"machine": machine}, "every_s": every, "token": "t", "beat": beat}
    (folder / "0007-1.json").write_text(json.dumps(told | {"state": "held"}))


def test_a_claim_of_another_machine_dies_when_its_beat_stood_still_for_six_periods(
    tmp_path: Path,
) -> None:
    clock = Hours()
    claims = Claims(tmp_path, every_s=1.0, clock=clock)
    held_elsewhere(tmp_path)
    verdicts = []
    for now, beat in ((100.0, 0), (159.0, 0), (161.0, 1), (220.0, 1), (221.5, 1)):
        clock.now = now
        held_elsewhere(tmp_path, beat)
        verdicts.append(claims.take(7, claims.newest()[7]))
    assert verdicts == ["held"] * 4 + ["taken"]
    assert claims.newest()[7].generation == 2


def test_of_two_that_find_the_same_dead_claim_one_takes_it_over(tmp_path: Path) -> None:
    held_elsewhere(tmp_path)
    clock = Hours()
    both = [Claims(tmp_path, clock=clock) for _ in range(2)]
    found = [one.newest()[7] for one in both]
    assert [one.take(7, f) for one, f in zip(both, found, strict=True)] == ["held", "held"]
    clock.now = 1000.0
    assert [one.take(7, f) for one, f in zip(both, found, strict=True)] == ["taken", "held"]


def test_an_owner_that_was_only_asleep_does_not_replace_the_run(archive: Archive) -> None:
    sleeper, other = (SharedRuns(archive, [4]) for _ in range(2))
    assert sleeper.take() == 4
    claim = other.claims.newest()[4]
    other.claims._old.add((4, claim.generation))  # believed dead
    assert other.take() == 4
    assert other.add(4, run(2.5))
    assert not sleeper.add(4, run(9.5))
    assert archive.read(4).values["y"][0] == 2.5
    archive.write(4, run(9.5))  # negative control: without the link the later one stays
    assert archive.read(4).values["y"][0] == 9.5


def test_an_ended_process_of_this_machine_is_known_at_once_and_a_namesake_is_not_it() -> None:
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(3600)"])
    named = owner() | {"pid": child.pid, "started": started(child.pid)}
    assert not ended(named)
    assert ended(named | {"started": "17"})
    child.kill()
    child.wait()
    assert ended(named)
    assert not ended(named | {"machine": "another"})
    assert not ended({})


def test_a_failed_run_is_left_alone_by_those_who_saw_it_fail_and_tried_by_the_next(
    archive: Archive,
) -> None:
    first, second = (SharedRuns(archive, [0, 1]) for _ in range(2))
    assert first.take() == 0
    first.failed(0, "exploded at 3 h")
    assert second.take() == 1
    assert second.take() is None
    assert not second.waiting()
    assert second.failures == [(0, "exploded at 3 h")]
    later = SharedRuns(archive, [0, 1])
    assert later.take() == 0


def test_what_a_worker_leaves_behind_is_released(archive: Archive) -> None:
    one, other = (SharedRuns(archive, [0, 1]) for _ in range(2))

    def cut() -> None:
        with one.claims.beating():
            assert one.take() == 0
            assert other.claims.take(0, other.claims.newest()[0]) == "held"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cut()
    assert other.take() == 0


def test_a_beat_goes_on_while_a_run_is_computed(tmp_path: Path) -> None:
    claims = Claims(tmp_path, every_s=0.01)
    with claims.beating():
        assert claims.take(3, None) == "taken"
        until("three beats", lambda: claims.newest()[3].told.get("beat", 0) >= 3)
    assert claims.newest()[3].told["beat"] >= 3
    assert claims.newest()[3].state == "released"


def test_a_damaged_run_is_put_aside_and_computed_again(archive: Archive) -> None:
    archive.write(0, run(1.0))
    archive.write(1, run(1.0))
    archive.file(1).write_bytes(b"half a file")
    shared = SharedRuns(archive, [0, 1])
    assert shared.take() == 1
    assert shared.add(1, run(3.5))
    assert [archive.read(k).values["y"][0] for k in (0, 1)] == [1.0, 3.5]


def test_a_run_that_was_deleted_is_computed_again(archive: Archive) -> None:
    shared = SharedRuns(archive, [0])
    assert shared.take() == 0
    assert shared.add(0, run(1.0))
    archive.file(0).unlink()
    assert SharedRuns(archive, [0]).take() == 0


def test_who_is_swept_away_while_its_file_is_made_was_second(
    archive: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that stood still past its claim: the other one publishes, and sweeps, meanwhile."""
    real, full = layout.created, Event()

    def created(part: Path) -> Any:
        monkeypatch.setattr(layout, "created", real)
        archive.add(0, run(1.0))
        if full.is_set():
            part.touch()
        raise OSError("Unable to synchronously create file (can't retrieve stat info for file)")

    monkeypatch.setattr(layout, "created", created)
    assert not archive.add(0, run(2.0))
    full.set()  # where its file is still there something else went wrong
    monkeypatch.setattr(layout, "created", created)
    with pytest.raises(OSError, match="Unable"):
        archive.add(0, run(3.0))
    assert archive.done() == (0,)


def test_what_a_killed_writer_left_is_swept_away_with_the_run(archive: Archive) -> None:
    left = archive.path / ".run-0002.nc.0123456789ab.part"
    left.write_bytes(b"half")
    assert archive.add(2, run(1.0))
    assert not left.exists()
    assert not archive.add(2, run(2.0))
    assert not list(archive.path.glob(".*"))


def test_a_second_name_is_given_once_and_a_lost_answer_is_understood(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert exclusive(tmp_path / "a", "one")
    assert not exclusive(tmp_path / "a", "two")
    assert (tmp_path / "a").read_text() == "one"
    real = os.link

    def lost(old: Path, new: Path) -> None:
        real(old, new)
        raise FileExistsError  # the repeated call's answer

    monkeypatch.setattr(os, "link", lost)
    assert exclusive(tmp_path / "b", "three")

    def none(old: Path, new: Path) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", none)
    (tmp_path / "part").touch()
    with pytest.raises(ModelError, match="no hard links"):
        link_file(tmp_path / "part", tmp_path / "c")
