"""A user's runs become an archive, or every fault of them is told.

All runs are read, one at a time, before anything is refused. What happens to what:

==============================  ==================================================================
a run that is missing           left out and named, where its label lacks in a row of numbers or
                                nothing but NaN is there
NaN at a node or instant        refused: run, quantity, hour, node; `leave_out` takes it out
a unit that is none             refused; one that differs: converted and told, or refused where it
                                measures something else
numbers of another magnitude    a warning with the factor that would fit (mm given as m)
unequal instants                a common axis and a warning (`core.archive.axis`)
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
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.archive.axis import Axis, common
from core.archive.check import Wanted, wanted
from core.archive.declaration import Mesh, Quantity, Run
from core.archive.faults import Findings
from core.archive.source import Source
from core.archive.store import Archive
from core.errors import InputError
from core.network import Network

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Progress = Callable[[str, int, int], None]
MINIMUM_RUNS = 3  # times (number of inputs + 1)
ENOUGH = 10  # runs for each input (J. L. Loeppky, J. Sacks, W. J. Welch, Technometrics 51 (2009))
CONSTANT = 1e-9  # relative
FACTORS = (1e3, 1e-3, 1e6, 1e-6, 1e2, 1e-2)
COMMAND = "runs of a user's own"


@dataclass(slots=True)
class Seen:
    """What all runs together show of a quantity: sums over runs of each value, and extremes."""

    count: int = 0
    mean: Array | None = None
    square: Array | None = None
    low: float = np.inf
    high: float = -np.inf
    brought: float = 0.0

    def add(self, values: Array) -> None:
        """One more run (Welford's recurrence)."""
        self.count += 1
        if self.mean is None or self.square is None:
            self.mean, self.square = values.copy(), np.zeros_like(values)
        else:
            step = values - self.mean
            self.mean += step / self.count
            self.square += step * (values - self.mean)
        self.low, self.high = min(self.low, values.min()), max(self.high, values.max())

    @property
    def between(self) -> float:
        """The largest standard deviation between runs, over instants and nodes."""
        assert self.square is not None
        return float(np.sqrt(self.square.max() / max(self.count - 1, 1)))


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
    axis = common(source.time_h, source.labels, skip.tolist(), found)
    plan = wanted(source, network, skip, found)
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
    _changes(seen, network, found)
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
        found.warn("runs", ", ".join(gone[:20]), problem, "nothing")
    numbers = [int(label) for label in source.labels if re.fullmatch(r"\d{1,9}", label)]
    if len(numbers) == len(source.labels) and 1 < len(numbers) <= 100_000:
        lost = sorted(set(range(min(numbers), max(numbers) + 1)) - set(numbers))
        if 0 < len(lost) <= len(numbers):
            shown = ", ".join(map(str, lost[:20])) + (" …" if len(lost) > 20 else "")
            problem = f"is missing between runs {min(numbers)} and {max(numbers)}"
            found.warn("run", shown, problem, "add it, if the design had it: its place is empty")
    return np.array([label in set(leave_out) for label in source.labels])


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
            faults.append(_not_finite(f"run {label}: {name}", raw, bad, axis, k))
            continue
        brought, error = axis.bring(k, a * raw + b)
        seen[name].brought = max(seen[name].brought, 0.0 if np.isnan(error) else error)
        values[name] = brought
    if faults:
        found.faults += [] if empty else faults
        return not empty
    for name, own in values.items():
        seen[name].add(own)
    if archive is not None:
        names = [item.name for item in plan.inputs]
        inputs = dict(zip(names, map(float, plan.values[k]), strict=True))
        archive.write(k, Run(inputs, values))
    return True


def _before_end(own: Array, values: Array) -> Flags:
    there = np.isfinite(own).reshape(-1, *[1] * (values.ndim - 1))
    return np.broadcast_to(there, values.shape)


def _not_finite(what: str, raw: Array, bad: NDArray[np.intp], axis: Axis, k: int) -> InputError:
    """The first value that is no number: its hour, its node, and how many more there are."""
    first = [int(one) for one in bad[0]]
    hours = axis.time_h if axis.own is None else axis.own[k]
    place = f"at {hours[first[0]]:g} h"
    if len(first) > 1:
        nodes = sorted({int(one[1]) for one in bad})
        shown = ", ".join(map(str, nodes[:8])) + (" …" if len(nodes) > 8 else "")
        place += f", node {first[1]}"
        if len(nodes) > 1:
            place += f" (nodes {shown})"
    more = f"; {len(bad)} values of it are none" if len(bad) > 1 else ""
    value = float(raw[tuple(first)])
    remedy = "repeat the run, or leave it out (leave_out)"
    return InputError(what, value, f"is no number {place}{more}", remedy)


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


def _changes(seen: dict[str, Seen], network: Network, found: Findings) -> None:
    """Quantities that never change, that leave what readings may be, or drown in their noise."""
    by_name = {q.name: q for q in network.quantities}
    if "displacement" in seen and "deformation" in by_name:
        by_name["displacement"] = by_name["deformation"]
    for name, one in seen.items():
        if not one.count:
            continue
        largest = max(abs(one.low), abs(one.high))
        what = f"quantity {name}"
        if one.between <= CONSTANT * max(largest, np.finfo(float).tiny):
            problem = "is the same in every run: no input moves it, and nothing is learnt"
            remedy = "check what the runs write, or take it out of the network"
            found.fault(what, largest, problem, remedy)
            continue
        q = by_name.get(name)
        if q is None:
            continue
        if one.brought > 0.25 * q.sigma_obs.low:
            problem = "is what interpolating in time may miss, against the least noise "
            problem += f"{q.sigma_obs.low:g} {q.unit}"
            found.warn(what, one.brought, problem, "write all runs at the same instants")
        outside = one.high > q.high or one.low < q.low
        buried = one.between < 0.1 * q.sigma_obs.low
        if not outside and not buried:
            continue
        fits = [
            f
            for f in FACTORS
            if f * one.high <= q.high and f * one.low >= q.low and f * one.between > q.sigma_obs.low
        ]
        shown = f"{one.low:.4g} … {one.high:.4g} {q.unit}"
        problem = (
            f"leaves what readings may be, {q.low:g} … {q.high:g}"
            if outside
            else f"differs between runs by {one.between:.3g} at most, a tenth of the least noise "
            f"({q.sigma_obs.low:g}) or less: readings tell nothing"
        )
        remedy = "check the unit"
        if fits:
            remedy += f": times {fits[0]:g} it would fit, as if the runs were written in another"
        found.warn(what, shown, problem, remedy)
