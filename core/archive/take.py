"""A user's runs become an archive, or every fault of them is told.

All runs are read, one at a time, before anything is refused. What happens to what:

==============================  ==================================================================
a run that is missing           left out and named, where its label lacks in a row of numbers or
                                nothing but NaN is there
NaN at a node or instant        refused: run, quantity, hour, node; `leave_out` takes it out
a unit that is none             refused; one that differs: converted and told, or refused where it
                                measures something else
numbers of another magnitude    a warning with the factor that would fit (mm given as m)
numbers beyond 1e30, 1e-30      refused (`core.archive.unfit`)
unequal instants                a common axis and a warning (`core.archive.axis`); refused where
                                hardly an instant is common
a quantity that never changes   refused, for nothing can be learnt from it
an input that never varies      refused, or left out where the network does not know it
an input outside its bounds     refused
equal runs                      one is kept, with a warning; refused where they differ
too few runs                    refused with the number that is needed; a warning below ten for
                                each input
==============================  ==================================================================
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.archive.axis import Axis, common
from core.archive.changes import Seen, check_changes
from core.archive.check import Wanted, wanted
from core.archive.declaration import Mesh, Quantity, Run
from core.archive.faults import Findings
from core.archive.source import Source
from core.archive.store import Archive
from core.archive.unfit import not_finite, too_large
from core.network import Network

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Progress = Callable[[str, int, int], None]
MINIMUM_RUNS = 3  # times (number of inputs + 1)
ENOUGH = 10  # runs for each input (J. L. Loeppky, J. Sacks, W. J. Welch, Technometrics 51 (2009))
COMMAND = "runs of a user's own"


def take(
    source: Source,
    network: Network,
    folder: str | Path,
    *,
    leave_out: Sequence[str] = (),
    progress: Progress | None = None,
) -> tuple[Archive, Findings, tuple[int, ...]]:
    """The archive in `folder` (empty or absent), the warnings, and the runs to train on.

    leave_out   labels of runs that the user wants left out
    Raises RunsError with every fault; the folder is then not to be used.
    """
    found = Findings([*source.faults])
    skip = _skipped(source, leave_out, found)
    away = skip | source.empty(skip)
    axis = common(source.time_h, source.labels, away.tolist(), found)
    plan = wanted(source, network, away, found)
    if not len(axis.time_h):
        found.end()
    archive = None if found.faults else _new(source, plan, axis, folder)
    seen = {name: Seen() for name in plan.turned}
    rows, lost = [int(k) for k in np.flatnonzero(~skip)], []
    for done, k in enumerate(rows):
        if progress is not None:
            progress("reading runs", done, len(rows))
        if not _take_run(source, plan, axis, k, archive, seen, found):
            lost.append(source.labels[k])
    for label in lost:
        problem = "holds no value at all: it is missing, and left out"
        found.warn(f"run {label}", float("nan"), problem, "repeat it, if the design had it")
    kept: list[int] = []
    if archive is not None:
        kept = _no_twins(archive, source.labels, list(archive.done()), found)
        _enough(archive, kept, found)
    check_changes(seen, network, axis.time_h[-1], found)
    found.end()
    assert archive is not None
    return archive, found, tuple(kept)


def _new(source: Source, plan: Wanted, axis: Axis, folder: str | Path) -> Archive:
    fields = any(kind != "scalar" for kind, _, _, _ in plan.turned.values())
    return Archive.create(
        folder,
        inputs=plan.inputs,
        time_h=axis.time_h,
        mesh=source.mesh if fields else Mesh.none(),
        seed=0,
        command=source.command or COMMAND,
        quantities=[Quantity(n, u, kind) for n, (kind, u, _, _) in plan.turned.items()],
    )


def _skipped(source: Source, leave_out: Sequence[str], found: Findings) -> Flags:
    """Runs that the user leaves out, (n,)."""
    for label in sorted(set(leave_out) - set(source.labels)):
        known = ", ".join(source.labels[:8])
        found.fault("leave_out", label, "is no run", f"use labels of the file: {known} …")
    gone = [label for label in source.labels if label in set(leave_out)]
    if gone:
        problem = f"{'is' if len(gone) == 1 else 'are'} left out, as asked"
        found.warn("runs", ", ".join(gone[:20]), problem, "nothing, if that is meant")
    numbers = [int(label) for label in source.labels if re.fullmatch(r"\d{1,9}", label)]
    if len(numbers) == len(source.labels) and 1 < len(numbers) <= 100_000:
        lost = sorted(set(range(min(numbers), max(numbers) + 1)) - set(numbers))
        if 0 < len(lost) <= len(numbers):
            shown = ", ".join(map(str, lost[:20])) + (" …" if len(lost) > 20 else "")
            problem = f"is missing between runs {min(numbers)} and {max(numbers)}"
            found.warn("run", shown, problem, "add it, if the design had it: its place is empty")
    return np.array([label in set(leave_out) for label in source.labels], dtype=bool)


def _take_run(
    source: Source,
    plan: Wanted,
    axis: Axis,
    k: int,
    archive: Archive | None,
    seen: dict[str, Seen],
    found: Findings,
) -> bool:
    """Read and check one run, and write it where it is sound; False: nothing is there."""
    label, values, faults = source.labels[k], {}, []
    if axis.own is not None and not np.any(np.isfinite(axis.own[k])):
        return False
    empty = bool(plan.turned)
    for name, (_, _, a, b) in plan.turned.items():
        raw = source.read(k, name)
        if axis.own is not None:
            raw = np.where(_before_end(axis.own[k], raw), raw, 0.0)
        bad = np.argwhere(~np.isfinite(raw))
        there = raw.size if axis.own is None else np.count_nonzero(_before_end(axis.own[k], raw))
        empty &= len(bad) == there
        if len(bad):
            faults.append(not_finite(f"run {label}: {name}", raw, bad, axis, k))
            continue
        if (large := too_large(f"run {label}: {name}", raw, a)) is not None:
            faults.append(large)
            empty = False
            continue
        brought, error = axis.bring(k, a * raw + b)
        seen[name].brought = max(seen[name].brought, 0.0 if np.isnan(error) else error)
        values[name] = brought
    if faults:
        found.faults += [] if empty else faults
        return not empty
    for name, own in values.items():
        seen[name].add(own, label)
    if archive is not None:
        names = [item.name for item in plan.inputs]
        inputs = dict(zip(names, map(float, plan.values[k]), strict=True))
        archive.write(k, Run(inputs, values))
    return True


def _before_end(own: Array, values: Array) -> Flags:
    there = np.isfinite(own).reshape(-1, *[1] * (values.ndim - 1))
    return np.broadcast_to(there, values.shape)


def _no_twins(
    archive: Archive, labels: Sequence[str], kept: list[int], found: Findings
) -> list[int]:
    """Runs without those whose inputs are another's; a fault where the results differ."""
    if len(kept) < 2:
        return kept
    width = np.array([i.high - i.low for i in archive.declaration.inputs])
    places = np.round(archive.inputs(kept) / width, 9)
    first: dict[tuple[float, ...], int] = {}
    single = []
    for k, place in zip(kept, map(tuple, places.tolist()), strict=True):
        if place not in first:
            first[place] = k
            single.append(k)
            continue
        one, other = archive.read(first[place]), archive.read(k)
        pair = f"runs {labels[first[place]]} and {labels[k]}"
        for name, values in one.values.items():
            apart = float(np.max(np.abs(values - other.values[name])))
            if apart > 1e-6 * max(float(np.max(np.abs(values))), 1e-300):
                problem = f"is by how much {name} differs at equal inputs: something else moves it"
                remedy = "give what differs as an input, or leave one of them out"
                found.fault(pair, apart, problem, remedy)
                break
        else:
            problem = "are the same run twice: the second is left out"
            found.warn(pair, labels[k], problem, "write each run once")
    return single


