"""What somebody else chose as an address leads to no place that is not meant."""

from __future__ import annotations

import ipaddress
import shutil
import socket
import ssl
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from core.errors import InputError
from service import outbound
from service.outbound import SendError, networks, post, public, target_of
from tests.patience import AGES_S, PATIENCE_S
from tests.service.receiver import receiving

HERE = networks("127.0.0.0/8, ::1")
PUBLIC = "93.184.216.34"


def send(url: str, **given: Any) -> int:
    return post(url, {}, b"{}", **{"timeout_s": PATIENCE_S, "allowed": ()} | given)


@pytest.mark.parametrize(
    "address",
    [
        *("127.0.0.1", "127.8.8.8", "10.0.0.1", "172.16.3.4", "192.168.1.1", "169.254.169.254"),
        *("100.64.0.1", "0.0.0.0", "255.255.255.255", "224.0.0.1", "192.0.2.1", "198.18.0.1"),
        *("::1", "::", "fe80::1", "fc00::1", "ff02::1", "2001:db8::1"),
        *("::ffff:127.0.0.1", "::ffff:10.0.0.1", "64:ff9b::a00:1", "2002:a00:1::1"),
    ],
)
def test_no_address_but_a_public_one_is_called(address: str) -> None:
    assert not public(ipaddress.ip_address(address))
    host = f"[{address}]" if ":" in address else address
    with pytest.raises(InputError, match="not public"):
        target_of(f"https://{host}/x")


@pytest.mark.parametrize("address", [PUBLIC, "1.1.1.1", "2606:4700::1111", "64:ff9b::101:101"])
def test_a_public_one_is(address: str) -> None:
    assert public(ipaddress.ip_address(address))


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("https://user:pw@plant.example/", "user or password"),
        ("ftp://plant.example/", "no URL"),
        ("file:///etc/passwd", "no URL"),
        ("https:///x", "no URL"),
        ("https://plant.example/#x", "no URL"),
        ("https://plant.example/\r\nX: y", "no URL"),
        ("https://plant.example/a b", "no URL"),
        ("https://plant.example:99999/", "no URL"),
        ("https://[::1/", "no URL"),
        ("https://plant.example/" + "x" * 2000, "no URL"),
        (f"http://{PUBLIC}/", "without TLS"),
    ],
)
def test_a_url_that_cannot_be_called_is_refused_with_a_reason(url: str, why: str) -> None:
    with pytest.raises(InputError, match=why) as refused:
        target_of(url)
    assert "pw" not in str(refused.value)


def answers(monkeypatch: pytest.MonkeyPatch, *rounds: list[str]) -> list[str]:
    """Let names resolve to these addresses, one round after the other; what was looked up."""
    left, asked = list(rounds), []

    plain = socket.getaddrinfo

    def look(host: str, port: int, *words: Any, **given: Any) -> list[Any]:
        if host[0].isdigit():
            return plain(host, port, *words, **given)
        asked.append(host)
        found = left.pop(0) if len(left) > 1 else left[0]
        return [(0, 0, 0, "", (address, port)) for address in found]

    monkeypatch.setattr(outbound.socket, "getaddrinfo", look)
    return asked


