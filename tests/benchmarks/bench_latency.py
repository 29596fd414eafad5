"""One inspection posted by hand: how long until its blade's new band is read.

    python tests/benchmarks/bench_latency.py [POSTS] [BLADES] [PAUSE_S]

Starts `bladetwin serve` on a new SQLite database, creates a rotor at 10,000 particles per blade,
streams elongations of the first outage, then posts one reading at a time and reads the blade's
prediction once it rests on the new reading. Between posts: PAUSE_S seconds, while the sealer still
works on the last ones; 0 waits until they are sealed.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from core.builtin import inspection_plan
from service.client import Client
from service.demo.run import service


def main(posts: int, blades: int, pause_s: float) -> None:
    """Print the distribution of ack and of post → visible band [ms]."""
    plan = inspection_plan.load()
    names = [b for b in inspection_plan.blades() if not b.endswith("-2")][:blades]
    readings = [
        i for i in plan.inspections if i["blade"] in names and i["quantity"] == "elongation"
    ]
    first = [r for r in readings if r["campaign"] == "outage-1"]
    later = [r for r in readings if r["campaign"] != "outage-1"][:posts]
    with (
        tempfile.TemporaryDirectory() as folder,
        service(Path(folder)) as running,
        Client(running.url) as client,
    ):
        client.ready(300)
        client.create_rotor("r", blades=names, particles=10_000)
        client.post_inspections("r", first)
        client.wait_sealed("r", 300)
        acks, seen = [], []
        for reading in later:
            start = time.perf_counter()
            seq = client.post_inspections("r", [reading])
            acks.append(time.perf_counter() - start)
            client.wait_for("r", seq)
            band = client.prediction("r", reading["blade"], times=[32_000.0])
            seen.append(time.perf_counter() - start)
            assert band["rests_on"]["through_seq"] >= seq
            if pause_s:
                time.sleep(pause_s)
            else:
                client.wait_sealed("r", 300)
        client.wait_sealed("r", 300)
    for name, values in {"acknowledged": acks, "band visible": seen}.items():
        ms = 1e3 * np.array(values)
        print(
            f"{name}: median {np.median(ms):.0f}, 95th percentile {np.percentile(ms, 95):.0f}, "
            f"max {ms.max():.0f} ms ({len(ms)} posts, {blades} blades)"
        )


if __name__ == "__main__":
    words = sys.argv[1:] + ["40", "100", "1"][len(sys.argv) - 1 :]
    main(int(words[0]), int(words[1]), float(words[2]))
