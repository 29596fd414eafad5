"""A port of the loopback for a server that is started a moment later."""

from __future__ import annotations

import random
import socket

# Below those that an operating system gives to whoever asks for any one (from 32768, or 49152):
# seconds may pass before the server has bound it, and nobody else gets it meanwhile.
PORTS = range(20_000, 32_000)
TRIES = 1000


def free_port() -> int:
    """One that nobody uses now.

    >>> free_port() in PORTS
    True
    """
    chosen = random.SystemRandom()  # whoever seeds `random` would get the same as his neighbour
    for port in (chosen.choice(PORTS) for _ in range(TRIES)):
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(f"none of {TRIES} ports from {PORTS[0]} to {PORTS[-1]} is free")
