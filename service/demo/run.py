"""Start a service, stream the paper's inspection plan into it, read the twin back, look.

Everything goes through the front door: a real `bladetwin serve` on a real database, the HTTP
client that users import, nothing else. The readings are finite-element truth plus noise
(`core.builtin.inspection_plan`); what is compared at the end was never posted.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from core.builtin import inspection_plan, worn_plan
from core.builtin.inspection_plan import Plan
from core.errors import BladetwinError
from service.client import Client
from service.demo.loop import closed
from service.demo.result import Result, collect
from service.demo.stream import steps
from service.free_port import free_port
from service.progress import bar
from service.worker.supervise import same_code

ROTOR = "demo"
console = Console(stderr=True)


@dataclass(frozen=True)
class Running:
    """A service that this process started."""

    url: str
    process: subprocess.Popen[bytes]
    log: Path


@contextmanager
def service(folder: Path, port: int | None = None) -> Iterator[Running]:
    """`bladetwin serve` on a new SQLite database in `folder`; ends with the block."""
    chosen = port or free_port()
    log = folder / "serve.log"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("BLADETWIN_")}
    environment["BLADETWIN_DATABASE_URL"] = f"sqlite:///{folder / 'bladetwin.db'}"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "service.cli", "serve", "--port", str(chosen)],
            env=same_code(environment),
            stdout=out,
            stderr=out,
        )
        running = Running(f"http://127.0.0.1:{chosen}", process, log)
        before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the block ends
        try:
            yield running
        finally:
            signal.signal(signal.SIGTERM, before)
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
                try:
                    process.wait(20)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()


def elongations(plan: Plan) -> Plan:
    """The plan without its scans and CEEQ."""
    kept = tuple(body for body in plan.inspections if body["quantity"] == "elongation")
    return replace(plan, inspections=kept)


def post_all(
    client: Client,
    plan: Plan,
    particles: int,
    seed: int,
    quiet: bool = False,
    model: str = "rotor-blade",
) -> int:
    """Create the rotor and stream every step; the last sequence number.

    A blade tells its coating lot, as a rotor's papers do, whether or not anything is wrong with it.
    """
    known = inspection_plan.blades()
    first = [b for b in known if not b.endswith("-2")]
    lot = worn_plan.coating_lot
    blades = [{"id": b, "slot": b[1:], "coating_lot": lot(b)} for b in first]
    client.create_rotor(ROTOR, blades=blades, particles=particles, seed=seed, model=model)
    todo = list(steps(plan, seed))
    last = 0
    sent = 0
    with bar("posting inspections", sum(len(s.inspections) for s in todo), quiet=quiet) as shown:
        for step in todo:
            if step.inspections:
                last = client.post_inspections(ROTOR, step.inspections)
                sent += len(step.inspections)
                shown(sent)
            if step.retire and step.install:
                client.retire_blade(ROTOR, step.retire)
                slot = step.retire[1:]
                last = client.add_blade(
                    ROTOR, {"id": step.install, "slot": slot, "coating_lot": lot(step.install)}
                )
            if step.through:
                client.wait_for(ROTOR, last, 900)  # the outage ends when its readings count
    return last


def wait_applied(
    client: Client, seq: int, patience_s: float, quiet: bool = False
) -> dict[str, Any]:
    """Until every event counts and the posterior is sealed; shows how far it is."""
    with bar("updating the posterior", seq, quiet=quiet) as shown:
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            rotor = client.rotor(ROTOR)
            if rotor["status"] == "blocked":
                raise BladetwinError(f"rotor {ROTOR} is blocked: {rotor['last_error']}")
            shown(rotor["applied_seq"])
            posterior = rotor["posterior"]
            if rotor["applied_seq"] >= seq and posterior is not None and posterior["sealed"]:
                return {**rotor}
            time.sleep(0.1)
    raise BladetwinError(f"rotor {ROTOR}: not sealed within {patience_s:g} s")


def run(
    *,
    keep: bool = False,
    port: int | None = None,
    particles: int = 10_000,
    seed: int = 0,
    out: Path = Path("bladetwin-demo"),
    as_json: bool = False,
    effects: bool = False,
) -> Result:
    """The main job; writes ``result.json`` and ``demo.png`` into `out` and prints a table.

    effects  the readings carry effects that nobody declared, for the service to find; elongations
             alone then, as with the noises of three quantities and two effects each calibration of
             a diagnosis has seven shared parameters and takes minutes
    """
    from service.demo.loop_picture import draw_loop
    from service.demo.picture import draw, print_table

    out.mkdir(parents=True, exist_ok=True)
    plan = elongations(worn_plan.load()) if effects else inspection_plan.load()
    model = "rotor-blade-wide" if effects else "rotor-blade"
    begun = time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="bladetwin-") as folder,
        service(Path(folder), port) as running,
    ):
        say = console.print
        say(f"service at {running.url}, database in {folder}")
        with Client(running.url) as client:
            try:
                client.ready(180)
                client.register(model)
                ready = time.monotonic()
                last = post_all(client, plan, particles, seed, as_json, model)
                posted = time.monotonic()
                say(f"{len(plan.inspections)} inspections acknowledged")
                rotor = wait_applied(client, last, 600, quiet=as_json)
                sealed = time.monotonic()
                result = collect(client, plan, rotor, ROTOR, quiet=as_json)
                done = time.monotonic()
                if effects:
                    result = closed(client, plan, result, ROTOR, 900, quiet=as_json)
            except (BladetwinError, TimeoutError):
                say(running.log.read_text()[-3000:], style="dim")
                raise
            result.seconds.update(
                start=ready - begun,
                posting=posted - ready,
                updating=sealed - posted,
                reading=done - sealed,
                twin=done - ready,
                loop=time.monotonic() - done,
            )
            (out / "result.json").write_text(json.dumps(result.to_json(), indent=1))
            draw(result, plan, out / "demo.png")
            if result.loop is not None and result.loop["adopted"]:
                draw_loop(result.loop, out / "loop.png")
            if as_json:
                print(json.dumps(result.to_json()))
            else:
                print_table(result, out)
            if keep:
                say(f"the API stays up at {running.url} (rotor {ROTOR!r}); Ctrl-C ends it")
                try:
                    running.process.wait()
                except KeyboardInterrupt:
                    say("stopping")
    return result
