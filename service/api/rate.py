"""A token bucket for each key, and for each address that comes without one.

A bucket holds at most `burst` tokens and gains `rate` a second; a request takes one, and is refused
where there is none. The headers are those of draft-ietf-httpapi-ratelimit-headers from its eighth
version on: `q` tokens in a window of `w` seconds, `r` of them left, all of them again in `t` s.

The buckets are in memory: several API processes on one database have their own each.
"""

from __future__ import annotations

import ipaddress
import math
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

MOST_BUCKETS = 10_000


@dataclass(frozen=True, slots=True)
class Taken:
    """Whether a request got its token; if not, `wait_s` until there is one."""

    allowed: bool
    wait_s: float
    headers: dict[str, str]


class Buckets:
    """Buckets by name; those longest unused are dropped above `MOST_BUCKETS`.

    >>> at = [0.0]
    >>> buckets = Buckets(rate=2.0, burst=1, clock=lambda: at[0])
    >>> buckets.take("key a").allowed, buckets.take("key a").wait_s, buckets.wait_s("key a")
    (True, 0.5, 0.5)
    >>> at[0] = 0.5
    >>> buckets.take("key a").headers
    {'RateLimit-Policy': '"key";q=1;w=1', 'RateLimit': '"key";r=0;t=1'}
    """

    def __init__(
        self, rate: float, burst: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate = rate
        self._burst = burst
        self._clock = clock
        self._levels: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, who: str) -> Taken:
        """A token for `who`, whose first word says what it is (key, address)."""
        if self._rate <= 0:
            return Taken(True, 0.0, {})
        now, level = self._clock(), self._level(who)
        self._levels.pop(who, None)
        allowed = level >= 1.0
        level -= allowed
        self._levels[who] = (level, now)
        if len(self._levels) > MOST_BUCKETS:
            self._levels.popitem(last=False)
        kind = who.split(" ")[0]
        window = math.ceil(self._burst / self._rate)
        full = math.ceil((self._burst - level) / self._rate)
        headers = {
            "RateLimit-Policy": f'"{kind}";q={self._burst};w={window}',
            "RateLimit": f'"{kind}";r={int(level)};t={full}',
        }
        return Taken(allowed, 0.0 if allowed else (1.0 - level) / self._rate, headers)

    def wait_s(self, who: str) -> float:
        """Until there is a token for `who`, s; none is taken."""
        return 0.0 if self._rate <= 0 else max(0.0, 1.0 - self._level(who)) / self._rate

    def _level(self, who: str) -> float:
        now = self._clock()
        level, since = self._levels.get(who, (float(self._burst), now))
        return min(float(self._burst), level + (now - since) * self._rate)


@lru_cache(maxsize=1024)
def network(address: str | None) -> str:
    """What counts as one client: an IPv4 address, or the /64 that one IPv6 client has.

    >>> network("192.0.2.7"), network("2001:db8::1:2"), network(None)
    ('192.0.2.7', '2001:db8::', 'unknown')
    """
    try:
        parsed = ipaddress.ip_address(address or "")
    except ValueError:
        return "unknown"
    if parsed.version == 4:
        return str(parsed)
    return str(ipaddress.ip_network(f"{parsed}/64", strict=False).network_address)
