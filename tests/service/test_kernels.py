"""States are made with kept machine code: code that was just compiled gives other last digits."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from core.observation import Inspection
from service import kernels
from service.bootstrap import make_science, make_store, prepare
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.settings import Settings
from service.worker.supervise import same_code

TINY = """
from numba import njit

@njit(cache=True)
def twice(x):
    return 2.0 * x
"""
RUN = """
import importlib.util, os, sys
from service import kernels

spec = importlib.util.spec_from_file_location("core.tiny", sys.argv[1])
tiny = importlib.util.module_from_spec(spec)
sys.modules["core.tiny"] = tiny
spec.loader.exec_module(tiny)
tiny.twice(1.5)
print(os.getpid(), len(kernels.compiled_here()), flush=True)
try:
    kernels.insist()
except kernels.CompiledError as error:
    if sys.argv[2] == "forget":
        for file in os.listdir(os.environ["NUMBA_CACHE_DIR"]):
            import shutil
            shutil.rmtree(os.path.join(os.environ["NUMBA_CACHE_DIR"], file))
    kernels.again(error)
print("computes", flush=True)
"""


def run(folder: Path, how: str) -> list[str]:
    (folder / "tiny.py").write_text(TINY)
    environ = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "kept")}
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(folder / "tiny.py"), how],
        env=same_code(environ),
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    return done.stdout.splitlines()


def test_a_process_that_compiled_runs_again_under_its_pid_and_loads(tmp_path: Path) -> None:
    first, second, last = run(tmp_path, "keep")
    assert first.split()[0] == second.split()[0]
    assert (first.split()[1], second.split()[1], last) == ("1", "0", "computes")
    assert [line.split()[-1] for line in run(tmp_path, "keep")] == ["0", "computes"]


def test_where_code_is_not_kept_it_computes_in_the_end_all_the_same(tmp_path: Path) -> None:
    lines = run(tmp_path, "forget")
    assert lines[-1] == "computes"
    assert [line.split()[1] for line in lines[:-1]] == ["1"] * (kernels.MOST + 1)


def test_only_kernels_of_the_science_count() -> None:
    import numba

    @numba.njit
    def once(x: float) -> float:
        return x + 1.0

    once(0.5)
    there = type(sys)("core.there")
    there.once = once
    elsewhere = type(sys)("elsewhere")
    elsewhere.once = once
    assert kernels.compiled_here({"elsewhere": elsewhere}) == []
    assert len(kernels.compiled_here({"core.there": there})) == 1


@pytest.fixture
def url(tmp_path: Path) -> str:
    """A database with a rotor of the blade physics and readings that nobody has applied."""
    settings = Settings.load({}, database_url=f"sqlite:///{tmp_path / 'kept.db'}")
    store = make_store(settings)
    prepare(store, settings)
    register_builtins(store, make_science(settings, store))
    create_rotor(store, "r1", "rotor-blade", [BladeRecord("B1"), BladeRecord("B2")], 64, 7)
    rows = [("i1", "B1", 9100.0, 0.117), ("i2", "B2", 16_000.0, 0.203), ("i3", "B1", 2e4, 0.231)]
    items = [Inspection(n, b, "elongation", t, np.array([v])) for n, b, t, v in rows]
    post_inspections(store, "r1", [Item("", one) for one in items])
    store.close()
    return settings.database_url


def sealed_by_a_worker(url: str, cache: Path) -> str:
    """The digest of the sealed state that a worker process makes."""
    settings = Settings.load({}, database_url=url, seal_after_s=0.0)
    environ = {**os.environ, **settings.environ(), "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-P", "-m", "service.cli", "worker"]
    child = subprocess.Popen(command, env=same_code(environ), stderr=subprocess.DEVNULL)
    store = make_store(settings)
    try:
        end = time.monotonic() + 500
        while time.monotonic() < end:
            with store.read() as tx:
                version = tx.records.rotor("r1").version
                record = tx.states.get("r1", version) if version else None
            if record is not None and record.sealed:
                return record.digest
            assert child.poll() is None
            time.sleep(0.2)
        raise AssertionError("nothing was sealed")
    finally:
        child.terminate()
        child.wait(600)
        store.close()


def kept_in() -> Path:
    """Where machine code of core.calibration is kept."""
    from numba.core.caching import FunctionCache

    from core.calibration import kernel

    return Path(FunctionCache(kernel.volume_messages.py_func).cache_path)


def most_kept(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder for machine code that has all but the outermost kernels', as after a cut start.

    To compile those takes seconds; to compile all of them, a minute. Where the others are not kept
    here they are compiled first.
    """
    from numba.core import config

    here = kept_in()
    if not (any(here.glob("kernel.*.nbc")) and any(here.glob("volumes.*.nbc"))):
        command = [sys.executable, "-P", "-m", "service.cli", "compile"]
        subprocess.run(command, check=True, timeout=900)
    with monkeypatch.context() as patch:
        patch.setattr(config, "CACHE_DIR", str(cache))
        target = kept_in()
    target.mkdir(parents=True, exist_ok=True)
    for file in here.glob("*.nb[ic]"):
        if not file.name.startswith("kernel."):
            shutil.copy2(file, target)
    assert list(target.glob("volumes.*.nbc"))


def test_the_first_worker_of_a_machine_seals_the_same_bits_as_every_later_one(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Found by `bladetwin study chaos --science core`: its first workers compiled."""
    from service.store.engine import transaction
    from service.store.tables import cursor, outbox, state, state_array

    cache = tmp_path / "kept"
    most_kept(cache, monkeypatch)
    first = sealed_by_a_worker(url, cache)
    store = make_store(Settings.load({}, database_url=url))
    with transaction(store.engine, write=True) as connection:
        for table in (outbox, state_array, state):
            connection.execute(table.delete())
        connection.execute(cursor.update().values(applied_seq=0, version=0, dirty=True))
    store.close()
    later = sealed_by_a_worker(url, cache)
    assert first == later
