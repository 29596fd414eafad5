"""One port, several API processes: each has a socket of its own, and the kernel shares connections
out among them (SO_REUSEPORT).

A socket that all accept from would give a burst of connections to whichever process wakes first,
and connections that stay open would stay with it. With sockets of their own a process that dies
takes its socket along, and later connections go to the others until another has its place.

(A socket that outlives its process, is shut down and listened on again, was tried: where
connections came just then, Linux dropped all later ones without a word.)
"""

from __future__ import annotations

import socket

from core.errors import InputError


def first(host: str, port: int) -> socket.socket:
    """A socket at this address, bound and not listening yet, beside which others may be bound.

    It is tried first as if it were to be the only one: a second service, which shares ports as this
    one does, must not slip in between its sockets. InputError: the address cannot be had.
    """
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as alone:
            alone.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            alone.bind(address)
            return _shared(family, alone.getsockname())
    except OSError as error:
        problem = f"cannot be listened on: {error.strerror}"
        raise InputError("host and port", f"{host}:{port}", problem, "choose another") from None


def beside(other: socket.socket) -> socket.socket:
    """Another socket at the same address.

    >>> with first("127.0.0.1", 0) as one, beside(one) as two:
    ...     one.getsockname() == two.getsockname()
    True
    """
    return _shared(other.family, other.getsockname())


def _shared(family: int, address: tuple[object, ...]) -> socket.socket:
    made = socket.socket(family, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        made.bind(address)
    except OSError:
        made.close()
        raise
    return made
