"""The main job, small (one outage, ten blades read): killed workers change nothing in it."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from core.builtin import inspection_plan
from service.client import Client
from service.demo.stream import Step, steps
from service.settings import Settings
from tests.patience import until
from tests.service.test_processes import serving

demo = importlib.import_module("service.demo.run")
PARTICLES = 256
READ = 10  # blades that have readings
BLADES = (*(f"B{i:03d}" for i in range(1, READ + 1)), "B028", "B028-2")  # one is replaced


def workers_of(pid: int) -> list[int]:
    """The worker processes below a `bladetwin serve`."""
    found = subprocess.run(
        ["ps", "-o", "pid=,args=", "--ppid", str(pid)], capture_output=True, text=True, check=False
    ).stdout
    return [int(line.split()[0]) for line in found.splitlines() if " worker" in line]


def one_outage(every: Iterable[Step]) -> Iterator[Step]:
    """The steps of the plan up to the end of its first outage."""
    for step in every:
        yield step
        if step.through:
            return


def main_job(client: Client) -> tuple[dict[str, Any], dict[str, Any]]:
    """Stream the plan; rotor and posterior."""
    plan = inspection_plan.load()
    read = tuple(one for one in plan.inspections if int(one["blade"][1:4]) <= READ)
    client.ready(600)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "steps", lambda plan, seed: one_outage(steps(plan, seed)))
        patch.setattr(inspection_plan, "blades", lambda: BLADES)
        last = demo.post_all(client, replace(plan, inspections=read), PARTICLES, 4, quiet=True)
    rotor = demo.wait_applied(client, last, 900, quiet=True)
    return rotor, {**client.posterior("demo", "B010")}


def deadly(client: Client, pid: int, kills: int) -> list[list[int]]:
    """Let the client's posts kill every worker `kills` times; the victims of each.

    One that was killed is listed until its end is seen, and is no victim twice.
    """
    post, killed = client.post_inspections, list[list[int]]()

    def posting(rotor: str, inspections: Any) -> int:
        seq = post(rotor, inspections)
        if len(killed) < kills and seq > 2 * (len(killed) + 1):
            dying = {one for victims in killed for one in victims}
            there = lambda: [one for one in workers_of(pid) if one not in dying]  # noqa: E731
            until("a worker that comes back", there)
            for victim in (victims := there()):
                os.kill(victim, signal.SIGKILL)
            killed.append(victims)
        return seq

    client.post_inspections = posting  # type: ignore[method-assign]
    return killed


def test_killing_the_workers_with_9_changes_nothing_in_the_result(tmp_path: Path) -> None:
    """Of one worker that nobody kills, which applies and seals, the result is the same."""
    url = f"sqlite:///{tmp_path / 'calm.db'}"
    with serving(Settings(database_url=url, sealers=0, diagnosers=0)) as (_, client):
        calm, calm_posterior = main_job(client)
    with demo.service(tmp_path) as running, Client(running.url) as client:
        killed = deadly(client, running.process.pid, 3)
        wild, wild_posterior = main_job(client)
    assert len(killed) == 3
    assert wild["head_seq"] == wild["applied_seq"] == calm["applied_seq"]
    assert wild["posterior"]["sealed"]
    assert calm["posterior"]["sealed"]
    assert wild["posterior"]["events_digest"] == calm["posterior"]["events_digest"]
    assert wild["posterior"]["state_digest"] == calm["posterior"]["state_digest"]
    assert wild_posterior["parameters"] == calm_posterior["parameters"]
