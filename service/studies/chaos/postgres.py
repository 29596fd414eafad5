"""A PostgreSQL server of our own, from the system's binaries, as long as a study runs.

A commit is on the disk's side of the server when it is acknowledged (`synchronous_commit=on`), for
the studies kill the server as well; `fsync` is off, since no study pulls the machine's plug.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import psycopg

from core.errors import BladetwinError

SAFE = ("fsync=off", "synchronous_commit=on", "full_page_writes=off")
QUICK = ("fsync=off", "synchronous_commit=off", "full_page_writes=off")
INITDB = ("-U", "postgres", "-A", "trust", "-E", "UTF8", "--no-sync")
ALWAYS = ("max_connections=300", "listen_addresses=")
READY_S = 120.0


class NoServerError(BladetwinError):
    """No PostgreSQL could be started here; the message says what was tried."""


def binary(name: str) -> str:
    """The newest one of the system; NoServerError where there is none."""
    found = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    path = str(found[-1]) if found else shutil.which(name)
    if path is None:
        raise NoServerError(f"no {name} on this system. To mend it: install PostgreSQL.")
    return path


class Server:
    """One server on a Unix socket in a folder of its own, which goes with it."""

    def __init__(
        self,
        settings: tuple[str, ...] = SAFE,
        folder: Path | None = None,
        initdb: tuple[str, ...] = (),
    ) -> None:
        self.folder = folder or Path(tempfile.mkdtemp(prefix="bladetwin-pg-"))
        self.folder.mkdir(exist_ok=True)
        self._options = [part for one in (*settings, *ALWAYS) for part in ("-c", one)]
        self._process: subprocess.Popen[bytes] | None = None
        user = None
        if os.geteuid() == 0:  # PostgreSQL refuses to run as root
            user = "nobody"
            shutil.chown(self.folder, user)
        env = {**os.environ, "HOME": str(self.folder), "LC_ALL": "C"}
        self._home: dict[str, Any] = {"env": env, "cwd": self.folder, "user": user}
        made = subprocess.run(
            [binary("initdb"), "-D", self.folder / "data", *INITDB, *initdb],
            capture_output=True,
            text=True,
            check=False,
            **self._home,
        )
        if made.returncode:
            raise NoServerError(f"initdb failed: {made.stderr[-2000:]}")

    def url(self, database: str = "postgres") -> str:
        return f"postgresql+psycopg://postgres@/{database}?host={self.folder}"

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.stop(signal.SIGINT)
        shutil.rmtree(self.folder, ignore_errors=True)

    def start(self) -> None:
        """Start it, recovering what a kill left; returns when it answers."""
        log = self.folder / "log"
        (self.folder / "data" / "postmaster.pid").unlink(missing_ok=True)
        with log.open("ab") as out:
            self._process = subprocess.Popen(
                [binary("postgres"), "-D", self.folder / "data", "-k", self.folder, *self._options],
                stdout=out,
                stderr=out,
                **self._home,
            )
        end = time.monotonic() + READY_S
        while time.monotonic() < end and self._process.poll() is None:
            try:
                self.run("SELECT 1")
            except psycopg.OperationalError:
                time.sleep(0.05)
            else:
                return
        raise NoServerError(f"postgres did not start: {log.read_text()[-2000:]}")

    @property
    def runs(self) -> bool:
        """Whether it has not ended."""
        return self._process is not None and self._process.poll() is None

    def stop(self, signum: int) -> None:
        """SIGINT: fast; SIGQUIT: at once, without a checkpoint, as after a crash."""
        if self._process is not None and self.runs:
            self._process.send_signal(signum)
            self._process.wait(READY_S)

    def run(self, *statements: str) -> None:
        """Run statements outside a transaction."""
        with psycopg.connect(
            host=str(self.folder), user="postgres", dbname="postgres", autocommit=True
        ) as connection:
            for statement in statements:
                connection.execute(statement)
