"""A database with rotors on which faults are tried, one rotor a trial.

Every fault ends alike: the fault is over, an intact worker applies and seals what is there, and the
tables are held against what was acknowledged (`check`). What happened on the way is the outcome of
the trial, in words.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from sqlalchemy import select, text

from core.errors import BladetwinError
from core.observation import Inspection
from service.bootstrap import make_worker, prepare
from service.fake import FakeScience
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.settings import Settings
from service.store import tables as t
from service.store.engine import open_engine, transaction
from service.store.unit_of_work import SqlStore
from service.studies.chaos.check import Findings, check
from service.studies.chaos.twin import Descent
from service.worker.loop import Worker

LEASE_S = 0.4
MOST_S = 60.0
BLADES = ("B1", "B2", "B3")


@dataclass
class Bench:
    """One database, and what was acknowledged on it."""

    url: str
    seed: int
    acknowledged: dict[tuple[str, str], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.settings = Settings.load(
            {},
            database_url=self.url,
            science="fake",
            migrate="always",
            lease_s=LEASE_S,
            seal_after_s=0.0,
            retry_base_s=0.0,
            keep_versions=1_000_000,
            keep_events=1_000_000,
            log_level="error",
        )
        self.chosen = random.Random(self.seed)
        self.store = self.open()
        prepare(self.store, self.settings)
        register_builtins(self.store, FakeScience())
        self.keeper = self.worker("keeper")

    @property
    def sqlite(self) -> bool:
        return self.url.startswith("sqlite")

    def open(self) -> SqlStore:
        return SqlStore(open_engine(self.url))

    def worker(self, owner: str, store: SqlStore | None = None) -> Worker:
        science = Descent(provisional=True)
        return make_worker(store or self.store, science, self.settings, owner)

    def rotor(self, name: str, readings: int = 3) -> str:
        """A rotor with some readings that nobody has applied yet."""
        blades = [BladeRecord(b, lot="L1") for b in BLADES]
        create_rotor(self.store, name, "rotor-blade", blades, 64, 7)
        for i in range(readings):
            self.post(name, f"i{i}")
        return name

    def reading(self, name: str) -> Inspection:
        """A reading that is the same whenever it is asked for."""
        own = random.Random(f"{self.seed}/{name}")
        values = np.array([round(own.uniform(0.01, 0.6), 4)])
        hours = float(own.randrange(500, 50_000))
        return Inspection(name, own.choice(BLADES), "elongation", hours, values)

    def post(self, rotor: str, name: str, store: SqlStore | None = None) -> None:
        """Post a reading, and note what was answered."""
        items = [Item("", self.reading(name))]
        answer = post_inspections(store or self.store, rotor, items)[0]
        first = self.acknowledged.setdefault((rotor, name), answer.seq)
        if first != answer.seq:
            raise BladetwinError(f"{rotor}/{name} had number {first} and has {answer.seq} now")

    def settle(self) -> float:
        """Apply and seal everything with an intact worker; the seconds that it took."""
        begun = time.monotonic()
        while time.monotonic() - begun < MOST_S:
            self.keeper.drain()
            with self.store.read() as tx:
                left = tx.connection.execute(
                    select(t.cursor.c.rotor_id).where(
                        t.cursor.c.dirty == True,  # noqa: E712
                        t.cursor.c.blocked == False,  # noqa: E712
                    )
                ).first()
            if left is None:
                break
            time.sleep(0.02)
        return time.monotonic() - begun

    def run(self, statement: str, **values: object) -> None:
        with transaction(self.store.engine, write=True) as connection:
            connection.execute(text(statement), values)

    def check(self) -> Findings:
        return check(self.store, self.acknowledged)

    def close(self) -> None:
        self.store.close()


Trial = Callable[[Bench, int], str]


def in_turn(trial: Trial) -> Callable[[Bench, int, Callable[[int], None]], Sequence[str]]:
    """Trials one after the other, each on a rotor of its own number."""

    def run(bench: Bench, trials: int, progress: Callable[[int], None]) -> Sequence[str]:
        outcomes = []
        for number in range(trials):
            outcomes.append(trial(bench, number))
            progress(number + 1)
        return outcomes

    return run
