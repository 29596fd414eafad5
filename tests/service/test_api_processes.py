"""Several API processes at one port: connections shared out, one dies, counts that are one."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from http.client import HTTPConnection
from pathlib import Path

import httpx
import pytest

from core.errors import InputError
from service.api.metrics import Requests
from service.api.sockets import alone, beside, first
from service.api.together import Together, files
from service.client import Client
from service.free_port import free_port
from service.settings import Settings
from tests.patience import PATIENCE_S, until
from tests.service.test_metrics import parse
from tests.service.test_processes import (
    ROOT,
    alive,
    body,
    children,
    serving,
)

HALF = b"\r\n".join(
    (
        b"POST /v1/rotors HTTP/1.1",
        b"Host: 127.0.0.1",
        b"Content-Type: application/json",
        b"Content-Length: 90",
        b"",
        b'{"id": ',
    )
)
HEALTH = 'bladetwin_http_requests_total{method="GET",route="/healthz",status="200"}'


def answering(pid: int) -> list[int]:
    """The API processes of a server that runs under `pid`, itself first."""

    def further(child: int) -> bool:
        try:
            words = Path(f"/proc/{child}/cmdline").read_text().split("\0")
        except FileNotFoundError:
            return False
        return "--place" in words

    return [pid, *filter(further, children(pid))]


def accepted(pid: int, port: int) -> set[int]:
    """The clients' ports of the connections to a port that a process has accepted."""
    own = set()
    for one in Path(f"/proc/{pid}/fd").iterdir():
        try:
            own.add(os.readlink(one))
        except FileNotFoundError:
            continue
    lines = Path("/proc/net/tcp").read_text().splitlines()[1:]
    rows = [line.split() for line in lines]
    here = [r for r in rows if r[1].endswith(f":{port:04X}") and r[3] == "01"]
    return {int(r[2].rpartition(":")[2], 16) for r in here if f"socket:[{r[9]}]" in own}


def reaches(one: socket.socket, pid: int, others: Sequence[int]) -> bool:
    """Whether a connection is one of `pid`, once it or one of the others has accepted it."""
    port, own = one.getpeername()[1], one.getsockname()[1]
    having = lambda: [each for each in (pid, *others) if own in accepted(each, port)]  # noqa: E731
    until("who accepts it", having)
    return having() == [pid]


def place(client: Client) -> tuple[str, int]:
    """The server's address, and its port."""
    url = client._http.base_url
    assert url.port is not None
    return str(url), url.port


def spread(pid: int, port: int) -> list[int]:
    """Sixty connections at once: how many each API process has."""
    held = [socket.create_connection(("127.0.0.1", port)) for _ in range(60)]
    try:
        time.sleep(0.2)
        return [len(accepted(one, port)) for one in answering(pid)]
    finally:
        for one in held:
            one.close()


def calling(url: str) -> Client:
    """A client with a connection of its own; it reads no certificates, which takes 40 ms."""
    return Client(http=httpx.Client(base_url=url, timeout=PATIENCE_S, verify=False))


def asked(url: str, times: int) -> int:
    """That many requests, a new connection for each; how many were answered as they should be."""

    def one(_: int) -> bool:
        with closing(HTTPConnection(httpx.URL(url).netloc.decode(), timeout=PATIENCE_S)) as own:
            own.request("GET", "/healthz")
            return own.getresponse().status == 200

    with ThreadPoolExecutor(8) as pool:
        return sum(pool.map(one, range(times)))


def counted(text: str) -> int:
    told = [line.rpartition(" ") for line in text.splitlines()]
    return sum(int(value) for name, _, value in told if name == HEALTH)


def counts(url: str, pid: int) -> list[int]:
    """What each of a server's API processes tells of all together."""
    found = []
    for one in (every := answering(pid)):
        for _ in range(60):
            with closing(HTTPConnection(httpx.URL(url).netloc.decode(), timeout=PATIENCE_S)) as own:
                own.connect()
                if not reaches(own.sock, one, [other for other in every if other != one]):
                    continue
                own.request("GET", "/metrics")
                found.append(counted(own.getresponse().read().decode()))
                break
    return found