def _enough(archive: Archive, kept: Sequence[int], found: Findings) -> None:
    d = len(archive.declaration.inputs)
    need = MINIMUM_RUNS * (d + 1)
    if len(kept) >= ENOUGH * d and len(kept) >= need:
        return
    missed = ""
    if len(kept) > 1:
        shares = ", ".join(f"{n} by {100 * e:.2g} %" for n, e in nearest(archive, kept).items())
        missed = (
            f". Leaving each out and taking its nearest run instead misses {shares} of the range"
        )
    if len(kept) < need:
        problem = f"are too few for {d} input{'s' * (d != 1)}: {need} are needed{missed}"
        found.fault("runs", len(kept), problem, f"add {need - len(kept)} or more")
    else:
        problem = f"are few for {d} input{'s' * (d != 1)}; {ENOUGH * d} are usual{missed}"
        found.warn("runs", len(kept), problem, "look at the held-out errors")


def nearest(archive: Archive, kept: Sequence[int]) -> dict[str, float]:
    """Rms error of each quantity when a run's nearest other stands for it, as a share of its range.

    The poorest of surrogates: what a trained one has to beat, and all that three runs allow.
    """
    width = np.array([i.high - i.low for i in archive.declaration.inputs])
    z = archive.inputs(kept) / width
    apart = np.linalg.norm(z[:, None] - z[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    other = np.argmin(apart, axis=1)
    out = {}
    for q in archive.declaration.quantities:
        square, low, high = 0.0, np.inf, -np.inf
        for k, j in zip(kept, other, strict=True):
            one, two = (archive.stack(q.name, [i])[0].astype(float) for i in (k, kept[j]))
            square += float(np.mean((one - two) ** 2)) / len(kept)
            low, high = min(low, one.min()), max(high, one.max())
        out[q.name] = float(np.sqrt(square)) / max(high - low, np.finfo(float).tiny)
    return out
