"""Whether a request comes from a program on this machine, and from nobody behind it.

A server on the loopback needs no key: it is for the programs of its own machine. But strangers
reach it all the same. A proxy on this machine passes on what others ask; it is known by the headers
that proxies add. And a page in a browser on this machine, written by somebody else, may post to
127.0.0.1 (the browser names the page in `Origin`) or name a picture there (it says `cross-site` in
`Sec-Fetch-Site`), or be served under a name that its owner lets
point to 127.0.0.1, and then even read the answers (`Host` has that name). All three need a key.

A proxy that adds no header cannot be told from a program: behind one set BLADETWIN_KEYS=always.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Collection
from functools import lru_cache
from typing import Any

from starlette.datastructures import Headers
from starlette.types import Scope

from service.settings import Settings

PROXIES = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip", "via")


@lru_cache(maxsize=256)
def is_loopback(host: str | None) -> bool:
    """Whether an address or a name is this machine's own.

    >>> is_loopback("127.0.0.1"), is_loopback("::1"), is_loopback("localhost"), is_loopback("")
    (True, True, True, False)
    """
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host or "").is_loopback
    except ValueError:
        return False


def keys_required(settings: Settings) -> bool:
    """Whether every request needs a key: unless the server listens on the loopback alone."""
    return settings.keys == "always" or not is_loopback(settings.host)


def _name_of(host: str) -> str:
    """The name in a Host header, without its port.

    >>> _name_of("localhost:8000"), _name_of("[::1]:8000"), _name_of("127.0.0.1")
    ('localhost', '::1', '127.0.0.1')
    """
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0]


def by_loopback(scope: Scope, origins: Collection[str]) -> bool:
    """Whether a request to a server on the loopback may come without a key.

    origins   of pages that may call the API (BLADETWIN_CORS_ORIGINS)
    """

    def ours(end: Any) -> bool:
        return bool(end) and is_loopback(str(end[0]))

    headers = Headers(scope=scope)
    if not (ours(scope.get("client")) and ours(scope.get("server"))):
        return False
    if any(name in headers for name in PROXIES):
        return False
    host = headers.get("host", "")
    if not is_loopback(_name_of(host)):
        return False
    origin = headers.get("origin")
    if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
        return origin in origins  # a browser says whose page asks, of a picture too
    return origin is None or origin in origins or origin in (f"http://{host}", f"https://{host}")