@pytest.mark.parametrize("bare_url", ["postgresql"], indirect=True)
def test_all_processes_answer_and_count_as_one(bare_url: str) -> None:
    settings = Settings(database_url=bare_url, science="fake", api_processes=3, diagnosers=0)
    with serving(settings) as (process, client):
        until("three that answer", lambda: len(answering(process.pid)) == 3)
        base, port = place(client)
        client.create_rotor("r1", blades=["B1"])

        until("connections at each of them", lambda: min(spread(process.pid, port)) >= 5)
        assert asked(base, 90) == 90
        until("the counts of all", lambda: counts(base, process.pid) == [90, 90, 90])
        assert parse(client._http.get("/metrics").text)

        # what one wrote any other one reads
        for number in range(12):
            with calling(base) as other:
                seq = other.post_inspections("r1", [body(f"i{number}")])
            with calling(base) as another:
                assert another.wait_for("r1", seq, PATIENCE_S)["head_seq"] == number + 1

        everybody = [*answering(process.pid), *children(process.pid)]
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
        assert not any(alive(pid) for pid in everybody)


def test_a_dead_one_takes_no_request_along_that_comes_later_and_loses_no_count(
    tmp_path: Path,
) -> None:
    url = f"sqlite:///{tmp_path / 'bladetwin.db'}"
    settings = Settings(database_url=url, science="fake", api_processes=2, workers=0)
    with serving(settings) as (process, client):
        until("two that answer", lambda: len(answering(process.pid)) == 2)
        base, port = place(client)
        until("connections at both", lambda: min(spread(process.pid, port)) > 0)
        own, other = answering(process.pid)
        assert asked(base, 120) == 120
        # told by both: so the one that dies has written what it counted
        until("the counts of both", lambda: counts(base, process.pid) == [120, 120])

        os.kill(other, signal.SIGKILL)
        until("its end", lambda: not alive(other))
        assert asked(base, 20) == 20, "nobody waits for it"
        until(
            "a successor",
            lambda: len(answering(process.pid)) == 2 and other not in answering(process.pid),
        )
        until("connections at the successor", lambda: min(spread(process.pid, port)) > 0)
        until("the counts of the dead one, too", lambda: counts(base, process.pid) == [140, 140])
        process.kill()
        process.wait()
        until("the end of all", lambda: not any(alive(p) for p in (own, other)))


def test_all_begin_to_end_at_once_though_one_has_still_to_wait(tmp_path: Path) -> None:
    """The first one has half of a request, which it gives up after five seconds: the other has
    ended before. (A machine that stands still for so long at that moment is asked again.)"""
    assert any(ends_before_the_first(tmp_path) for _ in range(4))


def ends_before_the_first(tmp_path: Path) -> bool:
    url = f"sqlite:///{tmp_path / 'bladetwin.db'}"
    settings = Settings(database_url=url, science="fake", api_processes=2, workers=0)
    with serving(settings) as (process, client), ExitStack() as held:
        until("two that answer", lambda: len(answering(process.pid)) == 2)
        _, port = place(client)
        own, other = answering(process.pid)
        until("connections at both", lambda: min(spread(process.pid, port)) > 0)

        def at_the_first() -> socket.socket | None:
            one = held.enter_context(socket.create_connection(("127.0.0.1", port)))
            one.sendall(HALF)
            if reaches(one, own, [other]):
                return one
            one.close()
            return None

        half = next(one for _ in range(60) if (one := at_the_first()) is not None)
        process.send_signal(signal.SIGTERM)
        until("the end of the other", lambda: not alive(other))
        half.setblocking(False)
        try:
            half.recv(1)
            before = False
        except BlockingIOError:
            before = True
        assert process.wait(PATIENCE_S) == 0
        return before


def test_no_further_process_outlives_a_server_that_was_killed(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'bladetwin.db'}"
    settings = Settings(database_url=url, science="fake", api_processes=3, workers=0)
    with serving(settings) as (process, _):
        until("three that answer", lambda: len(answering(process.pid)) == 3)
        further = answering(process.pid)[1:]
        process.kill()
        process.wait()
        until("the end of them", lambda: not any(alive(pid) for pid in further))


