"""Measured creep curves through the service: what does Norton's law lack?

    python -m tests.claims.make_specimen_diagnosis

starts `bladetwin serve` on an empty database, posts the twelve specimens' readings over HTTP, asks
for a diagnosis and keeps its answer as tests/claims/results/specimens/diagnosis.json. The model
knows Norton's law alone; what else the specimens may do stands in its network as dormant inputs,
decoys among them. Ids are neutral, and readings are posted in an order of their own.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx

from core.builtin import creep_specimens as built
from core.rng import stream
from service.client import Client
from service.demo.run import service
from service.studies.result import commit
from tests.claims.specimen_data import EVERY, LARGEST, specimens

FILE = Path(__file__).with_name("results") / "specimens" / "diagnosis.json"
COMMAND = "python -m tests.claims.make_specimen_diagnosis"
PARTICLES, SEED = 1024, 1


def readings(seed: int) -> list[dict[str, Any]]:
    """Bodies of all readings that are used, shuffled, with ids that say nothing."""
    found = [
        {"blade": r.blade, "quantity": r.quantity, "time_h": r.time_h, "value": float(r.values[0])}
        for one in specimens()
        for r in one.readings
    ]
    order = stream(seed, "order of posting").permutation(len(found))
    return [{"id": f"i{k:04d}", **found[i]} for k, i in enumerate(order)]


def posted(client: Client, url: str) -> None:
    """The model registered, the specimens created, their readings posted and sealed."""
    job = httpx.post(f"{url}/v1/models", json={"builtin": built.NAME}).raise_for_status()
    awaited(lambda: httpx.get(f"{url}{job.headers['location']}").json(), "registration")
    blades = [{"id": one.name, "known": {"stress": one.stress}} for one in specimens()]
    client.create_rotor(
        "specimens", model=built.NAME, blades=blades, particles=PARTICLES, seed=SEED
    )
    client.post_inspections("specimens", readings(SEED))
    client.wait_sealed("specimens", 1800.0)


def awaited(ask: Callable[[], dict[str, Any]], what: str) -> dict[str, Any]:
    """The job once it is done; its steps go to the terminal."""
    before = None
    while (job := ask())["status"] in ("queued", "running"):
        if job.get("progress") != before:
            before = job.get("progress")
            print(what, before, file=sys.stderr, flush=True)
        time.sleep(1.0)
    if job["status"] != "done":
        raise RuntimeError(f"{what}: {job}")
    return job


def main(file: Path = FILE) -> None:
    began = time.monotonic()
    with (
        tempfile.TemporaryDirectory() as folder,
        service(Path(folder)) as running,
        Client(running.url) as client,
    ):
        client.ready(180)
        posted(client, running.url)
        asked = client.diagnose("specimens")["id"]
        done = awaited(lambda: client.diagnosis("specimens", asked), "diagnosis")
    head = {
        "command": COMMAND,
        "commit": commit(),
        "model": done["result"]["rests_on"]["model_digest"],
        "particles": PARTICLES,
        "seed": SEED,
        "every": EVERY,
        "largest_pct": LARGEST,
        "wall_s": round(time.monotonic() - began),
    }
    file.write_text(json.dumps({**head, "result": done["result"]}, indent=1) + "\n")


if __name__ == "__main__":
    main()
