"""PostgreSQL on a disk that fills up under a running API and worker.

The server's data directory lies on a small file system in memory (tmpfs) that this study mounts,
for which it has to be root, and fills with a file of ballast but for a random rest. In half of the
trials tables cannot grow, which is an error to the statement; in the other half the study writes
WAL besides until that cannot grow either, and the server crashes. The disk stays full for many
leases; then the ballast goes, a server that ended is started, and clients send again what was
refused.
"""

from __future__ import annotations

import errno
import os
import random
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import psycopg

from core.errors import BladetwinError
from service.ports import Json
from service.studies.chaos.bench import LEASE_S, Bench
from service.studies.chaos.check import Findings
from service.studies.chaos.postgres import SAFE, Server
from service.studies.chaos.processes import Processes, forked
from service.studies.chaos.twin import main

DISK_MB = 160
SMALL = ("min_wal_size=2MB", "max_wal_size=4MB", "checkpoint_timeout=30s")
LEAST, MOST = 0, 400_000  # bytes that the ballast leaves
BATCH = 60
FULL_S = 12 * LEASE_S  # a rotor is blocked after five attempts
PATIENCE_S = 90.0
TRIES = 50
WAL_MB = 40


class NoDiskError(BladetwinError):
    """No file system of a size of our own can be had here; the message says why."""


@contextmanager
def small_disk(megabytes: int = DISK_MB) -> Iterator[Path]:
    """A folder on a file system of its own size, gone afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="bladetwin-disk-"))
    options = f"size={megabytes}m,mode=0755"
    mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True, check=False)
    if done.returncode:
        folder.rmdir()
        raise NoDiskError(f"no tmpfs could be mounted: {done.stderr.strip()}. Run it as root.")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], capture_output=True, check=False)
        folder.rmdir()


class Ballast:
    """A file that leaves `room` bytes of its file system free."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "ballast"

    def fill(self, room: int) -> None:
        """Take all but `room` bytes, to the block; again where the server was quicker."""
        for _ in range(TRIES):
            disk = os.statvfs(self._file.parent)
            size = max(0, disk.f_bavail * disk.f_frsize - room)
            with self._file.open("wb") as out:
                try:
                    if size:
                        os.posix_fallocate(out.fileno(), 0, size)
                except OSError as error:
                    if error.errno != errno.ENOSPC:
                        raise
                    out.truncate(0)
                    continue
            return
        raise NoDiskError("the disk could not be filled: the server grows too fast. Try again.")

    def drop(self) -> None:
        self._file.unlink(missing_ok=True)


def run(trials: int, seed: int, progress: Any) -> tuple[Sequence[str], Findings]:
    """The outcome of each trial, and what the tables hold in the end."""
    chosen = random.Random(seed)
    with (
        small_disk() as folder,
        Server((*SAFE, *SMALL), folder / "server", initdb=("--wal-segsize=1",)) as server,
    ):
        bench = Bench(server.url(), seed)
        outcomes = []
        try:
            with (
                Processes(bench.settings, forked(main), ("all",)) as running,
                httpx.Client(base_url=running.url, timeout=60.0) as client,
            ):
                for number in range(trials):
                    rotor = bench.rotor(f"r{number}")
                    outcomes.append(trial(bench, rotor, server, client, Ballast(folder), chosen))
                    progress(number + 1)
            bench.settle()
            return outcomes, bench.check()
        finally:
            bench.close()


def trial(
    bench: Bench,
    rotor: str,
    server: Server,
    client: httpx.Client,
    ballast: Ballast,
    chosen: random.Random,
) -> str:
    """Fill the disk, post until refused and on, make room; what was seen, in words."""
    seen = Counter[str]()
    refused: list[Json] = []
    began = _began(server)
    ballast.fill(chosen.randrange(LEAST, MOST))
    try:
        until, number = time.monotonic() + PATIENCE_S, 0
        while not refused and time.monotonic() < until:
            body = _batch(bench, rotor, number)
            if not _post(bench, client, rotor, body, seen):
                refused.append(body)
            number += 1
        if chosen.random() < 0.5:
            _fill_wal(server)
        full = time.monotonic() + FULL_S
        while time.monotonic() < full:
            _post(bench, client, rotor, refused[0] if refused else body, seen)
            seen[f"read {client.get(f'/v1/rotors/{rotor}').status_code}"] += 1
            time.sleep(LEASE_S / 4)
    finally:
        ballast.drop()
    ended = not server.runs
    if ended:
        server.start()
    again = time.monotonic() + PATIENCE_S
    for body in refused:
        while not _post(bench, client, rotor, body, Counter()) and time.monotonic() < again:
            time.sleep(0.1)
    told = _settled(client, rotor, again)
    odd = sorted(k for k in seen if k not in ("202", "503 database-away", "read 200", "read 503"))
    words = ["posts are told 503 (database-away)" if refused else "nothing was refused"]
    words += [f"OTHERWISE: {', '.join(odd)}"] if odd else []
    crashed = (
        "ended itself" if ended else "crashed and recovered" if _began(server) != began else ""
    )
    words.append(f"the server {crashed or 'went on'}")
    words.append(f"{told} when there was room")
    return "; ".join(words)


def _began(server: Server) -> object:
    """When the server's own processes began: anew after a crash, though the server went on."""
    query = "SELECT backend_start FROM pg_stat_activity WHERE backend_type = 'checkpointer'"
    with psycopg.connect(host=str(server.folder), user="postgres", dbname="postgres") as opened:
        return opened.execute(query).fetchone()


def _fill_wal(server: Server) -> None:
    """Write WAL until the server cannot, as an hour of refused posts would."""
    with suppress(psycopg.Error):
        for _ in range(WAL_MB):
            server.run("SELECT pg_logical_emit_message(false, 'ballast', repeat('x', 1000000))")


def _batch(bench: Bench, rotor: str, number: int) -> Json:
    rows = []
    for i in range(BATCH):
        one = bench.reading(f"{rotor}-{number}-{i}")
        rows.append(
            {"id": one.id, "blade": one.blade, "quantity": one.quantity, "time_h": one.time_h}
            | {"value": float(one.values[0])}
        )
    return {"inspections": rows}


def _post(bench: Bench, client: httpx.Client, rotor: str, body: Json, seen: Counter[str]) -> bool:
    """Whether a batch was acknowledged; each number is noted, and may not change."""
    answer = client.post(f"/v1/rotors/{rotor}/inspections", json=body)
    told = answer.json()
    if answer.status_code != 202:
        seen[f"{answer.status_code} {told['type'].rpartition(':')[2]}"] += 1
        return False
    seen["202"] += 1
    for item in told["items"]:
        first = bench.acknowledged.setdefault((rotor, item["id"]), item["seq"])
        if first != item["seq"]:
            raise BladetwinError(f"{rotor}/{item['id']} had number {first}, has {item['seq']} now")
    return True


def _settled(client: httpx.Client, rotor: str, until: float) -> str:
    """How the rotor came to be current and sealed again."""
    while time.monotonic() < until:
        answer = client.get(f"/v1/rotors/{rotor}")
        told = answer.json()
        if answer.status_code == 200 and told["status"] == "blocked":
            client.post(f"/v1/rotors/{rotor}/retry")
            return f"NOT WITHOUT HELP, blocked ({told['last_error']})"
        if answer.status_code == 200 and told["status"] == "current":
            posterior = told["posterior"]
            if posterior is not None and posterior["sealed"]:
                return "goes on by itself"
        time.sleep(0.1)
    return "LATE: not sealed"
