"""Faults of what is sent and of what is stored: repeated, reordered, damaged."""

from __future__ import annotations

import shutil
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from sqlalchemy import Connection, select, text

from core.errors import BladetwinError
from service.errors import DamagedError, DamagedRotorError
from service.handlers.reads import basis, posterior
from service.handlers.rotors import NEWEST, view_rotor
from service.store import tables as t
from service.store.audit import Finding, audit
from service.store.engine import snapshot, transaction
from service.studies.chaos.bench import BLADES, Bench
from service.worker.rebuild import repair

READINGS, CLIENTS = 12, 3


def reordered(bench: Bench, number: int) -> str:
    """Three clients post the same readings, each in an order of its own and some of them twice."""
    rotor = bench.rotor(f"r{number}", readings=0)
    orders = []
    for _ in range(CLIENTS):
        order = [f"i{i}" for i in range(READINGS)]
        order += bench.chosen.sample(order, 4)
        bench.chosen.shuffle(order)
        orders.append(order)
    stop = threading.Event()

    def apply() -> None:
        worker = bench.worker(f"worker-{number}")
        while not stop.wait(0.005):
            worker.drain()

    def post(order: Sequence[str]) -> None:
        for name in order:
            bench.post(rotor, name)

    threads = [threading.Thread(target=post, args=(order,)) for order in orders]
    working = threading.Thread(target=apply)
    working.start()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    stop.set()
    working.join()
    bench.settle()
    with bench.store.read() as tx:
        here, first = tx.states.get(rotor), tx.states.get("r0")
        head = tx.records.rotor(rotor).head_seq
    if head != READINGS:
        return f"NOT WHOLE: {head} entries of {READINGS} readings"
    same = here.digest == first.digest
    return "one entry each; " + ("sealed alike" if same else "SEALED OTHERWISE")


FLIP: dict[str, tuple[str, str]] = {
    "array": ("state_array", "data"),
    "description": ("state", "meta"),
    "entry": ("event", "body"),
}
SOURCE = ("entry", "rotor")  # what nothing makes again
OF_A_ROTOR: tuple[tuple[str, str], ...] = (
    *(("rotor", column) for column in ("particles", "seed", "digest", "adopt")),
    ("blade", "lot"),
)
"""What a rotor's versions are computed from beside its log: tables and columns."""


def damaged(what: str) -> Callable[[Bench, int], str]:
    """One byte of the newest version, of the log or of the rotor's row or a blade's is another one;
    or the row is gone."""

    def trial(bench: Bench, number: int) -> str:
        rotor = bench.rotor(f"r{number}")
        bench.settle()
        spoil(bench, rotor, what)
        bench.store.close()  # processes that have read it before keep their memory
        bench.store = bench.open()
        bench.keeper = bench.worker(f"keeper-{number}")
        read = "a read answers"
        try:
            view = view_rotor(bench.store, rotor)
            for blade in (None, *BLADES):
                science = bench.keeper.science
                posterior(bench.store, science, basis(bench.store, science, rotor, NEWEST, blade))
            read += f" with version {view.rotor.version}" if what not in SOURCE else ""
        except (DamagedError, DamagedRotorError):
            read = "a read is refused (503 damaged)"
        with snapshot(bench.store.engine) as connection:
            findings = audit(connection, rotor)
        named = "named by verify" if findings else "NOT FOUND by verify"
        if what in SOURCE:
            bench.acknowledged = {k: v for k, v in bench.acknowledged.items() if k[0] != rotor}
            restored = "the worker blocks the rotor"
            bench.post(rotor, "later")
            bench.settle()
            with bench.store.read() as tx:
                record = tx.records.rotor(rotor)
            if not record.blocked:
                restored = "NOT NOTICED by the worker"
            elif what == "rotor" and "restore the database" not in str(record.last_error):
                restored = f"NOT SAID why the worker blocks it: {record.last_error}"
            forget(bench, rotor)
            return f"{read}, {named}; {restored}"
        if number % 2:
            repair(bench.keeper.updater, rotor, findings)
            how = "repair wrote it again"
        else:
            bench.post(rotor, "later")
            bench.settle()
            repair(bench.keeper.updater, rotor, again(bench, rotor))
            how = "the next entry's update made it from the log"
        with snapshot(bench.store.engine) as connection:
            left = audit(connection, rotor)
        return f"{read}, {named}; {how}" + (f"; LEFT: {left}" if left else "")

    return trial


