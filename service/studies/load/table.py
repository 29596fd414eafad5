"""The table of an hour of load, in markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any


def table(head: Mapping[str, Any], results: Mapping[str, Mapping[str, Any]]) -> str:
    """Latencies, what was applied, what grew, and what more workers bring."""
    machine = head["machine"]
    lines = [
        "# Load",
        "",
        f"{head['minutes']:g} minutes, {head['rotors']} rotors of {head['blades']} blades, "
        f"{head['rate']:g} posts and {head['reads']:g} reads a second at random moments, science "
        f"{head['science']}, {head.get('api_processes', 1)} API process(es), {head['workers']} "
        "worker(s) and a sealer; load generator, server and "
        f"database share {machine['processors']} processors. Latencies count from the moment at "
        "which a request was due.",
        "",
        "| database | | p50 [ms] | p95 [ms] | p99 [ms] | largest [ms] | as it should be |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, one in results.items():
        for what in ("posts", "reads"):
            part = one[what]
            good = f"{part['good']} of {part['answered']}"
            cells = [name, what, *(_shown(part[k]) for k in ("p50", "p95", "p99", "max")), good]
            lines.append(f"| {' | '.join(cells)} |")
    for name, one in results.items():
        lines += [
            "",
            f"On {name}: {one['posted']} posted, {one['applied']} applied, {one['versions']} "
            f"versions, {one['sealed_versions']} of them sealed; nothing left "
            f"{_shown(one['drained_after_s'])} s after the last post; database locked: "
            f"{'yes' if one['locked'] else 'never'}.",
            *_yardstick(one["samples"]),
            *_machine(one["samples"]),
            "",
            "| course | median | slope per hour | 95 % interval | |",
            "|---|---|---|---|---|",
        ]
        for course, found in one["trends"].items():
            interval = found.get("interval")
            shown = "" if interval is None else f"{interval[0]:g} … {interval[1]:g}"
            cells = [course, _shown(found.get("median")), _shown(found.get("per_hour")), shown]
            lines.append(f"| {' | '.join([*cells, found['verdict']])} |")
        lines += ["", f"Not as it was asked for: {'; '.join(one['faults']) or 'nothing'}."]
        if one.get("scaling"):
            lines += [
                "",
                "| workers | entries | seconds | rotors sealed a second | entries a second |",
                "|---|---|---|---|---|",
            ]
            for row in one["scaling"]:
                lines.append(
                    f"| {row['workers']} | {row['entries']} | {row['seconds']:g} | "
                    f"{row['rotors_per_s']:g} | {row['entries_per_s']:g} |"
                )
            shown = ", ".join(f"{ratio:.2f}" for ratio in one["gain"]["ratios"])
            lines += [
                "",
                f"Rotors a second of two workers over those of one: {one['gain']['median']:.2f} in "
                f"the middle of {len(one['gain']['ratios'])} pair(s) ({shown}).",
            ]
    return "\n".join(lines) + "\n"


def _yardstick(samples: Sequence[Mapping[str, Any]]) -> list[str]:
    """How quick the processors were meanwhile (`watch.yardstick_ms`)."""
    took = [one["yardstick_ms"] for one in samples if "yardstick_ms" in one]
    if not took:
        return []
    return [
        "",
        f"A fixed piece of Python took {median(took):.1f} ms of a processor meanwhile "
        f"({min(took):.1f} … {max(took):.1f}).",
    ]


def _shown(value: float | None) -> str:
    return "–" if value is None else f"{value:g}"


def _machine(samples: Sequence[Mapping[str, Any]]) -> list[str]:
    """How full the processors were, and what the host withheld (`watch.machine_ticks`)."""
    told = [one["machine"] for one in samples if one.get("machine")]
    if not told:
        return []
    of = {name: [one[name] for one in told] for name in told[0]}
    middle = {name: f"{100 * median(shares):.0f} %" for name, shares in of.items()}
    return [
        "",
        f"In the middle of the windows {middle['used']} of the processors' time was used, "
        f"{middle['stolen']} withheld by the host (at most {100 * max(of['stolen']):.0f} %) and "
        f"{middle['waiting_for_disk']} spent waiting for the disk (at most "
        f"{100 * max(of['waiting_for_disk']):.0f} %).",
    ]
