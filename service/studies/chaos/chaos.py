"""The same traffic twice: once with kills all the while, once undisturbed.

Kills come after random numbers of acknowledged readings, so that they lie over the whole of the
posting; each hits the API with probability `share_of_api`, else one of the workers. The sealed
states of both runs have to have the same digests, and the tables of the disturbed one have to hold
what its clients were told (`check`).
"""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from sqlalchemy import select

from core.errors import BladetwinError
from service.client import Client
from service.ports import Json
from service.settings import Settings
from service.store import tables as t
from service.store.engine import open_engine
from service.store.unit_of_work import SqlStore
from service.studies.chaos.check import Again, Findings, by_physics, by_twin, check
from service.studies.chaos.clients import Crowd, Ledger, create
from service.studies.chaos.processes import READY_S, Processes, Start, as_shipped, forked
from service.studies.chaos.traffic import Traffic
from service.studies.chaos.twin import main

KEEP_ALL = 1_000_000
AT_WORK_S = 20.0
Progress = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """A run: its traffic, how often something is killed, who posts, and which science answers.

    pause_s   a client rests so long after each batch; an update of the blade physics takes longer
              than a post, and would find all readings there
    """

    traffic: Traffic
    kills: int
    clients: int
    seed: int
    particles: int = 64
    science: str = "fake"
    lease_s: float = 2.0
    settle_s: float = 900.0
    share_of_api: float = 0.25
    pause_s: float = 0.0

    def settings(self, database_url: str) -> Settings:
        return Settings.load(
            {},
            database_url=database_url,
            science="fake" if self.science == "fake" else "core",
            migrate="always",
            lease_s=self.lease_s,
            seal_after_s=1.0,
            keep_versions=KEEP_ALL,
            keep_events=KEEP_ALL,
            log_level="error",
        )

    def again(self) -> Again:
        """How a version is made once more, to be held against the stored one."""
        if self.science == "fake":
            return by_twin
        from service.science import CoreScience

        return by_physics(CoreScience())

    @property
    def start(self) -> Start:
        return forked(main) if self.science == "fake" else as_shipped


def disturbed(
    plan: Plan,
    database_url: str,
    progress: Progress,
    start: Start | None = None,
    disturb: Callable[[Processes], str] | None = None,
) -> tuple[Findings, Ledger, Json]:
    """Post the traffic while processes are killed; what the tables hold, what clients saw.

    disturb   done instead of a kill; what it says is counted
    """
    chosen = random.Random(plan.seed)
    ledger, killed = Ledger(), Counter[str]()
    settings = plan.settings(database_url)
    when = sorted(chosen.sample(range(1, plan.traffic.readings * 97 // 100), plan.kills))
    begun = time.monotonic()
    with Processes(settings, start or plan.start) as running:
        create(running.url, plan.traffic, ledger, plan.particles, plan.seed)
        ledger.acknowledged.clear()
        if plan.science == "core":
            settle(running.url, ledger, plan.settle_s, plan.traffic.rotors)  # workers are warm
        batches = list(plan.traffic.batches)
        crowd = Crowd(running.url, batches, plan.clients, ledger, plan.pause_s)
        crowd.start()
        try:
            while crowd.busy or when:  # a machine that is busy may have posted before
                progress(ledger.readings)
                if when and (ledger.readings >= when[0] or not crowd.busy):
                    time.sleep(chosen.uniform(0.0, 0.05))
                    if disturb is None:
                        killed[_kill(plan, running, chosen, database_url)] += 1
                    else:
                        killed[disturb(running)] += 1
                    when.pop(0)
                time.sleep(0.002)
            progress(ledger.readings)
        finally:
            crowd.stop()
        posted = time.monotonic()
        settle(running.url, ledger, plan.settle_s)
    settled = time.monotonic()
    found = looked_at(database_url, ledger, plan.again())
    facts: Json = {
        "kills": dict(sorted(killed.items())),
        "kills_in_all": sum(killed.values()),
        "posting_s": round(posted - begun, 1),
        "settling_s": round(settled - posted, 1),
        "answers": dict(sorted(ledger.answers.items())),
        "acknowledged_readings": ledger.readings,
        "breaches": ledger.breaches[:20],
    }
    return found, ledger, facts


def _kill(plan: Plan, running: Processes, chosen: random.Random, database_url: str) -> str:
    """Kill one; with the blade physics a worker that holds a rotor, if there is one soon: most of
    its time it starts, and a kill would find it idle."""
    if plan.science == "fake" or chosen.random() < plan.share_of_api:
        return running.kill(chosen, plan.share_of_api if plan.science == "fake" else 1.0)
    store = SqlStore(open_engine(database_url))
    try:
        end = time.monotonic() + AT_WORK_S
        while time.monotonic() < end:
            with store.read() as tx:
                held = select(t.cursor.c.owner).where(t.cursor.c.owner.is_not(None))
                owners = tx.connection.execute(held).scalars().all()
            time.sleep(chosen.uniform(0.0, 0.1))
            if owners and (kind := running.kill_owner(chosen.choice(owners))) is not None:
                return f"{kind}, at work"
        return running.kill(chosen, 0.0)
    finally:
        store.close()


def undisturbed(plan: Plan, database_url: str) -> dict[str, str]:
    """The digests of the sealed states where one client posts the same and nothing is killed."""
    ledger = Ledger()
    settings = plan.settings(database_url)
    with Processes(settings, plan.start) as running:
        create(running.url, plan.traffic, ledger, plan.particles, plan.seed)
        ledger.acknowledged.clear()
        calm = [replace(batch, twice=False) for batch in plan.traffic.batches]
        crowd = Crowd(running.url, calm, 1, ledger)
        crowd.start()
        while crowd.busy:
            time.sleep(0.05)
        settle(running.url, ledger, plan.settle_s)
    if ledger.breaches:
        raise BladetwinError(f"undisturbed, and yet: {'; '.join(ledger.breaches[:5])}")
    return looked_at(database_url, ledger, None).digests


def settle(
    url: str, ledger: Ledger, patience_s: float, rotors: Sequence[str] | None = None
) -> None:
    """Wait until every rotor is applied and sealed; a blocked one is told and freed.

    rotors   None: those with an entry that was acknowledged
    """
    end = time.monotonic() + patience_s
    with Client(url) as client:
        client.ready(READY_S)
        names = sorted(rotors or {rotor for rotor, _ in ledger.acknowledged})
        while names and time.monotonic() < end:
            told = client.rotor(names[0])
            if told["status"] == "blocked":
                ledger.breach(f"rotor {names[0]} was blocked: {told['last_error']}")
                client.retry(names[0])
            posterior = told["posterior"]
            if told["status"] == "current" and posterior and posterior["sealed"]:
                names.pop(0)
            else:
                time.sleep(0.1)


def looked_at(database_url: str, ledger: Ledger, again: Again | None) -> Findings:
    store = SqlStore(open_engine(database_url))
    try:
        return check(store, ledger.acknowledged, again=again)
    finally:
        store.close()


def verdict(found: Findings, ledger: Ledger, calm: dict[str, str]) -> Json:
    """The claim, number by number."""
    other = sorted(n for n in calm.keys() | found.digests if calm.get(n) != found.digests.get(n))
    sound = not (found.faults or ledger.breaches or other)
    return {
        **found.to_json(),
        "sealed_states_compared": len(calm),
        "sealed_states_that_differ": other,
        "passed": sound,
    }
