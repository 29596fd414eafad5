"""Where the runs of an adaptive design come from, and whose posterior weighs them.

Three sources: the built-in finite elements of the rotor blade, a model that is served over
UM-Bridge (`service.sampling`), and a command of the user's. The command is called once a run, with
two file names behind its own words,

    COMMAND in.json out.json        {"inputs": {"roughness": 2.4, …}, "time_h": [0, 250, …]}

and writes ``{"drop": [0.0, 1.31, …]}`` to the second: each quantity of the network over the
instants (T,), a field (T, N) or vectors (T, N, 3); or the same arrays to ``out.npz`` beside it.
Exit status other than 0, no file, or numbers that do not fit are a run that failed, with what was
said.

An archive that is there is gone on with, if its inputs and quantities are those of the source.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive, Run
from core.builtin import plans, rotor_blade
from core.builtin.paper_network import rotor_blade_network
from core.builtin.plans import Plan
from core.builtin.rotor_blade import as_run, blade_digest, open_archive
from core.errors import BladetwinError, FaultsError, InputError, ModelError
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


def _present(folder: Path) -> Archive | None:
    return Archive.open(folder) if (folder / ARCHIVE).exists() else None


@dataclass(frozen=True)
class FiniteElements:
    """The rotor blade's own runs, in parallel processes."""

    mesh: str = "default"
    workers: int = 2

    def open(self, folder: Path, seed: int) -> Archive:
        archive = _present(folder)
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
        archive = _present(folder)
        if archive is None:
            return sampling.begin(self.served, self.network, folder, self.time_h, seed, command)
        _fits(archive, self.network)
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


@dataclass(frozen=True)
class Command:
    """Runs of a command of the user's, `workers` at once."""

    words: tuple[str, ...]
    network: Network
    time_h: tuple[float, ...] = ()
    nodes: int = 0
    workers: int = 1
    timeout: float = 3600.0

    @staticmethod
    def of(text: str, network: Network, **more: Any) -> Command:
        """From a command line; InputError where it has no words."""
        try:
            words = tuple(shlex.split(text))
        except ValueError as error:
            raise InputError("command", text, f"cannot be read: {error}", "mend quotes") from None
        if not words:
            raise InputError("command", text, "has no words", "give a program")
        return Command(words, network, **more)

    def open(self, folder: Path, seed: int) -> Archive:
        archive = _present(folder)
        if archive is None:
            told = f"bladetwin model refine, {self.words[0]}"
            return sampling.archive_of(self.network, folder, self.time_h, self.nodes, seed, told)
        _fits(archive, self.network)
        return archive

    def run(self, archive: Archive, points: Mapping[int, Array], done: Done) -> dict[int, str]:
        failed: dict[int, str] = {}
        with ThreadPoolExecutor(self.workers) as pool:
            waiting = {pool.submit(self._one, archive, k, x): k for k, x in points.items()}
            for count, one in enumerate(as_completed(waiting), 1):
                try:
                    one.result()
                except BladetwinError as error:
                    failed[waiting[one]] = str(error)
                done(count)
        return failed

    def _one(self, archive: Archive, index: int, x: Array) -> None:
        declared = archive.declaration
        inputs = dict(zip((i.name for i in declared.inputs), map(float, x), strict=True))
        with tempfile.TemporaryDirectory(prefix="bladetwin-run-") as folder:
            asked, answer = Path(folder) / "in.json", Path(folder) / "out.json"
            asked.write_text(json.dumps({"inputs": inputs, "time_h": declared.time_h}))
            self._call([*self.words, str(asked), str(answer)])
            found = _answer(answer)
        values = {}
        for q in declared.quantities:
            name = sampling.told_name(q.name, self.network)
            if name not in found:
                raise ModelError(f"the command wrote no {name}: it wrote {sorted(found)}")
            values[q.name] = found[name]
        archive.write(index, Run(inputs, values))

    def _call(self, words: Sequence[str]) -> None:
        try:
            done = subprocess.run(
                words, capture_output=True, timeout=self.timeout, check=False, text=True,
                errors="replace", stdin=subprocess.DEVNULL,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise ModelError(f"{self.words[0]} took longer than {self.timeout:g} s") from None
        except OSError as error:
            raise ModelError(f"{self.words[0]} cannot be started: {error.strerror}") from None
        if done.returncode:
            said = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()[-1]
            raise ModelError(f"{self.words[0]} ended with {done.returncode}: {said[:300]}")


def _answer(file: Path) -> dict[str, Array]:
    """The arrays by name that a command wrote."""
    packed = file.with_suffix(".npz")
    try:
        if packed.exists():
            with np.load(packed, allow_pickle=False) as data:
                return {name: np.asarray(data[name], dtype=float) for name in data.files}
        told = json.loads(file.read_text())
        return {name: np.asarray(value, dtype=float) for name, value in told.items()}
    except FileNotFoundError:
        raise ModelError("the command wrote neither out.json nor out.npz") from None
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise ModelError(f"what the command wrote cannot be read: {error}") from None


def _fits(archive: Archive, network: Network) -> None:
    """Refuse an archive of other inputs or quantities than the network's."""
    declared = archive.declaration
    wanted = {"inputs": [p.name for p in sampling.inputs_of(network)]}
    wanted["quantities"] = [q.name for q in sampling.quantities_of(network)]
    found = {"inputs": [i.name for i in declared.inputs]}
    found["quantities"] = [q.name for q in declared.quantities]
    for what, names in wanted.items():
        if found[what] != names:
            problem = f"of the runs in {archive.path} are not the network's ({', '.join(names)})"
            remedy = "name a new folder, or the network of these runs"
            raise InputError(what, ", ".join(found[what]), problem, remedy)


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
