"""`serve` starts workers and further API processes, restarts a dead one and leaves no orphan.

Each gets the read end of a pipe as its standard input; the supervisor holds the write end
and never writes. Children do not inherit each other's pipes, so the death of the supervisor by
any means closes them all. The lease of a worker that died is ended at once: its rotor need not
wait until the lease runs out. The attempt of a worker that died by itself is counted; that of one
which did not end in time when it was told to, and was killed, is not.
"""

from __future__ import annotations

import logging
import os
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from sqlalchemy import Engine

import service
from service.errors import StoreAwayError
from service.worker.lease import release
from service.worker.loop import owner_name

log = logging.getLogger("bladetwin.supervisor")
HEALTHY_S = 5.0
SHORTEST_PAUSE_S = 0.1
LONGEST_PAUSE_S = 10.0
R = TypeVar("R", bound=str)


def same_code(environ: Mapping[str, str]) -> dict[str, str]:
    """The environment of a child that runs this very code, wherever it is started from.

    Python puts the current folder first, which may hold another copy (a checkout, say) with
    kernels of its own still to be compiled; children are started with ``-P`` and this path.
    """
    root = str(Path(service.__file__).parent.parent)
    paths = [root, *filter(None, environ.get("PYTHONPATH", "").split(os.pathsep))]
    return {**environ, "PYTHONPATH": os.pathsep.join(dict.fromkeys(paths))}


@dataclass(slots=True)
class Child(Generic[R]):
    """A running process, its role, and the name under which a worker claims."""

    process: subprocess.Popen[bytes]
    role: R
    owner: str
    started: float


class Supervisor(Generic[R]):
    """Keeps one process alive for each of `roles`. `command(owner, role)` is a command line.

    inherited   descriptors that the processes get beside their standard ones
    listens     makes a socket for each process, which is told of it by ``--socket``
    """

    def __init__(
        self,
        engine: Engine,
        roles: Sequence[R],
        command: Callable[[str, R], list[str]],
        environ: Mapping[str, str],
        *,
        inherited: Sequence[int] = (),
        listens: Callable[[], socket.socket] | None = None,
    ) -> None:
        self._engine = engine
        self._roles = tuple(roles)
        self._command = command
        self._environ = same_code({**os.environ, **environ})
        self._inherited = tuple(inherited)
        self._listens = listens
        self._children: list[Child[R]] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="supervisor", daemon=True)
        self._pauses = [SHORTEST_PAUSE_S] * len(self._roles)
        self._due: dict[int, float] = {}  # by place, when the next worker is to be started

    def start(self) -> None:
        self._children = [self._spawn(role) for role in self._roles]
        self._thread.start()

    def pids(self) -> list[int]:
        """Process ids of those that run now."""
        return [child.process.pid for child in self._children if child.process.poll() is None]

    def _spawn(self, role: R) -> Child[R]:
        owner = owner_name()
        command, inherited = self._command(owner, role), self._inherited
        with ExitStack() as own:
            if self._listens is not None:
                number = own.enter_context(self._listens()).fileno()
                command, inherited = [*command, "--socket", str(number)], (*inherited, number)
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                env=self._environ,
                close_fds=True,
                pass_fds=inherited,
            )
        return Child(process, role, owner, time.monotonic())

    def _watch(self) -> None:
        while not self._stop.wait(0.05):
            for i, child in enumerate(self._children):
                code = child.process.poll()
                if code is None or self._stop.is_set():
                    continue
                try:
                    if i not in self._due:
                        self._ended(i, child, code)
                    if time.monotonic() >= self._due[i]:
                        self._children[i] = self._spawn(child.role)
                        del self._due[i]
                except Exception:
                    log.exception("no worker could be started; another attempt in 1 s")
                    self._stop.wait(1.0)

    def _ended(self, i: int, child: Child[R], code: int) -> None:
        """Free what a worker held, and say when the next one is started in its place.

        At once where it had lived; one that ends soon after its start is likely to do so again, and
        waits the longer each time, while others are watched.
        """
        name = child.role if child.role == "api" else "worker"
        log.warning("%s %d ended with %d; starting another", name, child.process.pid, code)
        self._close(child)
        self._release(child, counted=True)
        young = time.monotonic() - child.started < HEALTHY_S
        self._pauses[i] = min(2 * self._pauses[i], LONGEST_PAUSE_S) if young else SHORTEST_PAUSE_S
        self._due[i] = time.monotonic() + (self._pauses[i] if young else 0.0)

    def _release(self, child: Child[R], *, counted: bool) -> None:
        try:
            release(self._engine, child.owner, counted=counted)
        except StoreAwayError as error:
            log.error("leases of %s stay until they run out: %s", child.owner, error.reason)

    @staticmethod
    def _close(child: Child[R]) -> None:
        if child.process.stdin is not None:
            child.process.stdin.close()

    def begin_stop(self) -> None:
        """Tell every process to end, and start none any more."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()
        for child in self._children:
            if child.process.poll() is None:
                child.process.terminate()

    def stop(self, patience_s: float = 10.0) -> None:
        """Let every process end by itself; kill those that take longer than `patience_s`."""
        self.begin_stop()
        end = time.monotonic() + patience_s
        for child in self._children:
            killed = False
            try:
                child.process.wait(max(0.0, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()
                killed = True
            self._close(child)
            if child.process.returncode:
                self._release(child, counted=not killed)
