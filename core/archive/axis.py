"""Runs with instants of their own, put on a common axis.

The common axis is that of the run with most instants, up to the hour that all runs reach. The
others are interpolated by monotone cubics (PCHIP: no overshoot), and how much that may cost is
told: every second of a run's own instants is predicted from the rest, which is twice as coarse as
what is done. A run that ends before half of the median run's last hour is refused; it would cut
all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from core.archive.faults import Findings

Array = NDArray[np.float64]
LEAST_SHARE = 0.5  # of the median run's last hour
SAME = 1e-9
LEAST = 4  # instants of a run, and of the common axis


@dataclass(frozen=True, slots=True)
class Axis:
    """The common instants (T,), and the rows' own where they differ: (n, T') with NaN after."""

    time_h: Array
    own: Array | None

    def bring(self, k: int, values: Array) -> tuple[Array, float]:
        """Values (T, …) of run k on the common axis, and the error of it (see the module)."""
        if self.own is None:
            return values, 0.0
        there = np.isfinite(self.own[k])
        own, values = self.own[k][there], values[there]
        same = len(own) >= len(self.time_h) and np.allclose(
            own[: len(self.time_h)], self.time_h, rtol=SAME, atol=0.0
        )
        if same or not np.all(np.isfinite(values)):
            return values[: len(self.time_h)], 0.0
        brought = np.asarray(PchipInterpolator(own, values, axis=0)(self.time_h))
        if len(own) < 5:
            return brought, float("nan")
        kept = np.append(np.arange(0, len(own) - 1, 2), len(own) - 1)
        coarse = PchipInterpolator(own[kept], values[kept], axis=0)(own)
        return brought, float(np.max(np.abs(coarse - values)))


def common(time_h: Array, labels: Sequence[str], skip: Sequence[bool], found: Findings) -> Axis:
    """The axis of runs (T,) or (n, T); faults and a warning go to `found`.

    skip  runs that are left out, (n,)
    """
    if np.all(skip):
        found.fault("runs", 0, "are left to learn from", "leave fewer out, or make some")
        return Axis(np.zeros(0), None)
    if time_h.ndim == 1:
        check(time_h, "time", found)
        return Axis(time_h, None)
    rows = [k for k in range(len(labels)) if not skip[k] and np.any(np.isfinite(time_h[k]))]
    for k in rows:
        own = time_h[k]
        if np.any(np.isinf(own)):
            found.fault(f"run {labels[k]}: time", float("inf"), "is no instant", "end with NaN")
        gap = np.flatnonzero(~np.isfinite(own))
        if len(gap) and np.any(np.isfinite(own[gap[0] :])):
            problem = f"is not finite at place {gap[0]}, but later instants are there"
            found.fault(
                f"run {labels[k]}: time", float("nan"), problem, "put its instants in front"
            )
        else:
            check(own[np.isfinite(own)], f"run {labels[k]}: time", found)
    if not rows:
        found.fault("time_of_run", float("nan"), "holds no instant of any run", "give the hours")
    if found.faults:
        return Axis(np.zeros(0), None)
    last = np.array([np.nanmax(time_h[k]) for k in rows])
    for k, end in zip(rows, last, strict=True):
        if end < LEAST_SHARE * np.median(last):
            problem = f"is where it ends; the median run goes on to {np.median(last):g} h"
            found.fault(f"run {labels[k]}: time", f"{end:g} h", problem, "finish or leave it out")
    counts = np.array([np.count_nonzero(np.isfinite(time_h[k])) for k in rows])
    first = rows[int(np.argmax(counts))]
    axis = time_h[first][np.isfinite(time_h[first])]
    axis = axis[axis <= float(last.min()) * (1 + SAME)]
    if len(axis) and axis[-1] < float(last.min()) * (1 - SAME):
        axis = np.append(axis, last.min())
    same = all(
        np.count_nonzero(np.isfinite(time_h[k])) == len(axis)
        and np.allclose(time_h[k][np.isfinite(time_h[k])], axis, rtol=SAME, atol=0.0)
        for k in rows
    )
    shortest = rows[int(np.argmin(last))]
    if not same:
        odd = [labels[k] for k in rows if not np.array_equal(time_h[k], time_h[first], True)]
        shown = ", ".join(odd[:10]) + (" …" if len(odd) > 10 else "")
        problem = (
            f"have other instants than run {labels[first]}: put on its {len(axis)} instants up to "
            f"{axis[-1] if len(axis) else 0:g} h, where run {labels[shortest]} ends"
        )
        found.warn("runs", shown, problem, "write all runs at the same instants")
    if len(axis) < LEAST:
        problem = f"instants of run {labels[first]} are left up to {last.min():g} h, where run "
        problem += f"{labels[shortest]} ends: fewer than {LEAST}"
        remedy = f"write all runs at the same instants, or leave run {labels[shortest]} out"
        found.fault("runs", len(axis), problem, remedy)
    return Axis(axis, time_h)


def check(time_h: Array, what: str, found: Findings) -> None:
    """Instants from 0, increasing, four or more."""
    bad = np.flatnonzero(~np.isfinite(time_h))
    if len(bad):
        found.fault(f"{what}[{bad[0]}]", float("nan"), "is no instant", "give finite hours")
        return
    if len(time_h) < LEAST:
        found.fault(what, len(time_h), "instants are fewer than four", "write more of the course")
        return
    back = np.flatnonzero(np.diff(time_h) <= 0)
    if len(back):
        k = int(back[0]) + 1
        problem = f"does not increase (before it: {time_h[k - 1]:g})"
        found.fault(f"{what}[{k}]", float(time_h[k]), problem, "sort the instants; each once")
    elif time_h[0] != 0.0:
        remedy = "begin with 0, the state before anything has changed"
        found.fault(f"{what}[0]", float(time_h[0]), "is not 0", remedy)
