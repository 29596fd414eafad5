"""The service in memory: it answers as over a port, alone, and ends without a trace."""

from __future__ import annotations

import asyncio
import tempfile
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from core.errors import InputError
from service.client import AsyncClient, BlockedError, Client, ProblemError
from service.client.errors import MissingError
from service.fake import FakeScience
from service.testing import WorkerDiedError, in_memory, in_memory_async
from service.worker.update import Updater
from tests.patience import PATIENCE_S, until

Json = dict[str, Any]
CSV = "id,blade,quantity,time_h,value\na,B01,elongation,8000,0.11\n"


@pytest.fixture(autouse=True)
def nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Of no test there remain threads or files, nor a warning.

    (The calibration has two pools of threads for the whole process.)
    """
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    threads = set(threading.enumerate())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield
    later = {one.name for one in set(threading.enumerate()) - threads}
    assert {name for name in later if not name.startswith(("ThreadPoolExecutor", "rows"))} == set()
    assert list(tmp_path.iterdir()) == []


def test_a_user_s_test_is_these_lines() -> None:
    with in_memory() as twin:
        twin.ready()
        twin.create_rotor("r1", blades=["B01"])
        answer = twin.wait_for("r1", twin.post_csv("r1", CSV))
        assert answer["applied_seq"] == 1
        mean = twin.prediction("r1", "B01", "elongation", times=[5e4])["mean"][0]
        # m ~ N(0.5, 0.1²), l ~ N(0, 0.2²) and (m + l) 0.16 + N(0, 0.02²) = 0.11
        gain = 0.05 * 0.16 / (0.05 * 0.16**2 + 0.02**2)
        assert mean == pytest.approx(0.5 + gain * (0.11 - 0.5 * 0.16), rel=1e-12)


def test_it_is_asynchronous_as_the_service_is() -> None:
    gate = threading.Event()

    class Gated(FakeScience):
        def update(self, *given: Any, **more: Any) -> Any:
            if given[2]:  # readings
                assert gate.wait(PATIENCE_S)
            return super().update(*given, **more)

    with in_memory(Gated()) as twin:
        twin.create_rotor("r1", blades=["B01"])
        twin.wait_for("r1", 0)
        seq = twin.post_csv("r1", CSV)
        assert twin.rotor("r1")["status"] == "pending"
        with pytest.raises(TimeoutError, match=r"r1: 1 was not applied within 0\.05 s"):
            twin.wait_for("r1", seq, patience_s=0.05)
        gate.set()
        assert twin.wait_for("r1", seq)["applied_seq"] == seq


def test_two_at_once_do_not_see_each_other() -> None:
    with in_memory() as one, in_memory() as other:
        one.create_rotor("r1", blades=["B01"])
        other.create_rotor("r2", blades=["B01", "B02"])
        one.wait_for("r1", one.post_csv("r1", CSV))
        assert [r["id"] for r in one.rotors()] == ["r1"]
        assert [r["id"] for r in other.rotors()] == ["r2"]
        with pytest.raises(ProblemError, match="404"):
            other.rotor("r1")


def test_leaving_ends_it_for_whoever_still_asks() -> None:
    with in_memory() as twin:
        database = Path(twin.running.settings.database_url.removeprefix("sqlite:///"))
        late = Client(http=twin.running.http())
        assert database.exists()
        names = {one.name for one in threading.enumerate()}
        assert {"bladetwin-api", "bladetwin-all", "bladetwin-diagnose"} <= names
    assert not database.parent.exists()
    with pytest.raises(httpx.ConnectError, match="has ended"):
        late.models()
    with pytest.raises(TimeoutError, match="not ready"):
        late.ready(0.1)


def test_an_error_of_the_user_s_own_comes_through_and_leaves_nothing() -> None:
    def mine() -> None:
        with in_memory() as twin:
            twin.create_rotor("r1", blades=["B01"])
            twin.post_csv("r1", CSV)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        mine()


def test_events_come_one_by_one_and_a_stream_may_be_left() -> None:
    with in_memory() as twin:
        twin.create_rotor("r1", blades=["B01"])
        heard = twin.events("r1", after=0)
        first = next(heard)
        assert (first["event"], first["version"]) == ("applied", 1)
        twin.post_csv("r1", CSV)
        assert next(heard)["through_seq"] == 1, "it came while the stream was open"
        heard.close()
        with pytest.raises(httpx.ReadTimeout):
            list(twin.events("r1", after=2, silence_s=0.2))


def test_who_waits_for_a_stream_is_let_go_at_the_end() -> None:
    ended: list[Json] = []
    with in_memory() as twin:
        twin.create_rotor("r1", blades=["B01"])
        twin.wait_for("r1", 0)
        listener = threading.Thread(target=lambda: ended.extend(twin.events("r1", after=0)))
        listener.start()
        until("its first event", lambda: ended)
    listener.join(PATIENCE_S)
    assert not listener.is_alive()
    assert [one["event"] for one in ended] == ["applied"]


def test_large_answers_come_whole_and_one_that_is_not_read_holds_nothing_up() -> None:
    with in_memory() as twin:
        twin.create_rotor("r1", blades=["B01", "B02"])
        twin.wait_for("r1", twin.post_csv("r1", CSV))
        series = twin.field_series("r1", "B01", "deformation", times=np.linspace(0, 5e4, 40))
        assert series["mean"].shape == (40, 6448, 3)
        asked = "/v1/rotors/r1/field?quantity=deformation&format=pvd"
        with twin.running.http() as http, http.stream("GET", asked) as answer:
            assert next(answer.iter_raw())[:2] == b"PK"
        assert twin.rotor("r1")["id"] == "r1"


def test_keys_are_asked_for_where_the_settings_say_so() -> None:
    with in_memory(keys="always") as twin:
        twin.create_rotor("r1", blades=["B01"])
        reader = Client(http=twin.running.http(twin.running.key("read", rotors=["r1"])))
        assert reader.rotor("r1")["id"] == "r1"
        with pytest.raises(ProblemError, match="403"):
            reader.post_csv("r1", CSV)
        with pytest.raises(ProblemError, match="401"):
            Client(http=twin.running.http()).rotor("r1")


def test_settings_are_those_given_and_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLADETWIN_PAGE_LIMIT", "7")
    with in_memory(particles=100, page_limit=3) as twin:
        assert twin.create_rotor("r1", blades=["B01"])["particles"] == 100
        assert twin.running.settings.page_limit == 3
    with in_memory() as twin:
        assert twin.running.settings.page_limit == 200
    with pytest.raises(InputError, match="database_url"), in_memory(database_url="sqlite:///x"):
        pass
    with pytest.raises(InputError, match="NO_SUCH"), in_memory(no_such=1):
        pass


def test_diagnoses_and_residuals_are_made() -> None:
    rows = "".join(f"i{i},B01,elongation,{8000 + 10 * i},0.11\n" for i in range(5))
    with in_memory() as twin:
        twin.create_rotor("r1", blades=["B01"])
        twin.wait_for("r1", twin.post_csv("r1", CSV + rows))
        asked = twin.diagnose("r1")
        until("the diagnosis", lambda: twin.diagnosis("r1", asked["id"])["status"] == "done")
        until("residuals", lambda: not twin.residuals("r1")["pending"])
        assert len(twin.residuals("r1")["items"]) == 6


class Broken(FakeScience):
    """A science with a blade that it cannot compute."""

    def update(self, *args: Any, **kw: Any) -> Any:
        readings = args[2]
        if readings:
            raise ValueError("no such blade")
        return super().update(*args, **kw)


def test_a_science_that_fails_blocks_the_rotor_and_says_why() -> None:
    with in_memory(Broken(), max_attempts=2, diagnosers=0) as twin:
        twin.create_rotor("r1", blades=["B01"])
        with pytest.raises(BlockedError, match="no such blade"):
            twin.wait_for("r1", twin.post_csv("r1", CSV))


def test_a_worker_that_died_is_heard_at_once_and_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def dies(updater: Updater) -> bool:
        with updater.store.read() as tx:
            if tx.records.rotors("", 1):
                raise RuntimeError("the disk melted")
        return False

    monkeypatch.setattr(Updater, "run_once", dies)

    def waits(own: Exception | None = None, *, caught: bool = False) -> None:
        with in_memory(diagnosers=0) as twin:
            with pytest.raises(WorkerDiedError) if caught else nullcontext():
                twin.create_rotor("r1", blades=["B01"])
                twin.wait_for("r1", 1)
            if own is not None:
                raise own

    began = time.monotonic()
    with pytest.raises(WorkerDiedError, match="RuntimeError: the disk melted") as first:
        waits()
    assert time.monotonic() - began < 60, "the wait is not sat out"
    assert isinstance(first.value.__cause__, RuntimeError)
    with pytest.raises(WorkerDiedError):
        waits(caught=True)
    with pytest.raises(KeyError) as own:
        waits(KeyError("mine"), caught=True)
    assert any("the disk melted" in note for note in own.value.__notes__)


def test_an_application_that_fails_is_an_error_of_the_service() -> None:
    def fails(*args: Any, **kw: Any) -> Any:
        raise LookupError("a fault of the twin's")

    with in_memory() as twin:
        twin.create_rotor("r1", blades=["B01"])
        twin.wait_for("r1", 0)
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(FakeScience, "joint_draws", fails)
            with pytest.raises(ProblemError, match="500"):
                twin.draws("r1")
        assert twin.draws("r1", count=2)["of"] == 10_000


def test_many_threads_may_ask_one_service() -> None:
    with in_memory() as twin:
        twin.create_rotor("r1", blades=["B01"])
        done: list[int] = []

        def post(number: int) -> None:
            one = {"id": f"i{number}", "blade": "B01", "quantity": "elongation", "time_h": 8000.0}
            seq = twin.post_inspections("r1", [one | {"value": 0.1}])
            done.append(twin.wait_for("r1", seq)["applied_seq"])

        threads = [threading.Thread(target=post, args=(i,)) for i in range(12)]
        for one in threads:
            one.start()
        for one in threads:
            one.join()
        assert len(done) == 12
        assert twin.rotor("r1")["head_seq"] == 12


def test_the_same_to_be_awaited() -> None:
    async def go() -> list[Any]:
        async with in_memory_async() as twin:
            await twin.create_rotor("r1", blades=["B01", "B02"])
            heard = twin.events("r1", after=0)
            first = await anext(heard)
            await twin.wait_for("r1", await twin.post_csv("r1", CSV))
            bands = await asyncio.gather(*(twin.prediction("r1", b) for b in ("B01", "B02")))
            await heard.aclose()  # type: ignore[attr-defined]
            other = AsyncClient(http=twin.running.async_http())
            listed = [one["id"] async for one in other.inspections("r1")]
            await other.close()
            with pytest.raises(TimeoutError):
                await twin.wait_for("r1", 99, patience_s=0.05)
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(twin.wait_for("r1", 99), 0.05)
            return [first["version"], [b["blade"] for b in bands], listed]

    assert asyncio.run(go()) == [1, ["B01", "B02"], ["a"]]


def test_an_error_comes_through_the_awaited_one() -> None:
    async def go() -> None:
        async with in_memory_async() as twin:
            await twin.create_rotor("r1", blades=["B01"])
            raise MissingError("patience", "notebook")

    with pytest.raises(MissingError):
        asyncio.run(go())


def test_the_blade_physics_runs_as_well() -> None:
    """Its elongation lies where the readings are; some seconds, most of them loading."""
    with in_memory("core", diagnosers=0) as twin:
        twin.create_rotor("r1", blades=["B01", "B02"], particles=500)
        rows = "b,B01,elongation,16000,0.19\nc,B02,elongation,8000,0.12\n"
        twin.wait_for("r1", twin.post_csv("r1", CSV + rows))
        twin.wait_sealed("r1")
        told = twin.prediction("r1", "B01", "elongation", times=[8000, 16_000])
        assert told["mean"] == pytest.approx([0.11, 0.19], abs=0.06)
        assert twin.posterior("r1", "B01")["draws"] >= 500
