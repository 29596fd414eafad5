"""The two clients: the same calls, the same answers."""

from __future__ import annotations

import asyncio
import builtins
import inspect
from collections.abc import Callable
from typing import Any

import httpx
import pytest

import service.client
from core.observation import Inspection
from service.client import AsyncClient, BlockedError, Client, MissingError, ProblemError
from service.client.steps import Blocking, Call, Walk, call, pages, stream
from service.client.table import Calls
from service.free_port import free_port
from service.settings import Settings
from service.worker.loop import Worker
from tests.service.test_processes import serving

Json = dict[str, Any]
CSV = "id,blade,quantity,time_h,value\na,B1,elongation,8000,0.11\nb,B2,elongation,9000,0.13\n"


def test_what_the_package_exports_is_pinned() -> None:
    assert service.client.__all__ == [
        "AsyncClient",
        "BlockedError",
        "Client",
        "MissingError",
        "ProblemError",
        "SignatureError",
        "read_webhook",
    ]


def test_every_method_has_its_words_and_its_signature_in_both() -> None:
    named = {k: v for k, v in vars(Calls).items() if isinstance(v, call | pages | stream)}
    assert len(named) > 40
    twins = (Client(), AsyncClient())
    for name, method in named.items():
        written = method.steps if isinstance(method, call) else method.first
        assert written.__doc__, name
        assert getattr(Client, name) is written, "help(Client.name) shows it"
        for twin in twins:
            assert inspect.signature(getattr(twin, name)) == inspect.signature(written)
    twins[0].close()
    asyncio.run(twins[1].close())


def test_both_clients_go_the_whole_way_and_hear_the_same(
    tmp_path: Any,
) -> None:
    settings = Settings(database_url=f"sqlite:///{tmp_path / 'x.db'}", science="fake")
    with serving(settings) as (_, client):
        url = str(client._http.base_url)

        async def go() -> tuple[list[Json], list[bytes]]:
            async with AsyncClient(url) as twin:
                await twin.ready()
                assert (await twin.register("rotor-blade"))["id"] == "rotor-blade"
                await twin.create_rotor("r1", blades=["B1", {"id": "B2", "lot": "L1"}], seed=3)
                seq = await twin.post_csv("r1", CSV)
                assert seq == 2
                await twin.wait_for("r1", seq)
                sealed = await twin.wait_sealed("r1")
                bands = await asyncio.gather(
                    *(twin.prediction("r1", b, times=[8000, 5e4]) for b in ("B1", "B2"))
                )
                listed = [one async for one in twin.inspections("r1", newest=True)]
                blades = [one async for one in twin.blades("r1", time_h=2e4)]
                rotors = [one["id"] async for one in twin.rotors()]
                assert rotors == ["r1"]
                heard = twin.events("r1", after=0)
                first = await anext(heard)
                await heard.aclose()  # type: ignore[attr-defined]
                files = [
                    await twin.readings_csv("r1"),
                    await twin.readings_parquet("r1", blade="B1"),
                    await twin.prediction_csv("r1", "B1", times=[8000, 5e4]),
                    await twin.draws_netcdf("r1", count=50),
                    await twin.field_vtu("r1", "B2", "ceeq"),
                ]
                with pytest.raises(ProblemError, match="404"):
                    await twin.rotor("nobody")
                with pytest.raises(ProblemError, match="404"):
                    await anext(twin.events("nobody"))
                return [sealed, *bands, *listed, *blades, first], files

        told, files = asyncio.run(go())
        again: list[Json] = [
            client.wait_sealed("r1"),
            *(client.prediction("r1", b, times=[8000, 5e4]) for b in ("B1", "B2")),
            *client.inspections("r1", newest=True),
            *client.blades("r1", time_h=2e4),
            next(client.events("r1", after=0)),
        ]
        assert told == again
        assert files[0] == client.readings_csv("r1")
        assert files[2] == client.prediction_csv("r1", "B1", times=[8000, 5e4])
        assert files[4] == client.field_vtu("r1", "B2", "ceeq")
        assert files[1][:4] == b"PAR1"
        assert files[3][1:4] == b"HDF"
        assert files[2] != client.prediction_csv("r1", "B2", times=[8000, 5e4]), "negative control"


def test_pages_are_followed_to_their_end(
    serving: Callable[..., Any],
    rotor: str,
    post: Callable[..., int],
    reading: Callable[..., Inspection],
    worker: Worker,
) -> None:
    post(rotor, *(reading(f"i{i}", time_h=100.0 + i) for i in range(120)))
    worker.drain()
    with serving() as http:
        twin = Client(http=http)
        assert [one["id"] for one in twin.inspections(rotor)] == [f"i{i}" for i in range(120)]
        own = [one["id"] for one in twin.inspections(rotor, blade="B2")]
        assert own == []
        assert [one["version"] for one in twin.versions(rotor)][-1] == 1
        assert twin.inspection(rotor, "i7")["time_h"] == 107.0
        assert twin.surface("rotor-blade")["unit"] == "mm"
        assert twin.draws(rotor, "B1", count=3)["of"] == 64
        assert len(twin.draws(rotor, count=3)["local"]["values"]) == 3


def test_who_does_not_answer_is_waited_for_and_then_said() -> None:
    url = f"http://127.0.0.1:{free_port()}"
    with Client(url) as twin:
        with pytest.raises(TimeoutError, match=r"ready within 0\.2 s"):
            twin.ready(0.2)
        with pytest.raises(httpx.ConnectError):
            twin.models()

    async def alone() -> None:
        async with AsyncClient(url) as twin:
            with pytest.raises(TimeoutError, match=r"ready within 0\.2 s"):
                await twin.ready(0.2)
            with pytest.raises(httpx.ConnectError):
                await twin.models()

    asyncio.run(alone())


def test_a_walk_hands_errors_to_the_call_and_ends_with_its_result() -> None:
    def twice() -> Any:
        try:
            yield Call("GET", "/a")
        except httpx.TransportError:
            return (yield Call("GET", "/b"))

    walk = Walk(twice())
    assert walk.go() == Call("GET", "/a")
    assert walk.fail(httpx.ConnectError("no")) == Call("GET", "/b")
    assert walk.go(7) is None
    assert walk.value == 7
    other = Walk(Client.rotor("r1"))
    assert other.go() == Call("GET", "/v1/rotors/r1")
    with pytest.raises(httpx.ConnectError):
        other.fail(httpx.ConnectError("no"))


def test_without_arviz_its_draws_are_missing_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    true = builtins.__import__

    def without(name: str, *args: Any, **kw: Any) -> Any:
        if name == "arviz":
            raise ModuleNotFoundError(name)
        return true(name, *args, **kw)

    monkeypatch.setattr(builtins, "__import__", without)
    with Client() as twin, pytest.raises(MissingError, match=r"bladetwin\[notebook\]"):
        twin.draws_arviz("r1")


def test_a_blocked_rotor_ends_the_wait_of_both() -> None:
    rotor = {"id": "r1", "status": "blocked", "version": 0, "last_error": {"error": "no luck"}}
    respond = httpx.MockTransport(lambda request: httpx.Response(200, json=rotor))
    with Client(http=httpx.Client(transport=respond, base_url="http://x")) as twin:
        assert isinstance(twin, Blocking)
        with pytest.raises(BlockedError, match="no luck"):
            twin.wait_for("r1", 1)

    async def alone() -> None:
        http = httpx.AsyncClient(transport=respond, base_url="http://x")
        async with AsyncClient(http=http) as twin:
            with pytest.raises(BlockedError, match="no luck"):
                await twin.wait_for("r1", 1)

    asyncio.run(alone())
