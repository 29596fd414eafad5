"""What an update costs in a worker, without HTTP: outages sealed, and single readings.

    python tests/benchmarks/bench_update.py [READINGS] [PARTICLES]

On a new SQLite database a rotor of 100 blades; the elongations of one, two and three outages of the
inspection plan are sealed from nothing, each in a workspace of its own (the shared nodes placed
anew, then the draws). Then, after a first outage, READINGS readings of the second and third one by
one: from the claim to the committed provisional state, and from there to the sealed one. Then the
paper's whole plan, 306 readings of three kinds and four shared parameters, offline (all at once)
and online (each outage into a provisional state, then sealed). Wall and processor time.
"""

from __future__ import annotations

import sys
import tempfile
import time
from typing import Any

import service.one_thread  # noqa: F401  before numpy, as every command does

# isort: split
import numpy as np

from core.builtin import inspection_plan
from core.calibration.online import RotorSpec, Workspace, begun, update
from core.model import rotor_blade
from core.observation import Inspection
from core.validation.paper import readings_of
from service.bootstrap import make_science, make_store, make_worker, prepare
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.settings import Settings

NAMES = [b for b in inspection_plan.blades() if not b.endswith("-2")]


def elongations(outages: int) -> list[Inspection]:
    """Readings of the plan's first outages, in its order."""
    kept = {f"outage-{k + 1}" for k in range(outages)}
    return [
        inspection(body)
        for body in inspection_plan.load().inspections
        if body["quantity"] == "elongation" and body["campaign"] in kept and body["blade"] in NAMES
    ]


def inspection(body: dict[str, Any]) -> Inspection:
    at = (body["id"], body["blade"], body["quantity"], body["time_h"])
    return Inspection(*at, np.array([body["value"]]), campaign=body["campaign"])


def outages(particles: int) -> None:
    """Nodes placed and draws made, from nothing."""
    model = rotor_blade()
    begun(model, RotorSpec("warm", tuple(NAMES[:2]), 1000, 0), elongations(1)[:2]).sealed()
    for count in (1, 2, 3):
        readings = elongations(count)
        spec = RotorSpec("r", tuple(sorted({r.blade for r in readings})), particles, 0)
        start, used = time.perf_counter(), time.process_time()
        step = begun(model, spec, readings, workspace=Workspace())
        share = step.weighed.ess_ratio
        placed = time.perf_counter()
        step.sealed()
        end = time.perf_counter()
        print(
            f"{count} outage(s), {len(readings)} readings: placed {placed - start:.2f} s, drawn "
            f"{end - placed:.2f} s, processor {time.process_time() - used:.1f} s, effective "
            f"{100 * share:.0f} % of the nodes"
        )


def whole_plan(particles: int) -> None:
    """Offline and online, from nothing; the online run ends in the offline state."""
    model, names = rotor_blade(), tuple(inspection_plan.blades())
    readings = readings_of(inspection_plan.load(), names)
    spec = RotorSpec("r", names, particles, 0)
    start, used = time.perf_counter(), time.process_time()
    whole = update(model, spec, readings, workspace=Workspace())
    told = f"{len(readings)} readings at once: {time.perf_counter() - start:.2f} s, processor "
    print(f"{told}{time.process_time() - used:.1f} s")
    state, work = None, Workspace()
    start, used = time.perf_counter(), time.process_time()
    for last in sorted({str(r.campaign) for r in readings}):
        known = [r for r in readings if str(r.campaign) <= last]
        for quick in (True, False):
            state = update(model, spec, known, state, quick=quick, workspace=work)
    told = f"outage by outage, provisional and sealed: {time.perf_counter() - start:.2f} s"
    print(f"{told}, processor {time.process_time() - used:.1f} s")
    assert state is not None
    assert state.digest == whole.digest


def single(readings: int, particles: int) -> None:
    """One reading after the other into provisional states."""
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings.load({}, database_url=f"sqlite:///{folder}/b.db", seal_after_s=0.0)
        store = make_store(settings)
        prepare(store, settings)
        science = make_science(settings, store)
        register_builtins(store, science)
        create_rotor(store, "r", "rotor-blade", [BladeRecord(n) for n in NAMES], particles, 7)
        first = elongations(1)
        post_inspections(store, "r", [Item("", one) for one in first])
        worker = make_worker(store, science, settings)
        worker.drain()
        commit, ends = worker.updater.commit, list[float]()

        def committed(*what: Any) -> int:
            version = commit(*what)
            ends.append(time.perf_counter())
            return version

        worker.updater.commit = committed  # type: ignore[method-assign]
        wall, used, sealed = list[float](), list[float](), list[float]()
        moved, placement = 0, ""
        for one in elongations(3)[len(first) :][:readings]:
            post_inspections(store, "r", [Item("", one)])
            start, before = time.perf_counter(), time.process_time()
            worker.updater.run_once()  # applies; what comes after it seals
            wall.append(time.perf_counter() - start)
            used.append(time.process_time() - before)
            with store.read() as tx:
                version = tx.records.rotor("r").version
                assert not tx.states.get("r", version).sealed
            start = time.perf_counter()
            worker.drain()
            sealed.append(ends[-1] - start)
            with store.read() as tx:
                state = tx.states.get("r", tx.records.rotor("r").version)
            assert state.sealed
            moved += state.meta["placement"] != placement
            placement = state.meta["placement"]
        store.close()
    told = {"claim to commit, wall": wall, "claim to commit, processor": used, "sealed": sealed}
    for name, values in told.items():
        ms = 1e3 * np.array(values)
        print(
            f"a reading, {name}: median {np.median(ms):.0f}, 95th percentile "
            f"{np.percentile(ms, 95):.0f}, max {ms.max():.0f} ms ({len(ms)} readings)"
        )
    print(f"nodes placed anew for {moved} of {readings} readings")


if __name__ == "__main__":
    words = sys.argv[1:] + ["40", "10000"][len(sys.argv) - 1 :]
    outages(int(words[1]))
    whole_plan(int(words[1]))
    single(int(words[0]), int(words[1]))
