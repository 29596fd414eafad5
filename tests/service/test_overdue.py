"""An update that hangs counts as a death of its worker, and blocks its rotor in the end."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select

from core.observation import Inspection
from service.bootstrap import make_worker
from service.fake import FakeScience
from service.handlers.diagnoses import find_diagnosis, request_diagnosis
from service.handlers.inspections import retract
from service.handlers.rotors import create_rotor, view_rotor
from service.ports import BladeRecord
from service.settings import Settings
from service.store import tables as t
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.worker.heartbeat import Deadline, heartbeats
from service.worker.overdue import Steps
from service.worker.supervise import Supervisor
from tests.patience import PATIENCE_S, until
from tests.service.hanging_worker import STEP_S

ROOT = Path(__file__).parents[2]
Make = Callable[..., Inspection]
Post = Callable[..., int]


def test_the_lease_of_what_hangs_is_prolonged_no_more() -> None:
    beats, over, deadline = threading.Event(), threading.Event(), Deadline()

    def beat() -> bool:
        beats.set()
        return True

    with heartbeats(beat, 0.03, deadline, over.set):
        assert beats.wait(PATIENCE_S), "it was before"
        deadline.seconds = 0.1
        deadline.again()
        assert over.wait(PATIENCE_S)
        beats.clear()
        assert not beats.wait(0.1)


def test_what_ends_in_time_is_not_overdue() -> None:
    over: list[str] = []
    with heartbeats(lambda: True, 0.03, Deadline(PATIENCE_S), lambda: over.append("over")):
        pass
    assert over == []


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_hanging_updates_block_their_rotors_and_no_other_one(
    store: SqlStore, settings: Settings, reading: Make, post: Post
) -> None:
    """Whether or not what hangs holds the interpreter's lock; and a sealing that hangs."""
    names = ("well", "sleeps", "holds", "seals")
    for name in names:
        create_rotor(store, name, "rotor-blade", [BladeRecord("B1"), BladeRecord("B2")], 64, 7)
    make_worker(store, FakeScience(), settings).drain()
    short = settings.model_copy(update={"update_max_s": 4.0, "max_attempts": 1})
    script = str(Path(__file__).with_name("hanging_worker.py"))
    supervisor = Supervisor(
        store.engine,
        ["apply", "apply", "seal"],
        lambda owner, role: [sys.executable, script, owner, role],
        short.environ() | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
    )
    seqs = {name: post(name, reading(name)) for name in names}
    supervisor.start()
    try:
        for name in names[1:]:
            until(name, lambda name=name: view_rotor(store, name).rotor.blocked)
        until("well", lambda: view_rotor(store, "well").has_applied(seqs["well"]))
        for name in ("sleeps", "holds"):
            told = view_rotor(store, name).rotor
            assert told.last_error_event == name
            assert "1 workers died or lost their lease during the update" in str(told.last_error)
            assert (told.version, told.applied_seq) == (1, 0)
        told = view_rotor(store, "seals").rotor
        assert "during the sealing. Not sealed yet: entry 1 (seals)" in str(told.last_error)
        assert not view_rotor(store, "well").rotor.blocked
        retract(store, "holds", "holds")
        until("the rest", lambda: view_rotor(store, "holds").has_applied(2))
    finally:
        supervisor.stop()


@pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)
def test_a_step_that_hangs_ends_its_worker_and_many_that_do_not_take_their_time(
    store: SqlStore, settings: Settings, reading: Make, post: Post
) -> None:
    """One diagnosis hangs in its second step; the other's eight take longer than one may."""
    blades = [BladeRecord(f"B{n}") for n in range(1, 9)]
    for name in ("well", "diagnosed"):
        create_rotor(store, name, "rotor-blade", blades, 64, 7)
        post(name, reading(name))
    create_rotor(store, "foretold", "rotor-blade", blades[:1], 64, 7)
    post("foretold", *(reading(n, time_h=8e3 * k) for k, n in enumerate(("foretold", "x"), 1)))
    make_worker(store, FakeScience(), settings).drain()
    science = FakeScience()
    asked = {
        name: request_diagnosis(store, science, name, (), compare=True, horizon_h=None)[0].id
        for name in ("diagnosed", "well")
    }
    change = {"step_max_s": 7.5 * STEP_S, "max_attempts": 1}
    short = settings.model_copy(update=change)
    script = str(Path(__file__).with_name("hanging_worker.py"))
    supervisor = Supervisor(
        store.engine,
        ["diagnose"],
        lambda owner, role: [sys.executable, script, owner, role],
        short.environ() | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
    )
    supervisor.start()
    try:
        for name, status in (("well", "done"), ("diagnosed", "failed")):
            until(
                name,
                lambda name=name, status=status: (
                    find_diagnosis(store, name, asked[name]).status == status
                ),
            )
        assert "worker that survives job" in str(
            find_diagnosis(store, "diagnosed", asked["diagnosed"]).error
        )

        def foretold() -> str:
            with transaction(store.engine, write=False) as connection:
                own = t.residual.c.rotor_id == "foretold"
                return str(connection.execute(select(t.residual.c.error).where(own)).scalar())

        until("foretold", lambda: "1 workers died or lost their lease" in foretold())
    finally:
        supervisor.stop()


def test_each_step_has_the_whole_of_its_time() -> None:
    bounds: list[str] = []

    @contextmanager
    def bound(seconds: float) -> Iterator[None]:
        bounds.append(f"{seconds:g} s")
        yield
        bounds.append("over")

    with Steps(30.0, bound) as steps:
        first = steps.deadline.end
        steps.next()
        assert steps.deadline.end > first
        assert bounds == ["30 s", "over", "30 s"]
    assert bounds[-1] == "over"


def test_a_worker_within_a_process_of_others_loses_its_lease_alone(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    """It would take them with it."""
    started, go_on = threading.Event(), threading.Event()

    class Waiting(FakeScience):
        def update(self, *given: Any, **more: Any) -> Any:
            started.set()
            assert go_on.wait(PATIENCE_S)
            return super().update(*given, **more)

    post(rotor, reading("a"))
    short = settings.model_copy(update={"update_max_s": 0.2, "lease_s": 0.3})
    first = make_worker(store, Waiting(), short, "first")
    hanging = threading.Thread(target=first.updater.run_once)
    hanging.start()
    assert started.wait(PATIENCE_S)
    second = make_worker(store, FakeScience(), settings, "second")
    until("a claim by another", second.updater.run_once)
    go_on.set()
    hanging.join()
    assert view_rotor(store, rotor).rotor.version == 1, "what came too late is not written"


def test_an_update_in_time_leaves_no_watchdog_behind(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    """In a process of its own, that would end it in the midst of something else."""
    post(rotor, reading("a"))
    code = (
        "import faulthandler as own, sys\n"
        "from service.bootstrap import make_store, make_worker\n"
        "from service.fake import FakeScience\n"
        "from service.settings import Settings\n"
        "from service.worker import loop\n"
        "settings = Settings.load()\n"
        "worker = make_worker(make_store(settings), FakeScience(), settings, 'w')\n"
        "begin, end, told = own.dump_traceback_later, own.cancel_dump_traceback_later, []\n"
        "own.dump_traceback_later = lambda *a, **k: (told.append('begun'), begin(*a, **k))\n"
        "own.cancel_dump_traceback_later = lambda: (end(), told.append('ended'))\n"
        "worker.run = worker.updater.run_once\n"
        "loop.run_worker(worker)\n"
        "print(*told)\n"
    )
    environ = settings.environ() | {"PYTHONPATH": str(ROOT), "PATH": ""}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environ, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["begun", "ended"]
    assert view_rotor(store, rotor).rotor.version == 1
