"""The API and its workers as processes of their own, each of which can be killed and comes back.

They run apart, as on several machines: nobody tells the database that a worker died, so that its
lease has to run out. (`serve`, which watches its own workers, has tests in tests/service.)

A process is started by the command line that a user has (`as_shipped`), or, where a study needs
many and a science of its own, forked from a server process that has imported everything (`forked`):
that takes milliseconds instead of seconds, and it can be killed and stopped like any other.
"""

from __future__ import annotations

import multiprocessing
import os
import random
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from service.client import Client
from service.environment import PREFIX
from service.free_port import free_port
from service.settings import Settings
from service.worker.claiming import Role
from service.worker.loop import owner_name
from service.worker.supervise import same_code

Kind = Role | Literal["api"]
ROLES: tuple[Role, ...] = ("all", "apply", "seal")
READY_S = 120.0
PRELOAD = ("service.bootstrap", "service.processes", "service.cli", "service.studies.chaos.twin")


@dataclass(frozen=True, slots=True)
class Child:
    """A running process; `end` waits for it, None: no longer than it takes."""

    pid: int
    end: Callable[[float | None], None]

    def signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def kill(self) -> None:
        """With −9; returns when it is gone."""
        self.signal(signal.SIGKILL)
        self.end(None)

    def states(self) -> set[str]:
        """Those that its threads are in, as letters of Linux."""
        found = set()
        for one in Path(f"/proc/{self.pid}/task").iterdir():
            with suppress(FileNotFoundError, ProcessLookupError):  # it has ended
                found.add((one / "stat").read_text().rpartition(")")[2].split()[0])
        return found


Start = Callable[[Kind, str, Mapping[str, str]], Child]


def as_shipped(kind: Kind, owner: str, environ: Mapping[str, str]) -> Child:
    """By the command lines that a user has."""
    worker = ["worker", "--role", kind, "--owner", owner, "--end-with-parent"]
    words = ["serve"] if kind == "api" else worker
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "service.cli", *words],
        env=same_code(environ),
        stdin=subprocess.DEVNULL if kind == "api" else subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )

    def end(timeout_s: float | None) -> None:
        process.wait(timeout_s)

    return Child(process.pid, end)


def forked(main: Callable[..., None], *arguments: Any) -> Start:
    """From the fork server: ``main(kind, owner, *arguments)`` with the environment set."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(PRELOAD))

    def start(kind: Kind, owner: str, environ: Mapping[str, str]) -> Child:
        given = (main, dict(environ), kind, owner, *arguments)
        process = context.Process(target=_run, args=given, name=f"{kind} {owner}")
        process.start()

        def end(timeout_s: float | None) -> None:
            process.join(timeout_s)
            if process.is_alive():
                raise TimeoutError(f"{process.name} goes on")

        return Child(int(process.pid or 0), end)

    return start


def _run(main: Callable[..., None], environ: Mapping[str, str], *arguments: Any) -> None:
    for name in [name for name in os.environ if name.startswith(PREFIX)]:
        del os.environ[name]
    os.environ.update(environ)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(0)

    threading.Thread(target=watch, name="parent", daemon=True).start()
    main(*arguments)


class Processes:
    """One API and a worker for each of `roles`, on one database."""

    def __init__(
        self, settings: Settings, start: Start = as_shipped, roles: Sequence[Role] = ROLES
    ) -> None:
        self.settings = settings.model_copy(update={"workers": 0, "port": free_port()})
        self.url = f"http://127.0.0.1:{self.settings.port}"
        self.kinds: tuple[Kind, ...] = ("api", *roles)
        self._start = start
        outside = {k: v for k, v in os.environ.items() if not k.startswith(PREFIX)}
        self._environ = outside | self.settings.environ()
        self.children: list[Child] = []
        self.owners: list[str] = []

    def __enter__(self) -> Self:
        self.children = [self._begin("api")]
        with Client(self.url) as client:  # the API migrates; workers come after
            client.ready(READY_S)
        self.children += [self._begin(kind) for kind in self.kinds[1:]]
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        for child in self.children:
            with suppress(ProcessLookupError):  # its end has been seen in what it left undone
                child.signal(signal.SIGTERM)
        for child in self.children:
            try:
                child.end(20)
            except (TimeoutError, subprocess.TimeoutExpired):
                child.kill()

    def _begin(self, kind: Kind) -> Child:
        self.owners.append(owner_name())
        return self._start(kind, self.owners[-1], self._environ)

    def kill(self, chosen: random.Random, share_of_api: float) -> Kind:
        """Kill one with −9, the API with this probability, and start it again; which it was."""
        workers = range(1, len(self.kinds))
        return self._kill(0 if chosen.random() < share_of_api else chosen.choice(workers))

    def kill_owner(self, owner: str) -> Kind | None:
        """The same for the worker that claims under this name; None: it is none of these."""
        return self._kill(self.owners.index(owner)) if owner in self.owners[1:] else None

    def _kill(self, i: int) -> Kind:
        self.children[i].kill()
        self.children[i] = self._begin(self.kinds[i])
        self.owners[i] = self.owners.pop()
        return self.kinds[i]
