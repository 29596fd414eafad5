"""The courses of an hour of load in one picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from service.studies.load.aims import NO_AIMS

COLOURS = {"posts": "#1f3b63", "reads": "#d68910"}


def course_plot(
    samples: Sequence[Mapping[str, Any]],
    title: str,
    path: Path,
    aims_ms: Mapping[str, float] = NO_AIMS,
) -> None:
    """Latencies, backlog, memory of each process and processors in use, over the minutes.

    aims_ms  largest 99th percentile over the whole of ``posts`` and ``reads``, ms: a line each
    """
    samples = samples[:-1] or samples  # the last window is cut
    minutes = [one["at_s"] / 60 for one in samples]
    figure, axes = plt.subplots(4, 1, figsize=(10, 10), sharex=True, layout="constrained")
    for name, colour in COLOURS.items():
        for key, style in (("p50", ":"), ("p99", "-")):
            values = [one[name][key] for one in samples]
            axes[0].plot(minutes, values, style, color=colour, lw=1.3, label=f"{name}, {key}")
        if name in aims_ms:
            axes[0].axhline(
                aims_ms[name], ls="--", color=colour, lw=0.9, label=f"{name}, asked of p99"
            )
    axes[0].set_yscale("log")
    axes[0].set_ylabel("latency [ms]")
    axes[1].plot(minutes, [one["gauges"].get("backlog_entries") for one in samples], lw=1.3)
    axes[1].set_ylabel("backlog [entries]")
    for name in sorted({name for one in samples for name in one["memory_mb"]}):
        memory = [one["memory_mb"].get(name) for one in samples]
        axes[2].plot(minutes, memory, lw=1.3, label=name)
        use = [one["processors"].get(name) for one in samples]
        axes[3].plot(minutes, use, lw=1.3, label=name)
    axes[2].set_ylabel("memory [MiB]")
    axes[3].set_ylabel("processors in use")
    axes[3].set_xlabel("minutes")
    for axis in (axes[1], axes[2], axes[3]):
        axis.margins(y=0.08)
        axis.set_ylim(bottom=0)
    for axis in (axes[0], axes[2], axes[3]):
        axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    for axis in axes:
        axis.grid(color="0.9", lw=0.6)
    figure.suptitle(title, fontsize=11)
    figure.savefig(path, dpi=120)
    plt.close(figure)
