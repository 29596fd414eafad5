"""How long a reading waits whose worker is killed: `serve` with workers of its own, on SQLite.

    python tests/benchmarks/bench_recovery.py [KILLS]

`bladetwin serve` as a user starts it, with the exact twin. A reading is posted and the worker that
applies is killed with -9, just before the post or some milliseconds after it; timed is from the
answer to the post until the reading counts in a stored posterior, which another process has
computed by then. Beside it the same without a kill. Each worker lives `HEALTHY_S` before it is
killed: one that ends sooner is started again after a pause.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from service.client import Client
from service.settings import Settings
from service.studies.chaos.processes import free_port
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


if __name__ == "__main__":
    measured(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
