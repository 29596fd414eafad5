"""How long a reading waits whose worker is killed: `serve` with workers of its own, on SQLite.

    python tests/benchmarks/bench_recovery.py [KILLS]

`bladetwin serve` as a user starts it, with the exact twin. A reading is posted and the worker that
applies is killed with -9, just before the post or some milliseconds after it; timed is from the
answer to the post until the reading counts in a stored posterior, which another process has
computed by then. Beside it the same without a kill. Each worker lives `HEALTHY_S` before it is
killed: one that ends sooner is started again after a pause.

Then the same between workers that nobody supervises, as on two machines: one is killed in the
midst of an update, and timed is from there until another one has done it. It sleeps (SIGSTOP) until
the first has the rotor, or it would have been quicker.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from sqlalchemy import select

from service.bootstrap import make_store
from service.client import Client
from service.free_port import free_port
from service.settings import Settings
from service.store import tables as t
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.studies.load.run import serving
from service.studies.load.watch import family
from service.worker.supervise import HEALTHY_S

NAMES = [f"B{b:02d}" for b in range(20)]
SEED = 1


def applying(server: int) -> int:
    """The process that applies, once there is one."""
    while (found := family(server).get("apply 1")) is None:
        time.sleep(0.01)
    return found


def waited(client: Client, server: int, number: int, kill: str, chosen: random.Random) -> float:
    """Seconds from the acknowledgement of a reading until it counts."""
    body = {"id": f"{kill}-{number}", "blade": NAMES[number % len(NAMES)], "value": 0.05}
    body |= {"quantity": "elongation", "time_h": 1000.0 + number}
    worker = applying(server)
    if kill == "before":
        os.kill(worker, signal.SIGKILL)
    seq = client.post_inspections("r", [body])
    begun = time.perf_counter()
    if kill == "after":
        time.sleep(chosen.uniform(0.0, 0.012))
        os.kill(worker, signal.SIGKILL)
    client.wait_for("r", seq)
    return time.perf_counter() - begun


def measured(kills: int) -> None:
    chosen = random.Random(SEED)
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings.load(
            {}, database_url=f"sqlite:///{folder}/b.db", port=free_port(), science="fake",
            log_level="error", diagnosers=0,
        )  # fmt: skip
        url = f"http://127.0.0.1:{settings.port}"
        with serving(settings, Path(folder) / "log") as server, Client(url) as client:
            client.ready(60)
            client.create_rotor("r", blades=NAMES)
            client.wait_for("r", 0)
            for kill in ("no", "before", "after"):
                took = []
                for number in range(kills):
                    took.append(waited(client, server.pid, number, kill, chosen))
                    time.sleep(0.2 if kill == "no" else HEALTHY_S + chosen.uniform(0.5, 1.5))
                print(
                    f"killed {kill:6}: median {np.median(took):.2f} s, longest {max(took):.2f} s "
                    f"of {kills}; a lease lasts {settings.lease_s:g} s",
                    flush=True,
                )


def holder(store: SqlStore) -> str | None:
    with transaction(store.engine, write=False) as connection:
        return connection.execute(select(t.cursor.c.owner)).scalar()


def worker(settings: Settings, name: str, delay_s: float) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tests.service.slow_worker", name, "apply", str(delay_s)]
    environ = {**os.environ, **settings.environ(), "PYTHONPATH": str(Path(__file__).parents[2])}
    return subprocess.Popen(command, env=environ, stdin=subprocess.PIPE)


def between_machines(kills: int) -> None:
    took = []
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings.load(
            {}, database_url=f"sqlite:///{folder}/b.db", port=free_port(), science="fake",
            log_level="error", workers=0, sealers=0, diagnosers=0,
        )  # fmt: skip
        url, store = f"http://127.0.0.1:{settings.port}", make_store(settings)
        with serving(settings, Path(folder) / "log"), Client(url) as client:
            client.ready(60)
            client.create_rotor("r", blades=NAMES)
            second = worker(settings, "second", 0.0)
            client.wait_for("r", 0)
            for number in range(kills):
                second.send_signal(signal.SIGSTOP)
                first = worker(settings, "first", 600.0)
                body = {"id": f"i{number}", "blade": NAMES[number % len(NAMES)], "value": 0.05}
                body |= {"quantity": "elongation", "time_h": 1000.0 + number}
                seq = client.post_inspections("r", [body])
                while holder(store) != "first":
                    time.sleep(0.01)
                time.sleep(0.5 + number % 5 * 0.6)  # anywhere between two heartbeats
                second.send_signal(signal.SIGCONT)
                begun = time.perf_counter()
                first.kill()
                first.wait()
                client.wait_for("r", seq)
                took.append(time.perf_counter() - begun)
            second.kill()
            second.wait()
    print(
        f"another worker: median {np.median(took):.2f} s, longest {max(took):.2f} s of {kills}; "
        f"a lease lasts {settings.lease_s:g} s"
    )


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    measured(count)
    between_machines(count)
