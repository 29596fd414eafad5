"""Where the runs of an adaptive design come from, and whose posterior weighs them.

Three sources: the built-in finite elements of the rotor blade, a model that is served over
UM-Bridge (`service.sampling`), and a command of the user's (`service.command_runs`).

An archive that is there is gone on with, if its inputs, quantities and instants are those of the
source.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive
from core.builtin import plans, rotor_blade
from core.builtin.paper_network import rotor_blade_network
from core.builtin.plans import Plan
from core.builtin.rotor_blade import as_run, blade_digest, open_archive
from core.errors import FaultsError, InputError, ModelError
from core.network import Network
from core.observation import Inspection, faults
from service import sampling

Array = NDArray[np.float64]
Done = Callable[[int], None]
ARCHIVE = "archive.json"


class Source(Protocol):
    """What makes runs."""

    def open(self, folder: Path, seed: int) -> Archive:
        """The archive in a folder, begun where there is none."""
        ...

    def run(self, archive: Archive, points: Mapping[int, Array], done: Done) -> dict[int, str]:
        """Write the runs at points, by index; the reasons of those that failed."""
        ...


def present(folder: Path) -> Archive | None:
    """The archive in a folder; None: there is none."""
    return Archive.open(folder) if (folder / ARCHIVE).exists() else None


@dataclass(frozen=True)
class FiniteElements:
    """The rotor blade's own runs, in parallel processes."""

    mesh: str = "default"
    workers: int = 2

    def open(self, folder: Path, seed: int) -> Archive:
        archive = present(folder)
        if archive is None:
            return open_archive(folder, self.mesh, seed)
        if archive.declaration.code != blade_digest():
            raise ModelError(
                f"{folder} holds runs of other finite elements than this release's: "
                "name a new folder, or give what made them (--served, --command)"
            )
        return archive

    def run(self, archive: Archive, points: Mapping[int, Array], done: Done) -> dict[int, str]:
        from core.blade import run_campaign

        declared, keys = archive.declaration, list(points)
        plan = plan_of(archive)
        names = [one.name for one in declared.inputs]
        inputs = [dict(zip(names, map(float, points[k]), strict=True)) for k in keys]
        try:
            campaign = run_campaign(
                inputs,
                lambda i, run: archive.write(keys[i], as_run(run)),
                mesh=declared.mesh,
                processes=self.workers,
                progress=lambda finished, total, left: done(finished),
                bounds={one.name: (one.low, one.high) for one in declared.inputs},
                time_h=np.array(declared.time_h),
                tolerance=plan.tolerance,
            )
        except ModelError as error:
            return dict.fromkeys(keys, str(error))
        return {keys[one.index]: one.reason for one in campaign.failures}


def plan_of(archive: Archive) -> Plan:
    """The built-in plan that an archive's runs follow."""
    command = archive.declaration.command
    known = plans.PLANS.values()
    return next((p for p in known if p.command == command), plans.STANDARD)


def network_of(archive: Archive) -> Network:
    """The network of the built-in plan that an archive's runs follow."""
    wide = plan_of(archive) is plans.WIDE
    return rotor_blade.wide_network() if wide else rotor_blade_network()


@dataclass(frozen=True)
class ServedModel:
    """Runs of a model that is served over UM-Bridge, one at a time."""

    served: sampling.Served
    network: Network
    time_h: tuple[float, ...] = ()

    def open(self, folder: Path, seed: int) -> Archive:
        command = f"bladetwin model refine, UM-Bridge model {self.served.name}"
        archive = present(folder)
        if archive is None:
            return sampling.begin(self.served, self.network, folder, self.time_h, seed, command)
        fits(archive, self.network, self.time_h)
        return archive

    def run(self, archive: Archive, points: Mapping[int, Array], done: Done) -> dict[int, str]:
        failed = {}
        for count, (index, x) in enumerate(points.items(), 1):
            try:
                sampling.run_one(self.served, archive, index, x)
            except (ModelError, InputError) as error:
                failed[index] = str(error)
            done(count)
        return failed


def fits(archive: Archive, network: Network, time_h: Sequence[float] = ()) -> None:
    """Refuse an archive of other inputs, bounds, quantities or units than the network's, and of
    other instants than `time_h`, where these are given; and a network that no runs could serve."""
    declared, parameters = archive.declaration, sampling.inputs_of(network)
    wanted = {"inputs": [p.name for p in parameters]}
    wanted["quantities"] = [f"{q.name} [{q.unit}]" for q in sampling.quantities_of(network)]
    found = {"inputs": [i.name for i in declared.inputs]}
    found["quantities"] = [f"{q.name} [{q.unit}]" for q in declared.quantities]
    for what, names in wanted.items():
        if found[what] != names:
            problem = f"of the runs in {archive.path} are not the network's ({', '.join(names)})"
            remedy = "name a new folder, or the network of these runs"
            raise InputError(what, ", ".join(found[what]), problem, remedy)
    for p, own in zip(parameters, declared.inputs, strict=True):
        slack = 1e-9 * (own.high - own.low)
        if p.prior.low < own.low - slack or p.prior.high > own.high + slack:
            problem = f"leaves the bounds of the runs in {archive.path}, {own.low:g} … {own.high:g}"
            shown = f"{p.prior.low:g} … {p.prior.high:g}"
            remedy = "narrow it, or name a new folder"
            raise InputError(f"prior of {p.name}", shown, problem, remedy)
    if len(time_h) and tuple(time_h) != declared.time_h:
        problem = f"are not those of the runs in {archive.path}"
        shown = ", ".join(f"{t:g}" for t in time_h)
        there = ",".join(f"{t:g}" for t in declared.time_h)
        remedy = f"leave them out, give {there}, or name a new folder"
        raise InputError("times", shown, problem, remedy)
    sampling.check_declared(network, declared.time_h[-1])


@dataclass(frozen=True, slots=True)
class _Range:
    horizon_h: float
    node_count: int
    nodes: Mapping[str, int]


def readings_of(body: bytes, network: Network, archive: Archive) -> list[Inspection]:
    """Readings of a CSV, as `GET …/inspections?format=csv` writes it.

    Raises FaultsError with every fault.
    """
    from service.api.problems import RequestError
    from service.api.reading_bodies import read_inspections

    try:
        items = read_inspections(body, "text/csv")
    except RequestError as error:
        listed = [
            InputError(f["field"], f["value"], f["problem"], f["remedy"]) for f in error.faults
        ]
        whole = InputError("readings", "…", error.detail, "give CSV as it is posted")
        raise FaultsError(listed or [whole]) from None
    declared = archive.declaration
    covers = _Range(declared.time_h[-1], declared.nodes, declared.named)
    found = []
    for item in items:
        for one in faults(item.reading, network, covers, item.where):
            named = one.what if one.what.startswith(item.where) else f"{item.where}{one.what}"
            found.append(type(one)(f"readings, {named}", one.value, one.problem, one.remedy))
    if found:
        raise FaultsError(found)
    return [item.reading for item in items]