@pytest.fixture
def taken() -> Iterator[int]:
    """A port that another program listens on."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield other.getsockname()[1]


@pytest.mark.parametrize("processes", [1, 2])
def test_a_port_that_is_taken_is_named(taken: int, tmp_path: Path, processes: int) -> None:
    url = f"sqlite:///{tmp_path / 'bladetwin.db'}"
    settings = Settings(database_url=url, science="fake", api_processes=processes, port=taken)
    done = subprocess.run(
        [sys.executable, "-m", "service.cli", "serve"],
        env={**os.environ, **settings.environ(), "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 1
    assert f"'127.0.0.1:{taken}' cannot be listened on" in done.stderr
    assert "To mend it: end the service that listens there" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "bladetwin.db").exists()


@pytest.mark.parametrize("host", ["localhost", "", "0.0.0.0"])
def test_one_process_listens_on_every_address_of_its_host(host: str) -> None:
    port = free_port()
    made = alone(host, port)
    with ExitStack() as ends:
        for one in made:
            ends.enter_context(one).listen()
        socket.create_connection(("127.0.0.1", port), PATIENCE_S).close()
        with pytest.raises(InputError, match="cannot be listened on"):
            alone(host, port)


def test_a_second_service_does_not_slip_in_between_the_sockets_of_the_first() -> None:
    port = free_port()
    with first("127.0.0.1", port) as one, beside(one) as two:
        one.listen()
        two.listen()
        with pytest.raises(InputError, match="cannot be listened on"):
            first("127.0.0.1", port)
    first("127.0.0.1", port).close()


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as made:
        yield made


class Streams:
    """A feed with so many listeners."""

    def __init__(self, listeners: int) -> None:
        self.listeners = listeners


def request(requests: Requests, route: str, seconds: float) -> None:
    requests.total.count(("GET", route, "200"))
    requests.seconds.observe(("GET", route), seconds)


def test_counts_of_all_places_are_added_and_outlive_a_process(stack: ExitStack) -> None:
    made = [stack.enter_context(file) for file in files(2)]
    numbers = [file.fileno() for file in made]
    one, two = Requests(), Requests()
    request(one, "/a", 0.02)
    request(two, "/a", 0.3)
    request(two, "/b", 4.0)
    own, second = Together(numbers, 0), Together(numbers, 1)
    assert own.whole(one, 3)[1] == 3, "the other has told nothing yet"
    second.write(two, Streams(2))  # type: ignore[arg-type]
    whole, streams = own.whole(one, 3)
    expected = Requests()
    request(expected, "/a", 0.02)
    request(expected, "/a", 0.3)
    request(expected, "/b", 4.0)
    assert whole.lines() == expected.lines()
    assert streams == 5
    assert one.lines() != expected.lines(), "the own counts stay one's own"

    later = Requests()  # of a process in the place of the second
    Together(numbers, 1).resume(later)
    assert later.lines() == two.lines()
    fresh = Requests()
    own.resume(fresh)
    assert fresh.lines() == Requests().lines(), "nobody was there before"


def test_a_process_that_dies_while_it_writes_leaves_what_was_written_before(
    stack: ExitStack,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = [stack.enter_context(file) for file in files(1)]
    numbers = [made[0].fileno()]
    requests = Requests()
    together = Together(numbers, 0)
    for number in range(4):
        request(requests, f"/{number}", 0.1)
        together.write(requests, Streams(0))  # type: ignore[arg-type]
        before = Requests()
        Together(numbers, 0).resume(before)
        assert before.lines() == requests.lines()

        real = os.pwrite

        def torn(file: int, data: bytes, at: int, real=real) -> int:  # type: ignore[no-untyped-def]
            real(file, data[: len(data) // 2], at)
            raise KeyboardInterrupt

        longer = Requests()
        longer.add(requests.told())
        for extra in range(30):
            request(longer, f"/longer/{extra}", 0.1)
        monkeypatch.setattr(os, "pwrite", torn)
        with pytest.raises(KeyboardInterrupt):
            together.write(longer, Streams(0))  # type: ignore[arg-type]
        monkeypatch.setattr(os, "pwrite", real)
        after = Requests()
        Together(numbers, 0).resume(after)
        assert after.lines() == requests.lines()
