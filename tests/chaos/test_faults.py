"""The study of faults, once each; in full: `bladetwin study faults`."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from service.studies.chaos import damage, faults, full_disk
from service.studies.chaos.bench import Bench
from service.studies.chaos.deaths import stopped
from service.studies.chaos.processes import Child
from tests.chaos import mutants

SEED = 20310504
QUICK = [
    "worker killed: update, before COMMIT",
    "API killed: post, after COMMIT, before the answer",
    "worker stopped beyond its lease, continued",
    "clock set while a worker computes",
    "posts repeated and reordered",
    "disk full",
    "a byte of a stored array changed",
    "a byte of the log changed",
    "a byte of the rotor's row changed, or of a blade's",
]


def shown(done: int) -> None:
    """No progress in a test."""


@pytest.mark.parametrize(
    ("name", "database_url"),
    [(name, kind) for name in QUICK for kind in faults.FAULTS[name].on],
    indirect=["database_url"],
)
def test_a_fault_leaves_everything_whole(name: str, database_url: str) -> None:
    fault, kind = faults.FAULTS[name], database_url.partition(":")[0].partition("+")[0]
    told = faults.tried(fault, kind, database_url, 1, SEED, shown)
    assert told["passed"], told
    assert sum(told["outcomes"].values()) == 1


def test_a_process_counts_as_stopped_when_all_its_threads_stand_still() -> None:
    code = "import threading; threading.Thread(target=input).start(); print('two', flush=True)"
    words = [sys.executable, "-c", f"{code}\nwhile True: pass"]
    piped = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(words, text=True, **piped) as process:
        child = Child(process.pid, process.wait)
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "two\n"
            assert len(list(Path(f"/proc/{child.pid}/task").iterdir())) == 2
            assert "T" not in child.states()
            child.signal(signal.SIGSTOP)
            stopped(child)
            assert child.states() == {"T"}
        finally:
            child.kill()


def test_any_byte_of_a_models_artefact_that_changes_is_refused() -> None:
    """Among them are bytes of notes, which predict nothing."""
    bench = cast("Bench", SimpleNamespace(chosen=random.Random(SEED)))
    told = [damage.artefact(bench, number) for number in range(24)]
    assert set(told) == {
        f"{name}: refused (ModelError)" for name in ("arrays.npz", "manifest.json")
    }


def test_a_full_disk_of_the_database_server_leaves_everything_whole() -> None:
    try:
        with full_disk.small_disk(1):
            pass
    except full_disk.NoDiskError as error:
        pytest.skip(str(error))
    told = faults.tried_on_full_disk(2, SEED, shown)
    assert told["passed"], told
    assert told["trials"] == 2
    assert all("503" in outcome for outcome in told["outcomes"])


def test_a_disk_is_filled_to_the_rest_asked_for(tmp_path: Path) -> None:
    try:
        with full_disk.small_disk(8) as folder:
            ballast = full_disk.Ballast(folder)
            ballast.fill(300_000)
            (folder / "fits").write_bytes(bytes(200_000))
            with pytest.raises(OSError, match="No space left"):
                (folder / "does not").write_bytes(bytes(200_000))
            ballast.drop()
            (folder / "does").write_bytes(bytes(2_000_000))
    except full_disk.NoDiskError as error:
        pytest.skip(str(error))


def test_a_fault_without_a_fence_is_not_called_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Negative control: the same study of a service that lets a late worker commit."""
    mutants.BREAK["no_fence"](monkeypatch.setattr)
    fault = faults.FAULTS["clock set while a worker computes"]
    told = faults.tried(fault, "sqlite", f"sqlite:///{tmp_path / 'm.db'}", 8, SEED, shown)
    assert not told["passed"]
    assert "wrong_versions" in told["found_in_the_tables"]
    assert "**no**" in faults.table([told])
