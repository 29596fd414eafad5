"""Real processes: workers killed in the middle of their work, a server that dies, clean ends."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import insert, select

from core.observation import Inspection
from service.bootstrap import make_store, make_worker
from service.client import Client
from service.fake import FakeScience
from service.free_port import free_port
from service.handlers.diagnoses import find_diagnosis, request_diagnosis
from service.handlers.inspections import retract
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor, view_rotor
from service.ports import BladeRecord, ModelCard, RotorSpec
from service.processes import EMBEDDED_NICENESS, SEALER_NICENESS
from service.settings import Settings
from service.store import tables as t
from service.store.engine import transaction
from service.store.migrate import migrate
from service.store.unit_of_work import SqlStore
from service.studies.chaos.postgres import Server
from service.worker import supervise
from service.worker.claiming import Role, claim
from service.worker.job_lease import claim_job
from service.worker.supervise import Supervisor
from tests.patience import AGES_S, PATIENCE_S, until

ROOT = Path(__file__).parents[2]
Make = Callable[..., Inspection]
Post = Callable[..., int]


def alive(pid: int) -> bool:
    """Whether a process runs. A zombie does not, once the last of its threads has let its files and
    sockets go: the first one ends before them."""
    try:
        told = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return False
    return (told[0], told[17]) != ("Z", "1")


def test_no_entry_is_lost_or_applied_twice_while_workers_are_killed(
    store: SqlStore, settings: Settings, reading: Make, post: Post
) -> None:
    chosen = random.Random(20310504)
    rotors = ["k1", "k2", "k3"]
    blades = [BladeRecord(f"B{i}") for i in range(4)]
    for name in rotors:
        create_rotor(store, name, "rotor-blade", blades, 64, 7)
    patient = settings.model_copy(update={"max_attempts": 100, "keep_versions": 10_000})
    script = str(Path(__file__).with_name("slow_worker.py"))
    environ = patient.environ() | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    supervisor = Supervisor(
        store.engine,
        ["apply", "apply", "seal"],
        lambda owner, role: [sys.executable, script, owner, role, "0.02"],
        environ,
    )
    supervisor.start()
    killed: set[int] = set()
    try:
        for i in range(90):
            before = {name: view_rotor(store, name).rotor.version for name in rotors}
            post(
                chosen.choice(rotors),
                reading(
                    f"i{i}",
                    blade=f"B{chosen.randrange(4)}",
                    time_h=float(chosen.randrange(1000, 50_000)),
                    value=round(chosen.uniform(0.01, 0.6), 3),
                ),
            )
            if i % 15 == 14:
                until(
                    "a commit",
                    lambda before=before: any(
                        view_rotor(store, name).rotor.version > before[name] for name in rotors
                    ),
                )
                time.sleep(chosen.uniform(0.0, 0.04))
                pid = chosen.choice(supervisor.pids() or [0])
                if pid:
                    os.kill(pid, signal.SIGKILL)
                    killed.add(pid)
                post(rotors[0], reading(f"wrong{i}", value=2.0))
                retract(store, rotors[0], f"wrong{i}")
        heads = {name: view_rotor(store, name).rotor.head_seq for name in rotors}
        for name in rotors:
            until(f"the end of {name}", lambda name=name: settled(store, name, heads[name]))
    finally:
        supervisor.stop()
    assert len(killed) >= 4
    for name in rotors:
        check_undisturbed(store, name)


def settled(store: SqlStore, rotor: str, head: int) -> bool:
    view = view_rotor(store, rotor)
    return view.has_applied(head) and view.state is not None and view.state.sealed


def test_a_worker_that_cannot_be_started_now_is_started_later(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No more processes, or files, or memory: that passes."""
    real, refused = subprocess.Popen, [OSError(24, "Too many open files")]

    def popen(*given: Any, **more: Any) -> Any:
        if supervisor.pids() or not started or not refused:
            return real(*given, **more)
        raise refused.pop()

    started: list[int] = []
    command = [sys.executable, "-c", "import sys; sys.stdin.read()"]
    supervisor = Supervisor(store.engine, ["apply"], lambda owner, role: command, {})
    monkeypatch.setattr(subprocess, "Popen", popen)
    supervisor.start()
    try:
        started += supervisor.pids()
        os.kill(started[0], signal.SIGKILL)
        until("another worker", lambda: supervisor.pids() not in ([], started))
        assert not refused
    finally:
        supervisor.stop()


