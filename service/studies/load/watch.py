"""What the processes and the database look like while they run (Linux: it reads /proc)."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import httpx

PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 2**20
TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
GAUGES = (
    *("backlog_entries", "oldest_entry_seconds", "dirty_rotors", "provisional_rotors"),
    *("blocked_rotors", "entries_applied_total", "versions_total", "versions_sealed_total"),
    "takeovers_total",
)
YARD = 20_000


def yardstick_ms() -> float:
    """Processor time of a fixed piece of Python, ms: how quick a processor is at this moment.

    The same machine can be half as fast an hour later, by what others do on its host.
    """
    begun, total = time.thread_time(), 0
    for number in range(YARD):
        total += number * number
    return round(1e3 * (time.thread_time() - begun), 3)


def machine_ticks() -> dict[str, int]:
    """What all processors did since the machine's start, in ticks; empty: it is not told.

    `stolen` is what the host withheld: something here could run, and did not get a processor.
    """
    words = _text("/proc/stat").partition("\n")[0].split()
    if len(words) < 9 or words[0] != "cpu":
        return {}
    user, nice, system, idle, waiting, irq, soft, stolen = map(int, words[1:9])
    used = user + nice + system + irq + soft
    return {"used": used, "stolen": stolen, "waiting_for_disk": waiting, "idle": idle}


def shares(before: dict[str, int], after: dict[str, int]) -> dict[str, float]:
    """Shares of the time of all processors between two `machine_ticks`.

    >>> shares({"used": 10, "idle": 5}, {"used": 40, "idle": 15})
    {'used': 0.75, 'idle': 0.25}
    """
    spent = {name: after[name] - before[name] for name in after if name in before}
    total = sum(spent.values())
    return {name: round(ticks / total, 4) for name, ticks in spent.items()} if total > 0 else {}


def family(pid: int) -> dict[str, int]:
    """A server's processes by their names: ``api`` and further ones, ``apply 1`` … by role."""
    found, counts = {"api": pid}, dict[str, int]()
    for child in sorted(_children(pid)):
        words = _text(f"/proc/{child}/cmdline").split("\0")
        if "--place" in words:
            found[f"api {int(words[words.index('--place') + 1]) + 1}"] = child
        if "--role" in words:
            role = words[words.index("--role") + 1]
            counts[role] = counts.get(role, 0) + 1
            found[f"{role} {counts[role]}"] = child
    return found


def _children(pid: int) -> Iterator[int]:
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        yield from (int(word) for word in _text(task).split())


def memory_mb(pid: int) -> float | None:
    """Resident memory, MiB; None: the process is gone."""
    words = _text(f"/proc/{pid}/statm").split()
    return round(int(words[1]) * PAGE_MB, 2) if words else None


def processor_s(pid: int) -> float | None:
    """Processor time so far, s; None: the process is gone."""
    words = _text(f"/proc/{pid}/stat").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) * TICK_S if words else None


def gauges(client: httpx.Client) -> dict[str, float]:
    """What /metrics says of the whole database; empty: it did not answer."""
    try:
        text = client.get("/metrics").text
    except httpx.TransportError:
        return {}
    found = {}
    for line in text.splitlines():
        name, _, value = line.partition(" ")
        if name.removeprefix("bladetwin_") in GAUGES:
            found[name.removeprefix("bladetwin_")] = float(value)
    return found


def files_mb(folder: Path) -> float:
    """The size of all files below a folder, MiB."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.stat().st_size if path.is_file() else 0
        except OSError:
            continue  # it went meanwhile
    return round(total / 2**20, 2)


def _text(path: str | Path) -> str:
    try:
        return Path(path).read_text()
    except OSError:
        return ""
