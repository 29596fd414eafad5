"""One POST to an address that somebody else chose, without being led where he must not.

Whoever may make webhooks could otherwise let the service call what only it can reach: the
database's port, another machine of the plant, a cloud's metadata. So the host's name is resolved
first, every address has to be public or inside a network that the operator named, and the
connection goes to an address that was checked, not to the name again (which might answer otherwise
the second time). Redirects are not followed, proxies of the environment not used, and of the answer
only the status is read. Without TLS only to the networks that the operator named.
"""

from __future__ import annotations

import http.client
import ipaddress
import socket
import ssl
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any
from urllib.parse import urlsplit

from core.errors import BladetwinError, InputError

Address = ipaddress.IPv4Address | ipaddress.IPv6Address
Network = ipaddress.IPv4Network | ipaddress.IPv6Network
LONGEST_URL = 2000
NAT64 = ipaddress.ip_network("64:ff9b::/96")
SETTING = "BLADETWIN_WEBHOOK_NETWORKS"


class SendError(BladetwinError):
    """A message that did not arrive, or of which nobody knows whether it did."""


@dataclass(frozen=True, slots=True)
class Target:
    """A URL in its parts; `path` with the query."""

    secure: bool
    host: str
    port: int
    path: str


def networks(text: str) -> tuple[Network, ...]:
    """The networks of a setting, with commas between.

    >>> networks("10.20.0.0/16, ::1")
    (IPv4Network('10.20.0.0/16'), IPv6Network('::1/128'))
    """
    return tuple(ipaddress.ip_network(one.strip()) for one in text.split(",") if one.strip())


def target_of(url: str, allowed: Sequence[Network] = ()) -> Target:
    """A URL that a webhook may have; InputError says why it is none.

    A host's name is looked up when something is sent, an address is judged here already.
    """
    remedy = "give https://host/path, without user and #fragment"
    try:
        parts = urlsplit(url)
        host, port = parts.hostname or "", parts.port
    except ValueError as error:
        raise InputError("url", url[:200], f"is no URL: {error}", remedy) from None
    plain = url.isascii() and url.isprintable() and " " not in url and len(url) <= LONGEST_URL
    if not plain or parts.scheme not in ("http", "https") or not host or parts.fragment:
        raise InputError("url", url[:200], "is no URL that can be called", remedy)
    if parts.username is not None or parts.password is not None:
        raise InputError("url", "…", "holds a user or password", remedy)
    secure = parts.scheme == "https"
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    target = Target(secure, host, port or (443 if secure else 80), path)
    with suppress(ValueError):
        judge(target, ipaddress.ip_address(host), allowed)
    return target


def judge(target: Target, address: Address, allowed: Sequence[Network]) -> None:
    """InputError: nothing may be sent to this address."""
    if any(_plain(address) in network for network in allowed):
        return
    if not public(address):
        raise InputError(
            "url",
            target.host,
            f"leads to {address}, which is not public",
            f"name its network in {SETTING}, if it may be called",
        )
    if not target.secure:
        remedy = f"use https, or name the network in {SETTING}"
        raise InputError("url", target.host, "is called without TLS", remedy)


def _plain(address: Address) -> Address:
    """The address that is meant: IPv4 inside of IPv6 is taken out."""
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            return address.ipv4_mapped
        if address.sixtofour is not None:
            return address.sixtofour
        if address in NAT64:
            return ipaddress.IPv4Address(int(address) & 0xFFFFFFFF)
    return address


def public(address: Address) -> bool:
    """Whether an address is one of the open internet.

    >>> [public(ipaddress.ip_address(a)) for a in ("93.184.216.34", "::ffff:10.0.0.1")]
    [True, False]
    """
    plain = _plain(address)
    return plain.is_global and not plain.is_multicast and not plain.is_reserved


def resolve(host: str, port: int) -> list[Address]:
    """The addresses of a host; SendError: it has none."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise SendError(f"{host} has no address: {error}") from None
    return [ipaddress.ip_address(str(one[4][0]).partition("%")[0]) for one in found]


def looked_up(host: str, port: int, end: float, timeout_s: float) -> list[Address]:
    """`resolve`, and SendError where it takes longer: the system's lookup has no limit of ours.

    It ends at `end` of the monotonic clock, by the `timeout_s` s that the message may take in all.
    """
    found: list[list[Address] | SendError] = []

    def look() -> None:
        try:
            found.append(resolve(host, port))
        except SendError as error:
            found.append(error)

    looking = threading.Thread(target=look, name="lookup", daemon=True)
    looking.start()
    looking.join(max(0.0, end - time.monotonic()))
    if not found:
        raise SendError(f"{host} has no address within {timeout_s:g} s")
    if isinstance(found[0], SendError):
        raise found[0]
    return found[0]


@lru_cache(maxsize=1)
def _tls() -> ssl.SSLContext:
    return ssl.create_default_context()


def _connect(target: Target, addresses: Sequence[Address], end: float) -> socket.socket:
    for number, address in enumerate(addresses, start=1):
        left = end - time.monotonic()
        if left <= 0:
            break
        try:
            found = socket.create_connection((str(address), target.port), timeout=left)
        except OSError:
            if number == len(addresses):
                raise
        else:
            found.settimeout(max(0.001, end - time.monotonic()))
            return found
    raise TimeoutError("timed out")


class _Connection(http.client.HTTPConnection):
    """HTTP over a socket that is open already."""

    def __init__(self, target: Target, sock: socket.socket) -> None:
        super().__init__(target.host, target.port)
        self.default_port = 443 if target.secure else 80
        self.sock = sock

    def connect(self) -> None:
        raise ConnectionError("the connection was closed")


def post(
    url: str,
    headers: Mapping[str, str],
    body: bytes,
    *,
    timeout_s: float,
    allowed: Sequence[Network],
) -> int:
    """Send it; the status of the answer, whatever it is. All in all it takes `timeout_s` at most.

    Raises SendError, which says why; after some of them the message may have arrived all the same.
    """
    end = time.monotonic() + timeout_s
    try:
        target = target_of(url, allowed)
        addresses = looked_up(target.host, target.port, end, timeout_s)
        for address in addresses:
            judge(target, address, allowed)
    except InputError as error:
        raise SendError(str(error)) from None
    try:
        with closing(_connect(target, addresses, end)) as raw, _limit(raw, end):
            sock: Any = raw
            if target.secure:
                sock = _tls().wrap_socket(raw, server_hostname=target.host)
            with closing(sock), closing(_Connection(target, sock)) as connection:
                connection.request("POST", target.path, body, dict(headers))
                return connection.getresponse().status
    except TimeoutError:
        raise SendError(f"{target.host} did not answer within {timeout_s:g} s") from None
    except (OSError, http.client.HTTPException) as error:
        if time.monotonic() >= end:
            raise SendError(f"{target.host} did not answer within {timeout_s:g} s") from None
        raise SendError(f"{target.host}: {type(error).__name__}: {error}"[:500]) from None


class _limit:
    """Shuts a socket at a moment: each byte that comes would begin the socket's own limit anew."""

    def __init__(self, sock: socket.socket, end: float) -> None:
        # a number of its own: wrapping the socket for TLS takes the first one away
        self._sock = sock.dup()
        self._timer = threading.Timer(max(0.0, end - time.monotonic()), self._shut)
        self._timer.daemon = True

    def _shut(self) -> None:
        with suppress(OSError):
            self._sock.shutdown(socket.SHUT_RDWR)

    def __enter__(self) -> None:
        self._timer.start()

    def __exit__(self, *rest: object) -> None:
        self._timer.cancel()
        self._timer.join()
        self._sock.close()