def test_a_worker_that_ends_again_and_again_holds_up_no_other_one(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It waits before it is started again; another one that is killed meanwhile does not."""
    for name in ("SHORTEST_PAUSE_S", "LONGEST_PAUSE_S", "HEALTHY_S"):
        monkeypatch.setattr(supervise, name, AGES_S)
    words = {"seal": "pass", "apply": "import sys; sys.stdin.read()"}
    supervisor = Supervisor(
        store.engine, ["seal", "apply"], lambda owner, role: [sys.executable, "-c", words[role]], {}
    )
    supervisor.start()
    try:
        until("the one that ends", lambda: len(supervisor.pids()) == 1 and 0 in supervisor._due)
        supervisor._children[1].started -= AGES_S  # it has lived
        (before,) = supervisor.pids()
        os.kill(before, signal.SIGKILL)
        until("another worker", lambda: supervisor.pids() not in ([], [before]))
        assert 0 in supervisor._due, "negative control: the first one waits still"
    finally:
        supervisor.stop()


def cursor_of(store: SqlStore) -> tuple[Any, ...]:
    """(version, owner, attempts) of the one rotor."""
    c = t.cursor.c
    with store.read() as tx:
        return tuple(tx.connection.execute(select(c.version, c.owner, c.attempts)).one())


def test_a_worker_that_is_told_to_end_ends_in_the_midst_of_a_sealing(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post
) -> None:
    post(rotor, reading("a"))
    assert make_worker(store, FakeScience(provisional=True), settings).updater.run_once()
    script = str(Path(__file__).with_name("slow_worker.py"))
    environ = settings.environ() | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    supervisor = Supervisor(
        store.engine,
        ["seal"],
        lambda owner, role: [sys.executable, script, owner, role, str(PATIENCE_S)],
        environ,
    )
    supervisor.start()
    try:
        until("a sealing", lambda: cursor_of(store)[1] is not None)
        assert cursor_of(store)[2] == 1
    finally:
        process = supervisor._children[0].process
        supervisor.stop(patience_s=PATIENCE_S / 2)
    assert process.returncode == 0, "it was not killed"
    assert cursor_of(store) == (1, None, 0)


@pytest.mark.parametrize("ours", [True, False])
def test_the_attempt_of_a_worker_that_was_killed_for_not_ending_is_not_counted(
    store: SqlStore,
    settings: Settings,
    rotor: str,
    reading: Make,
    post: Post,
    tmp_path: Path,
    ours: bool,
) -> None:
    """That of one which died by itself is."""
    ready = tmp_path / "ready"
    deaf = (
        "import pathlib, signal, sys; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
        f"pathlib.Path({str(ready)!r}).touch(); sys.stdin.read()"
    )
    post(rotor, reading("a"))
    make_worker(store, FakeScience(), settings).drain()
    request_diagnosis(store, FakeScience(), rotor, (), compare=True, horizon_h=None)
    post(rotor, reading("b"))
    supervisor = Supervisor(store.engine, [], lambda owner, role: [sys.executable, "-c", deaf], {})
    supervisor._children = [supervisor._spawn("all")]
    (child,) = supervisor._children
    until("it", ready.exists)
    assert claim_job(store.engine, child.owner, 60.0, "diagnose") is not None
    with transaction(store.engine, write=True) as connection:
        held = {"owner": child.owner, "fence": 1, "attempts": 1, "version": 0, "alarms": 0}
        connection.execute(insert(t.residual).values(rotor_id=rotor, **held))
    assert claim(store.engine, child.owner, 60.0) is not None
    if not ours:
        child.process.kill()
        child.process.wait()
    supervisor.stop(patience_s=0.2)
    assert child.process.returncode == -signal.SIGKILL
    counted = 0 if ours else 1
    assert cursor_of(store) == (1, None, counted)
    with store.read() as tx:
        for table in (t.job, t.residual):
            row = tx.connection.execute(select(table.c.owner, table.c.attempts)).one()
            assert tuple(row) == (None, counted), table.name


def check_undisturbed(store: SqlStore, rotor: str) -> None:
    """The end is what one update of the same readings gives, and the way there has no gap."""
    from core.log import effective
    from service.entries import entry_of
    from service.store.entries import read_entries

    view = view_rotor(store, rotor)
    with store.read() as tx:
        card: ModelCard = tx.records.model("rotor-blade")
        events = read_entries(tx.connection, rotor, 0, view.rotor.head_seq)
        versions = tx.connection.execute(
            select(t.state.c.version, t.state.c.through_seq)
            .where(t.state.c.rotor_id == rotor)
            .order_by(t.state.c.version)
        ).all()
        notes = select(t.outbox.c.id).where(
            t.outbox.c.rotor_id == rotor, t.outbox.c.kind == "applied"
        )
        told = len(tx.connection.execute(notes).all())
    assert [e.seq for e in events] == list(range(1, view.rotor.head_seq + 1))
    spec = RotorSpec(rotor, tuple(b.id for b in view.blades), 64, 7)
    readings = effective([entry_of(e) for e in events])
    alone = FakeScience(provisional=True).update(card, spec, readings, None, quick=False)
    assert view.state is not None
    assert view.state.digest == alone.digest
    assert [row.version for row in versions] == list(range(1, view.rotor.version + 1))
    through = [row.through_seq for row in versions]
    assert through == sorted(through)
    assert told == view.rotor.version


def test_a_diagnosis_outlives_its_killed_worker_and_holds_nothing_up(
    store: SqlStore, settings: Settings, reading: Make, post: Post, tmp_path: Path
) -> None:
    create_rotor(store, "r1", "rotor-blade", [BladeRecord(f"B{i}") for i in range(4)], 64, 7)
    seq = post("r1", *(reading(f"i{i}", blade=f"B{i}") for i in range(4)))
    job, _ = request_diagnosis(store, FakeScience(), "r1", (), compare=True, horizon_h=None)

    go_on = tmp_path / "go on"

    def command(owner: str, role: Role) -> list[str]:
        words = ["-m", "tests.service.slow_worker", owner, role, "0.0", str(go_on)]
        return [sys.executable, *words]

    environ = {**settings.environ(), "PYTHONPATH": str(ROOT)}
    diagnoser = Supervisor(store.engine, ["diagnose"], command, environ)
    others = Supervisor(store.engine, ["apply", "seal"], command, environ)
    diagnoser.start()
    others.start()
    try:
        until(
            "a step of the diagnosis",
            lambda: (find_diagnosis(store, "r1", job.id).progress or {}).get("done", 0) >= 1,
        )
        until("sealing", lambda: sealed(store, "r1", seq))
        os.kill(diagnoser.pids()[0], signal.SIGKILL)
        until("a second worker", lambda: find_diagnosis(store, "r1", job.id).attempts == 2)
        seq = post("r1", reading("later", blade="B1", time_h=16e3, value=0.2))
        until("applying beside it", lambda: view_rotor(store, "r1").rotor.applied_seq == seq)
        assert find_diagnosis(store, "r1", job.id).status == "running"
        go_on.touch()
        until("its end", lambda: find_diagnosis(store, "r1", job.id).status == "done")
    finally:
        diagnoser.stop()
        others.stop()
    ended = find_diagnosis(store, "r1", job.id)
    assert ended.attempts == 2
    assert (ended.result or {})["readings"]["delivered"] == 4


def sealed(store: SqlStore, rotor: str, seq: int) -> bool:
    view = view_rotor(store, rotor)
    return view.state is not None and view.state.sealed and view.rotor.applied_seq >= seq


@contextmanager
def serving(settings: Settings) -> Iterator[tuple[subprocess.Popen[bytes], Client]]:
    """A `bladetwin serve` of its own."""
    port = free_port()
    environ = settings.model_copy(update={"port": port, "migrate": "always"}).environ()
    process = subprocess.Popen(
        [sys.executable, "-m", "service.cli", "serve"],
        env={**os.environ, **environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
    )
    url = f"http://127.0.0.1:{port}"
    client = Client(http=httpx.Client(base_url=url, timeout=60.0, verify=False))
    try:
        client.ready(PATIENCE_S)
        yield process, client
    finally:
        client.close()
        if process.poll() is None:
            process.kill()
        process.wait()


def children(pid: int) -> list[int]:
    """Processes that `pid` started."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
        except (FileNotFoundError, ProcessLookupError):
            continue
        if parent == pid:
            found.append(int(stat.parent.name))
    return found


def body(name: str) -> dict[str, object]:
    return {"id": name, "blade": "B1", "quantity": "elongation", "time_h": 8000.0, "value": 0.11}


def test_serve_applies_readings_replaces_a_dead_worker_and_ends_cleanly(
    bare_url: str,
) -> None:
    with serving(Settings(database_url=bare_url, science="fake")) as (process, client):
        client.create_rotor("r1", blades=["B1"])
        client.wait_for("r1", client.post_inspections("r1", [body("a")]), PATIENCE_S)
        first = set(children(process.pid))
        assert len(first) == 3, "one applies, one seals and one diagnoses"
        for worker in first:
            os.kill(worker, signal.SIGKILL)
        client.wait_for("r1", client.post_inspections("r1", [body("b")]), PATIENCE_S)

        def three_others() -> bool:  # one that took idle time only needs some to die, too
            found = children(process.pid)
            return len(found) == 3 and first.isdisjoint(found)

        until("three successors", three_others)
        successors = children(process.pid)
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
        assert not any(alive(pid) for pid in successors)


def test_workers_let_the_api_go_first_and_sealers_go_last_but_not_never(
    tmp_path: Path,
) -> None:
    """With idle time only, a rotor on a machine that others keep busy was never sealed."""
    own = os.getpriority(os.PRIO_PROCESS, 0)
    bare_url = f"sqlite:///{tmp_path / 'bladetwin.db'}"
    with serving(Settings(database_url=bare_url, science="fake")) as (process, client):
        client.create_rotor("r1", blades=["B1"])
        client.wait_for("r1", client.post_inspections("r1", [body("a")]), PATIENCE_S)
        until(
            "a sealer and a diagnoser of low priority",
            lambda: (
                sorted(os.getpriority(os.PRIO_PROCESS, p) for p in children(process.pid))
                == [max(own, EMBEDDED_NICENESS)] + 2 * [max(own, SEALER_NICENESS)]
            ),
        )
        assert {os.sched_getscheduler(p) for p in children(process.pid)} == {os.SCHED_OTHER}


def test_no_worker_outlives_a_server_that_was_killed(tmp_path: Path) -> None:
    bare_url = f"sqlite:///{tmp_path / 'bladetwin.db'}"
    settings = Settings(database_url=bare_url, science="fake", workers=2)
    with serving(settings) as (process, client):
        client.create_rotor("r1", blades=["B1"])
        client.wait_for("r1", 0, PATIENCE_S)
        workers = children(process.pid)
        assert len(workers) == 4
        process.kill()
        process.wait()
        until("the end of the workers", lambda: not any(alive(pid) for pid in workers))


def test_a_worker_that_begins_while_the_database_is_away_waits_for_it() -> None:
    with Server() as server:
        settings = Settings(database_url=server.url(), science="fake")
        store = make_store(settings)
        migrate(store.engine)
        register_builtins(store, FakeScience())
        create_rotor(store, "r1", "rotor-blade", [BladeRecord("B1")], 64, 7)
        server.stop(signal.SIGQUIT)
        worker = make_worker(store, FakeScience(), settings, "early", "all")
        running = threading.Thread(target=worker.run)
        running.start()
        try:
            time.sleep(1.5)  # it has looked in vain by then, more than once
            assert running.is_alive()
            server.start()
            until("its work", lambda: view_rotor(store, "r1").rotor.version > 0)
        finally:
            worker.stop()
            running.join()
            store.engine.dispose()


def test_a_server_that_is_told_to_stop_lets_those_who_wait_go(tmp_path: Path) -> None:
    bare_url = f"sqlite:///{tmp_path / 'bladetwin.db'}"
    settings = Settings(database_url=bare_url, science="fake", workers=0)
    with serving(settings) as (process, client):
        client.create_rotor("r1", blades=["B1"])
        netloc = client._http.base_url.netloc.decode()
        with closing(HTTPConnection(netloc, timeout=PATIENCE_S)) as waiting:
            waiting.request("GET", "/v1/rotors/r1?wait_for=9&timeout=55")
            for _ in range(5):  # sent before these, so it waits in the server after them
                client.rotor("r1")
            time.sleep(0.3)
            process.send_signal(signal.SIGINT)
            answer = waiting.getresponse()
            assert answer.status == 200
            assert json.loads(answer.read())["applied_seq"] == 0
        assert process.wait(PATIENCE_S) == 0


def test_the_address_is_told_when_requests_are_answered(tmp_path: Path) -> None:
    """Whoever waits for the line need not try again. (It was told before anything was loaded.)"""
    port = free_port()
    url = f"sqlite:///{tmp_path / 'a.db'}"
    asked = Settings(database_url=url, science="fake", workers=0, port=port, migrate="always")
    process = subprocess.Popen(
        [sys.executable, "-m", "service.cli", "serve", "--json"],
        env={**os.environ, **asked.environ(), "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
    )
    try:
        assert process.stdout is not None
        told = json.loads(process.stdout.readline())
        assert told == {"url": f"http://127.0.0.1:{port}", "workers": 0}
        assert httpx.get(f"{told['url']}/healthz", timeout=PATIENCE_S).status_code == 200
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0


def test_serve_refuses_a_database_that_is_not_migrated(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'empty.db'}"
    environ = Settings(database_url=url, migrate="never", science="fake").environ()
    done = subprocess.run(
        [sys.executable, "-m", "service.cli", "serve"],
        env={**os.environ, **environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 1
    assert "bladetwin migrate" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("module", ["service.processes", "service.cli"])
def test_the_api_process_starts_without_the_heavy_packages(module: str) -> None:
    heavy = "{'numba', 'matplotlib', 'skfem', 'sklearn', 'xarray', 'pandas', 'meshio'}"
    code = f"import sys, {module}; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert done.stdout.strip() == "[]"