def again(bench: Bench, rotor: str) -> list[Finding]:
    with snapshot(bench.store.engine) as connection:
        return list(audit(connection, rotor))


def spoil(bench: Bench, rotor: str, what: str) -> None:
    """Flip one bit of one byte of a stored value, or delete the newest version's row."""
    with transaction(bench.store.engine, write=True) as connection:
        newest = connection.execute(
            select(t.cursor.c.version).where(t.cursor.c.rotor_id == rotor)
        ).scalar()
        if what == "row":
            connection.execute(
                text("DELETE FROM state WHERE rotor_id = :r AND version = :v"),
                {"r": rotor, "v": newest},
            )
            return
        if what == "rotor":
            spoil_source(bench, connection, rotor)
            return
        table, column = FLIP[what]
        order = "seq" if what == "entry" else "version"
        key = "seq" if what == "entry" else ("version, name" if what == "array" else "version")
        row = connection.execute(
            text(
                f"SELECT {key}, {column} AS value FROM {table} WHERE rotor_id = :r "
                f"ORDER BY {order} DESC LIMIT 1"
            ),
            {"r": rotor},
        ).one()
        value = bytes(row.value) if what == "array" else row.value.encode()
        place = bench.chosen.randrange(len(value))
        spoilt = value[:place] + bytes([value[place] ^ 1]) + value[place + 1 :]
        names = {k: getattr(row, k) for k in key.split(", ")}
        where = " AND ".join(f"{name} = :{name}" for name in names)
        connection.execute(
            text(f"UPDATE {table} SET {column} = :value WHERE rotor_id = :r AND {where}"),
            {"value": spoilt if what == "array" else spoilt.decode(), "r": rotor, **names},
        )


def spoil_source(bench: Bench, connection: Connection, rotor: str) -> None:
    """Flip one bit of one byte in the rotor's row, or in one of its blades'."""
    table, column = bench.chosen.choice(OF_A_ROTOR)
    blade = bench.chosen.choice(BLADES)
    key = "id = :r" if table == "rotor" else "rotor_id = :r AND id = :b"
    names = {"r": rotor} if table == "rotor" else {"r": rotor, "b": blade}
    told = text(f"SELECT {column} FROM {table} WHERE {key}")
    value = connection.execute(told, names).scalar_one()
    if isinstance(value, int):
        spoilt: int | str = value ^ (1 << bench.chosen.randrange(8))
    else:
        place = bench.chosen.randrange(len(value))
        spoilt = value[:place] + chr(ord(value[place]) ^ 1) + value[place + 1 :]
    change = text(f"UPDATE {table} SET {column} = :value WHERE {key}")
    connection.execute(change, {"value": spoilt, **names})


def forget(bench: Bench, rotor: str) -> None:
    """Take a rotor whose log is lost out of the tables, so that the check can pass the others."""
    for table in ("state_array", "state", "outbox", "event", "cursor", "blade"):
        bench.run(f"DELETE FROM {table} WHERE rotor_id = :r", r=rotor)
    bench.run("DELETE FROM rotor WHERE id = :r", r=rotor)
    bench.acknowledged = {k: v for k, v in bench.acknowledged.items() if k[0] != rotor}


def artefact(bench: Bench, number: int) -> str:
    """One byte of a model's file is another one."""
    from core.builtin import rotor_blade
    from service.science import CoreScience

    shipped = Path(rotor_blade.__file__).parent / "rotor_blade_model"
    with tempfile.TemporaryDirectory(prefix="bladetwin-model-") as folder:
        copy = Path(folder) / "model"
        shutil.copytree(shipped, copy)
        file = bench.chosen.choice(sorted(p for p in copy.iterdir() if p.is_file()))
        data = bytearray(file.read_bytes())
        data[bench.chosen.randrange(len(data))] ^= 1
        file.write_bytes(bytes(data))
        try:
            card = CoreScience(str(copy)).builtin("rotor-blade")
        except BladetwinError as error:
            return f"{file.name}: refused ({type(error).__name__})"
        true = CoreScience(str(shipped)).builtin("rotor-blade")
        told, shipped_told = card.to_json(), true.to_json()
        if told == shipped_told:
            return f"{file.name}: no difference in what was read"
        for one in (told, shipped_told):
            del one["summary"]
        if told == shipped_told:
            return f"{file.name}: A CHANGED NOTE TAKEN FOR GOOD"
        return f"{file.name}: TAKEN FOR GOOD"