def connections(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Addresses to which a connection is made; each is refused."""
    made: list[str] = []

    def connect(address: tuple[str, int], timeout: float) -> socket.socket:
        made.append(address[0])
        raise ConnectionRefusedError("refused")

    monkeypatch.setattr(outbound.socket, "create_connection", connect)
    return made


@pytest.mark.parametrize("found", [["10.0.0.7"], [PUBLIC, "10.0.0.7"], ["::ffff:127.0.0.1"]])
def test_a_name_that_leads_inside_is_not_called(
    monkeypatch: pytest.MonkeyPatch, found: list[str]
) -> None:
    answers(monkeypatch, found)
    made = connections(monkeypatch)
    with pytest.raises(SendError, match="not public"):
        send("https://plant.example/x")
    assert made == []


def test_a_name_is_looked_up_once_and_the_address_that_was_checked_is_called(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A name that is public when it is checked and private when it is called."""
    asked = answers(monkeypatch, [PUBLIC], ["10.0.0.7"])
    made = connections(monkeypatch)
    with pytest.raises(SendError, match="refused"):
        send("https://plant.example/x")
    assert (asked, made) == (["plant.example"], [PUBLIC])


def test_a_client_that_calls_the_name_would_be_led_astray(monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control: the usual client looks the name up itself, and gets another answer."""
    import http.client

    asked = answers(monkeypatch, [PUBLIC], ["10.0.0.7"])
    target = target_of("https://plant.example/x")
    for address in outbound.resolve(target.host, target.port):
        outbound.judge(target, address, ())
    monkeypatch.setattr(socket, "socket", None)
    with pytest.raises(TypeError):
        http.client.HTTPConnection(target.host, target.port).connect()
    assert asked == ["plant.example"] * 2, "the second answer was the private one"


def test_every_address_is_tried_until_one_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    with receiving() as receiver:
        port = int(receiver.url.rpartition(":")[2].partition("/")[0])
        answers(monkeypatch, ["127.0.0.9", "127.0.0.1"])
        assert send(f"http://plant.example:{port}/hook", allowed=HERE) == 204
        assert receiver.got[0].headers["host"] == f"plant.example:{port}"


def test_networks_that_the_operator_named_are_called_without_tls_and_others_are_not() -> None:
    with receiving() as receiver:
        assert send(receiver.url, allowed=HERE) == 204
        with pytest.raises(SendError, match="not public"):
            send(receiver.url, allowed=networks("10.0.0.0/8"))
    assert len(receiver.got) == 1


def test_a_proxy_of_the_environment_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    with receiving() as receiver, receiving() as proxy:
        for name in ("http_proxy", "HTTP_PROXY", "all_proxy"):
            monkeypatch.setenv(name, proxy.url)
        assert send(receiver.url, allowed=HERE) == 204
    assert proxy.got == []


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A key and a certificate for localhost, signed by itself."""
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("no openssl here that could make a certificate")
    file = tmp_path_factory.mktemp("tls") / "both.pem"
    words = "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost"
    named = ["-addext", "subjectAltName=DNS:localhost", "-keyout", f"{file}.key", "-out", f"{file}"]
    subprocess.run([program, *words.split(), *named], check=True, capture_output=True)
    return file


def serving(certificate: Path) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, f"{certificate}.key")
    return context


def test_a_certificate_has_to_be_trusted_and_to_name_the_host(
    certificate: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with receiving(serving(certificate)) as receiver:
        with pytest.raises(SendError, match="CERTIFICATE_VERIFY_FAILED"):
            send(receiver.url, allowed=HERE)
        trusted = ssl.create_default_context(cafile=str(certificate))
        monkeypatch.setattr(outbound, "_tls", lambda: trusted)
        assert send(receiver.url, allowed=HERE) == 204
        with pytest.raises(SendError, match="CERTIFICATE_VERIFY_FAILED"):
            send(receiver.url.replace("localhost", "127.0.0.1"), allowed=HERE)
    assert len(receiver.got) == 1


def test_a_name_without_an_address_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(*words: Any, **given: Any) -> Any:
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(outbound.socket, "getaddrinfo", nothing)
    with pytest.raises(SendError, match=r"plant\.example has no address"):
        send("https://plant.example/x")


def test_a_name_that_is_looked_up_for_long_takes_no_longer_than_a_message_may(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done = threading.Event()

    def slow(*words: Any, **given: Any) -> Any:
        done.wait(AGES_S)
        return []

    monkeypatch.setattr(outbound.socket, "getaddrinfo", slow)
    begun = time.monotonic()
    try:
        with pytest.raises(SendError, match=r"plant\.example has no address within 0\.2 s"):
            outbound.post("https://plant.example/x", {}, b"", timeout_s=0.2, allowed=())
        assert time.monotonic() - begun < PATIENCE_S
    finally:
        done.set()
