"""The main job, small (one outage, ten blades read): killed workers change nothing in it."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from core.builtin import inspection_plan
from service.client import Client
from service.demo.stream import Step, steps

demo = importlib.import_module("service.demo.run")
PARTICLES = 768
READ = 10  # blades of the hundred that have readings


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


def main_job(folder: Path, kills: int) -> tuple[dict[str, Any], dict[str, Any], int]:
    """Stream the plan, killing every worker `kills` times on the way; posterior and rotor."""
    plan = inspection_plan.load()
    read = tuple(one for one in plan.inspections if int(one["blade"][1:4]) <= READ)
    plan = replace(plan, inspections=read)
    folder.mkdir()
    done = 0
    with demo.service(folder) as running, Client(running.url) as client:
        client.ready(180)
        post = client.post_inspections

        def deadly(rotor: str, inspections: Any) -> int:
            nonlocal done
            seq = post(rotor, inspections)
            if done < kills and seq > 2 * (done + 1):
                end = time.monotonic() + 60
                while not (victims := workers_of(running.process.pid)):
                    assert time.monotonic() < end, "no worker came back"
                    time.sleep(0.05)
                for victim in victims:
                    os.kill(victim, signal.SIGKILL)
                done += 1
            return seq

        client.post_inspections = deadly  # type: ignore[method-assign]
        last = demo.post_all(client, plan, PARTICLES, seed=4, quiet=True)
        rotor = demo.wait_applied(client, last, 900, quiet=True)
        posterior = client.posterior("demo", "B010")
        return rotor, posterior, done


def test_killing_the_workers_with_9_changes_nothing_in_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo, "steps", lambda plan, seed: one_outage(steps(plan, seed)))
    calm, calm_posterior, _ = main_job(tmp_path / "calm", kills=0)
    wild, wild_posterior, kills = main_job(tmp_path / "wild", kills=3)
    assert kills == 3
    assert wild["head_seq"] == wild["applied_seq"] == calm["applied_seq"]
    assert wild["posterior"]["sealed"]
    assert calm["posterior"]["sealed"]
    assert wild["posterior"]["events_digest"] == calm["posterior"]["events_digest"]
    assert wild["posterior"]["state_digest"] == calm["posterior"]["state_digest"]
    assert wild_posterior["parameters"] == calm_posterior["parameters"]
