"""A real server with its workers under load, sampled window by window; and a backlog worked off."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import numpy as np

from service.client import Client
from service.environment import PREFIX
from service.free_port import free_port
from service.ports import Json
from service.settings import Settings
from service.studies.load import demand, watch
from service.studies.load.crowd import Answered, Crowd
from service.studies.load.trend import summary, trends
from service.worker.supervise import same_code

READY_S = 180.0
DRAIN_S = 300.0
LOCKED = "database is locked"
Progress = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """How much is asked of what for how long."""

    minutes: float
    rate: float
    reads: float
    rotors: int
    blades: int
    workers: int
    api_processes: int
    science: str
    particles: int
    window_s: float
    seed: int

    def settings(self, database_url: str) -> Settings:
        return Settings.load(
            {},
            database_url=database_url,
            science=self.science,
            migrate="always",
            workers=self.workers,
            api_processes=self.api_processes,
            diagnosers=0,
            port=free_port(),
            particles=self.particles,
            log_level="warning",
        )


@contextmanager
def serving(settings: Settings, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """`bladetwin serve` by its command line; ended in order."""
    outside = {k: v for k, v in os.environ.items() if not k.startswith(PREFIX)}
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "service.cli", "serve"],
            env=same_code(outside | settings.environ()),
            stdout=subprocess.DEVNULL,
            stderr=out,
        )
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def loaded(
    plan: Plan, database_url: str, files: Path | None, log: Path, progress: Progress
) -> Json:
    """One run: samples of each window, the whole, and what grew.

    files   folder of the database, whose size is sampled; None: it lies elsewhere
    """
    settings = plan.settings(database_url)
    url, seconds = f"http://127.0.0.1:{settings.port}", 60 * plan.minutes
    size = (max(4, round(plan.rate / 2)), max(4, round(plan.reads / 4)))
    with serving(settings, log) as process, httpx.Client(base_url=url, timeout=60) as probe:
        with Client(url) as client:
            client.ready(READY_S)
            for number in range(plan.rotors):
                blades = [demand.blade_name(i) for i in range(plan.blades)]
                client.create_rotor(demand.rotor_name(number), blades=blades)
        _drained(probe)
        known = (seconds, plan.rotors, plan.blades, plan.seed)
        begun = time.monotonic() + 1.0
        crowds = [
            Crowd(url, demand.posts(plan.rate, *known), min(size[0], 64), begun),
            Crowd(url, demand.reads(plan.reads, *known), min(size[1], 64), begun),
        ]
        samples: list[Json] = []
        everything: list[Answered] = []
        used: dict[int, float] = {}
        ticks = watch.machine_ticks()
        try:
            while any(crowd.busy for crowd in crowds):
                end = begun + (len(samples) + 1) * plan.window_s
                while time.monotonic() < end and any(crowd.busy for crowd in crowds):
                    time.sleep(0.05)
                    progress(min(int(seconds), max(0, int(time.monotonic() - begun))))
                taken = [one for crowd in crowds for one in crowd.taken()]
                everything += taken
                at = time.monotonic() - begun
                sample = _sample(at, taken, process.pid, probe, files, used, plan.window_s)
                before, ticks = ticks, watch.machine_ticks()
                samples.append(sample | {"machine": watch.shares(before, ticks)})
        finally:
            for crowd in crowds:
                crowd.stop()
        everything += [one for crowd in crowds for one in crowd.taken()]  # after the last sample
        left = _drained(probe)
        last = watch.gauges(probe)
    text = log.read_text(errors="replace")
    posted = sum(one.good for one in everything if one.kind == "post")
    whole = summary(everything)
    late = [one.late_s for one in everything]
    told: Json = {
        "asked": {"posts": plan.rate, "reads": plan.reads},
        "answered_per_s": round(len(everything) / max(seconds, 1e-9), 1),
        **whole,
        "late_ms_p99": round(1e3 * float(np.percentile(late, 99)), 1) if late else None,
        "posted": posted,
        "applied": int(last.get("entries_applied_total", -1)),
        "versions": int(last.get("versions_total", -1)),
        "sealed_versions": int(last.get("versions_sealed_total", -1)),
        "drained_after_s": left,
        "locked": LOCKED in text or any(LOCKED in one.problem for one in everything),
        "lines_in_the_log": text.count("\n"),
        "trends": trends(samples[:-1]),
        "samples": samples,
    }
    return told


def _sample(
    at: float,
    taken: list[Answered],
    pid: int,
    probe: httpx.Client,
    files: Path | None,
    used: dict[int, float],
    window_s: float,
) -> Json:
    memory, processors = dict[str, float](), dict[str, float]()
    for name, own in watch.family(pid).items():
        if (mb := watch.memory_mb(own)) is not None:
            memory[name] = mb
        if (spent := watch.processor_s(own)) is not None:
            if own in used:
                processors[name] = round((spent - used[own]) / window_s, 3)
            used[own] = spent
    told = summary(taken)
    return {
        "at_s": round(at, 1),
        "posts": told["posts"],
        "reads": told["reads"],
        "gauges": watch.gauges(probe),
        "memory_mb": memory,
        "processors": processors,
        "yardstick_ms": watch.yardstick_ms(),
        "database_mb": None if files is None else watch.files_mb(files),
    }


def _drained(probe: httpx.Client) -> float | None:
    """Seconds until nothing is left to apply or to seal; None: it was not to be waited for."""
    begun = time.monotonic()
    while time.monotonic() < begun + DRAIN_S:
        found = watch.gauges(probe)
        if found and found["backlog_entries"] == found["dirty_rotors"] == 0:
            return round(time.monotonic() - begun, 1)
        time.sleep(0.1)
    return None
