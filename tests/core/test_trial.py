"""What hangs the HDF5 library, or breaks it off, is refused before it is opened here."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest

from core.archive import trial
from core.archive.opening import opened
from core.archive.table import convert_table
from core.archive.trial import read_all, tried
from core.errors import ModelError
from tests.exchanger import points, write_table
from tests.patience import until

ROOT = Path(__file__).parents[2]
OPEN = """
import sys
from core.archive.opening import opened
print("there", flush=True)
opened(sys.argv[1]).__enter__()
"""


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    convert_table(write_table(tmp_path / "runs.csv", points(12)), tmp_path / "runs.nc")
    return tmp_path / "runs.nc"


def endless(runs: Path) -> Path:
    """The free space of its heap of strings is said to be of no length: a walk without end."""
    data = bytearray(runs.read_bytes())
    at = data.index(b"GCOL") + 16
    while (head := struct.unpack_from("<HHIQ", data, at))[0]:
        at += 16 + (head[3] + 7) // 8 * 8
    struct.pack_into("<Q", data, at + 8, 0)
    runs.write_bytes(bytes(data))
    return runs


def test_a_file_that_can_be_read_is_left_to_whoever_opens_it(runs: Path) -> None:
    tried(runs)
    with opened(runs) as source:
        assert len(source.labels) == 12


def test_one_that_keeps_the_library_busy_for_ever_is_refused(runs: Path) -> None:
    damaged = endless(runs)
    with pytest.raises(ModelError, match=r"runs.nc is damaged: .* within 2 s of processor time"):
        tried(damaged, 2.0)


def test_opened_without_a_trial_it_would_hang(runs: Path) -> None:
    """The control."""
    damaged = endless(runs)
    command = [sys.executable, "-c", OPEN, str(damaged)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as opening:
        try:
            assert opening.stdout is not None
            assert opening.stdout.readline() == b"there\n"
            begun = processor_s(opening.pid)
            until("as much work", lambda: processor_s(opening.pid) > begun + 3.0)
            assert opening.poll() is None
        finally:
            opening.kill()


@pytest.mark.parametrize("how", ["dies", "waits"])
def test_one_that_ends_its_reader_or_keeps_it_waiting_is_refused(
    runs: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """Whatever is done to the child: here another program stands in for it."""
    does = f"import os; os.kill(os.getpid(), {int(signal.SIGSEGV)})"
    if how == "waits":
        does = "import time; time.sleep(600)"
        monkeypatch.setattr(trial, "PATIENCE", 1.0)
    own = subprocess.run

    def instead(command: list[str], **more: object) -> object:
        return own([command[0], "-c", does], **more)  # type: ignore[call-overload]

    monkeypatch.setattr(trial.subprocess, "run", instead)
    why = "signal 11" if how == "dies" else "it did not answer"
    with pytest.raises(ModelError, match=why):
        tried(runs, 2.0)


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for what other systems lack")
def test_no_child_outlives_its_parent(runs: Path) -> None:
    damaged = endless(runs)
    code = "import sys; from core.archive.trial import tried; tried(sys.argv[1], 300.0)"
    parent = subprocess.Popen([sys.executable, "-c", code, str(damaged)], cwd=ROOT)
    try:
        until("the trial", lambda: trial_of(parent.pid))
        child = trial_of(parent.pid)
        until("its work", lambda: processor_s(child) > 4.0)  # long past its imports
    finally:
        parent.kill()
        parent.wait()
    until("its end", lambda: not Path(f"/proc/{child}").exists())


def trial_of(parent: int) -> int:
    """The child of ``parent`` that tries a file, 0 so far: a library's import has children too."""
    for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        with suppress(FileNotFoundError, ProcessLookupError):  # ended since it was listed
            # as an argument: one that was forked and is not yet another program has our own words
            if "core.archive.trial" in Path(f"/proc/{child}/cmdline").read_text().split("\0"):
                return int(child)
    return 0


def processor_s(process: int) -> float:
    told = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(told[11]) + int(told[12])) / os.sysconf("SC_CLK_TCK")


def test_what_is_wrong_in_words_is_not_its_business(tmp_path: Path) -> None:
    text = tmp_path / "runs.nc"
    text.write_text("run,time")
    tried(text)
    with pytest.raises(ModelError, match="cannot be read as netCDF"), opened(text):
        pass


def test_it_follows_no_link_and_reads_no_more_than_a_file_may_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipe, read = tmp_path / "pipe", list[str]()
    os.mkfifo(pipe)  # who opens it waits for ever
    values = trial._values

    def noted(dataset: h5py.Dataset) -> None:
        read.append(dataset.name)
        values(dataset)

    monkeypatch.setattr(trial, "_values", noted)
    with h5py.File(tmp_path / "large.nc", "w") as file:
        file.create_dataset("large", (2**28, 2**28), "f8", chunks=(64, 64))
        file["own"] = np.arange(3.0)
    read_all(tmp_path / "large.nc")
    assert sorted(read) == ["/large", "/own"]
    for how in ("link", "storage"):
        with h5py.File(tmp_path / "a.nc", "w") as file:
            file["own"] = np.arange(3.0)
            if how == "link":
                file["elsewhere"] = h5py.ExternalLink(str(pipe), "/x")
            else:
                file.create_dataset("outside", (4,), "f8", external=[(str(pipe), 0, 32)])
        read_all(tmp_path / "a.nc")
    assert len(read) == 2
