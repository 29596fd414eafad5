"""One port, several API processes: each has a socket of its own, and the kernel shares connections
out among them (SO_REUSEPORT).

A socket that all accept from would give a burst of connections to whichever process wakes first,
and connections that stay open would stay with it. With sockets of their own a process that dies
takes its socket along, and later connections go to the others until another has its place.

(A socket that outlives its process, is shut down and listened on again, was tried: where
connections came just then, Linux dropped all later ones without a word.)
"""

from __future__ import annotations

import errno
import socket

from core.errors import InputError

# an address of a family that is switched off on this machine
LACKING = (errno.EAFNOSUPPORT, errno.EADDRNOTAVAIL)
OWN = {socket.AF_INET6: ((socket.IPPROTO_IPV6, socket.IPV6_V6ONLY),)}  # options of a family


def first(host: str, port: int) -> socket.socket:
    """A socket at this address, bound and not listening yet, beside which others may be bound.

    It is tried first as if it were to be the only one: a second service, which shares ports as this
    one does, must not slip in between its sockets. InputError: the address cannot be had.
    """
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as one:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            one.bind(address)
            return _shared(family, one.getsockname())
    except OSError as error:
        raise _refused(host, port, error) from None


def alone(host: str, port: int) -> list[socket.socket]:
    """Sockets of the one API process, bound and not listening yet: one for each address of the host
    (`localhost` may have two) that this machine has. InputError: one of them cannot be had.

    They are bound before anything else is done, so that a second service on a port that is taken
    neither migrates a database nor starts workers.
    """
    made: list[socket.socket] = []
    lacking: OSError | None = None
    try:
        asked = (host or None, port, 0, socket.SOCK_STREAM, 0, socket.AI_PASSIVE)
        for family, kind, protocol, _, address in dict.fromkeys(socket.getaddrinfo(*asked)):
            try:
                made.append(_bound(family, kind, protocol, address, *OWN.get(family, ())))
            except OSError as error:
                if error.errno not in LACKING:
                    raise
                lacking = error
        if lacking is not None and not made:
            raise lacking
    except OSError as error:
        for one in made:
            one.close()
        raise _refused(host, port, error) from None
    return made


def _bound(
    family: int, kind: int, protocol: int, address: tuple[object, ...], *options: tuple[int, int]
) -> socket.socket:
    """A socket with these options (level, name) set."""
    made = socket.socket(family, kind, protocol)
    try:
        for level, name in ((socket.SOL_SOCKET, socket.SO_REUSEADDR), *options):
            made.setsockopt(level, name, 1)
        made.bind(address)
    except OSError:
        made.close()
        raise
    return made


def _refused(host: str, port: int, error: OSError) -> InputError:
    problem = f"cannot be listened on: {error.strerror}"
    remedy = "end the service that listens there, or choose another (--host, --port)"
    return InputError("host and port", f"{host}:{port}", problem, remedy)


def beside(other: socket.socket) -> socket.socket:
    """Another socket at the same address.

    >>> with first("127.0.0.1", 0) as one, beside(one) as two:
    ...     one.getsockname() == two.getsockname()
    True
    """
    return _shared(other.family, other.getsockname())


def _shared(family: int, address: tuple[object, ...]) -> socket.socket:
    return _bound(family, socket.SOCK_STREAM, 0, address, (socket.SOL_SOCKET, socket.SO_REUSEPORT))
