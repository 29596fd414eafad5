"""What happens is told to receivers that fail, are slow and die: in order, signed, not lost."""

from __future__ import annotations

import base64
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import delete, select, update

from core.observation import Inspection
from service.client import Client, ProblemError, SignatureError, read_webhook
from service.errors import LostLeaseError
from service.handlers import webhooks
from service.handlers.rotors import create_rotor
from service.handlers.webhooks import create_webhook, delete_webhook, find_webhook, list_deliveries
from service.hooks import KINDS, DeliveryRecord
from service.outbound import SendError
from service.ports import BladeRecord
from service.settings import Settings
from service.store import tables as t
from service.store.engine import transaction
from service.store.hook_tables import delivery, webhook
from service.store.outbox import post as note
from service.store.schema import metadata
from service.store.unit_of_work import SqlStore
from service.store.webhooks import prune
from service.worker import hook_lease
from service.worker.deliver import Deliverer
from service.worker.hook_lease import claim_webhook
from service.worker.loop import Worker
from tests.patience import PATIENCE_S
from tests.service.receiver import Got, Receiver, drop_by_drop, receiving, then, too_late

ROOT = Path(__file__).parents[2]
Make = Callable[..., Inspection]
Post = Callable[..., int]
Serving = Callable[..., AbstractContextManager[httpx.Client]]


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with receiving() as running:
        yield running


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    file = tmp_path / "webhook_key"
    file.write_text("7d" * 32 + "\n")
    return file


@pytest.fixture
def settings(settings: Settings, key_file: Path) -> Settings:
    """Webhooks are in use, and may lead to this machine."""
    given = {"webhook_key_file": str(key_file), "webhook_networks": "127.0.0.0/8, ::1"}
    given |= {"retry_base_s": 0.0, "webhook_timeout_s": PATIENCE_S}
    return settings.model_copy(update=given)


@pytest.fixture
def hook(store: SqlStore, settings: Settings, receiver: Receiver) -> Callable[..., str]:
    """Make a webhook to the receiver; its secret."""

    def make(name: str = "ops", **given: Any) -> str:
        wanted = {"url": receiver.url, "events": None, "rotors": None} | given
        _, secret = create_webhook(
            store, settings.webhook_key_file, settings.webhook_networks, name, **wanted
        )
        assert secret is not None
        return secret

    return make


@pytest.fixture
def happens(store: SqlStore) -> Callable[..., None]:
    """Blockings of a rotor, each in a transaction of its own."""

    def happen(rotor: str, *errors: str, kind: str = "blocked") -> None:
        for error in errors:
            with transaction(store.engine, write=True) as connection:
                note(connection, rotor, kind, {"error": error, "event": None})

    return happen


def rested(store: SqlStore) -> None:
    """As if every pause had passed."""
    with transaction(store.engine, write=True) as connection:
        connection.execute(update(delivery).values(not_before=None))


def sender(store: SqlStore, settings: Settings, **given: Any) -> Deliverer:
    return Deliverer(store.engine, settings, f"sender-{os.urandom(3).hex()}", **given)


def told(receiver: Receiver) -> list[tuple[str, str]]:
    """(rotor, error) of every message, in the order in which they came."""
    data = [json.loads(one.body)["data"] for one in receiver.got]
    return [(one["rotor"], one["error"]) for one in data]


def counted(client: Client) -> tuple[int, ...]:
    """Deliveries that are pending, delivered, dead and dropped."""
    told = client.webhook("ops")["deliveries"]
    return told["pending"], told["delivered"], told["dead"], told["dropped"]


def listed(store: SqlStore, status: str | None = None) -> list[DeliveryRecord]:
    return list_deliveries(store, "ops", status, None, 1000)


@pytest.fixture
def rotors(store: SqlStore, rotor: str) -> list[str]:
    create_rotor(store, "r2", "rotor-blade", [BladeRecord("B1")], 64, 7)
    return [rotor, "r2"]


def test_a_webhook_is_made_told_read_and_deleted_over_http(
    serving: Serving, store: SqlStore, settings: Settings, worker: Worker, rotor: str,
    reading: Make, post: Post, receiver: Receiver,
) -> None:  # fmt: skip
    with serving() as http:
        client = Client(http=http)
        made = client.create_webhook("ops", receiver.url)
        secret = made["secret"]
        assert made["webhook"]["events"] == list(KINDS)
        again = http.post("/v1/webhooks", json={"id": "ops", "url": receiver.url})
        assert (again.status_code, again.json()["secret"]) == (201, None), "shown once"
        assert again.headers["idempotent-replayed"] == "true"
        assert again.headers["cache-control"] == "no-store"
        with pytest.raises(ProblemError, match="another content"):
            client.create_webhook("ops", receiver.url, events=["alarm"])
        post(rotor, reading("i1"))
        worker.drain()
        assert client.webhook("ops")["deliveries"] == {
            "pending": 1,
            "delivered": 0,
            "dead": 0,
            "dropped": 0,
        }
        sender(store, settings).drain()
        assert client.webhook("ops")["deliveries"] == {
            "pending": 0,
            "delivered": 1,
            "dead": 0,
            "dropped": 0,
        }
        (got,) = receiver.got
        read = read_webhook(secret, got.headers, got.body)
        assert read["data"] == {"rotor": rotor, "version": 1, "through_seq": 1}
        assert (read["type"], read["id"]) == ("sealed", got.id)
        (one,) = client.deliveries("ops")
        assert (one["id"], one["status"], one["attempts"]) == (got.id, "delivered", 1)
        assert secret not in json.dumps([client.webhook("ops"), one])
        assert http.get("/v1/webhooks").json()["items"] == [client.webhook("ops")]
        assert client.delete_webhook("ops") == {"id": "ops", "deleted": True}
        with pytest.raises(ProblemError, match="does not exist"):
            client.webhook("ops")
        post(rotor, reading("i2"))
        worker.drain()
        sender(store, settings).drain()
    assert len(receiver.got) == 1


def test_what_was_not_signed_with_the_secret_now_and_as_it_came_is_refused(
    store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    hook: Callable[..., str], happens: Callable[..., None],
) -> None:  # fmt: skip
    secret, other = hook(), hook("other", url="https://plant.example/x")
    happens(rotor, "e")
    sender(store, settings, send=None).drain()
    got = next(one for one in receiver.got)
    headers = got.headers
    assert read_webhook(secret, {k.upper(): v for k, v in headers.items()}, got.body)["id"]
    two = headers | {"webhook-signature": "v1,AAAA " + headers["webhook-signature"]}
    assert read_webhook(secret, two, got.body)["id"] == got.id, "while a secret is exchanged"
    old = str(int(headers["webhook-timestamp"]) - 400)
    for wrong, by, body, why in [
        (headers, other, got.body, "no signature fits"),
        (headers, secret, got.body + b" ", "no signature fits"),
        (headers | {"webhook-id": "msg_0"}, secret, got.body, "no signature fits"),
        (headers | {"webhook-timestamp": old}, secret, got.body, "more than 300 s"),
        (headers | {"webhook-timestamp": "1e9"}, secret, got.body, "no time"),
        (headers | {"webhook-signature": ""}, secret, got.body, "no signature fits"),
        ({}, secret, got.body, "missing"),
    ]:
        with pytest.raises(SignatureError, match=why):
            read_webhook(by, wrong, body)


def test_every_kind_of_event_is_told_and_only_to_who_asked(
    store: SqlStore, settings: Settings, worker: Worker, rotors: list[str], receiver: Receiver,
    hook: Callable[..., str], happens: Callable[..., None],
) -> None:  # fmt: skip
    hook("all")
    hook("ops", rotors=["r2"], events=["alarm", "diagnosed"])
    for rotor in rotors:
        with transaction(store.engine, write=True) as connection:
            sealed = {"version": 1, "through_seq": 1, "sealed": True}
            note(connection, rotor, "applied", sealed)
            note(connection, rotor, "applied", sealed | {"sealed": False})
            note(connection, rotor, "blocked", {"error": "e", "event": "i1"})
            note(connection, rotor, "alarm", {"version": 1, "health": "contradicted"})
            note(connection, rotor, "diagnosed", {"diagnosis": "d", "verdict": "adequate"})
            note(connection, rotor, "diagnosis-failed", {"diagnosis": "e", "error": "e"})
            note(connection, rotor, "diagnosis-cancelled", {"diagnosis": "f"})
            note(connection, rotor, "adopted", {"diagnosis": "d", "effects": [], "seq": 2})
            note(connection, rotor, "backed-out", {"diagnosis": "d", "effects": [], "seq": 3})
    assert [(one.rotor_id, one.event) for one in reversed(listed(store))] == [
        ("r2", "alarm"), ("r2", "diagnosed"),
    ]  # fmt: skip
    everything = list_deliveries(store, "all", None, None, 100)
    assert [one.event for one in reversed(everything)] == list(KINDS) * 2


def test_a_diagnosis_that_is_done_is_told(
    store: SqlStore, settings: Settings, worker: Worker, rotor: str, reading: Make, post: Post,
    science: Any, hook: Callable[..., str],
) -> None:  # fmt: skip
    from service.bootstrap import make_worker
    from service.handlers.diagnoses import request_diagnosis

    hook(events=["diagnosed"])
    post(rotor, reading("i1"))
    job, _ = request_diagnosis(store, science, rotor, (), compare=True, horizon_h=None)
    make_worker(store, science, settings, role="diagnose").drain()
    (one,) = listed(store)
    data = json.loads(one.body)["data"]
    assert data == {"rotor": rotor, "diagnosis": job.id, "verdict": "adequate", "names": []}


def test_an_alarm_is_told_once_when_sealed_health_turns_and_not_while_it_stays(
    store: SqlStore, settings: Settings, rotor: str, reading: Make, post: Post,
    hook: Callable[..., str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    from service.bootstrap import make_worker
    from service.fake import FakeScience, FakeState

    hook(events=["alarm"])
    says = {"status": "ok"}
    plain = FakeScience.update

    def update_(self: FakeScience, *words: Any, **given: Any) -> FakeState:
        made = plain(self, *words, **given)
        health = {**made.meta["health"], **says, "reasons": ["B1 is off"]}
        return FakeState({**made.meta, "health": health}, made.arrays)

    monkeypatch.setattr(FakeScience, "update", update_)
    worker = make_worker(store, FakeScience(provisional=True), settings)
    for number, status in enumerate(
        ["ok", "contradicted", "contradicted", "degenerate", "ok", "contradicted"]
    ):
        says["status"] = status
        post(rotor, reading(f"i{number}", time_h=1e3 * (number + 1)))
        worker.drain()
    told = [json.loads(one.body)["data"] for one in reversed(listed(store))]
    assert [one["health"] for one in told] == ["contradicted", "degenerate", "contradicted"]
    assert told[0]["reasons"] == ["B1 is off"]


def test_each_rotors_events_arrive_in_order_though_some_are_refused_and_others_go_on(
    store: SqlStore, settings: Settings, rotors: list[str], receiver: Receiver,
    hook: Callable[..., str], happens: Callable[..., None],
) -> None:  # fmt: skip
    hook()
    for number in range(4):
        for rotor in rotors:
            happens(rotor, f"e{number}")
    refused: list[str] = []

    def answer(got: Got) -> int:
        """Each message of the first rotor is refused twice."""
        if json.loads(got.body)["data"]["rotor"] == "r1" and refused.count(got.id) < 2:
            refused.append(got.id)
            return 503
        return 204

    receiver.answer = answer
    resting = settings.model_copy(update={"retry_base_s": 3600.0, "webhook_retry_max_s": 3600.0})
    sender(store, resting).drain()
    waited = [("r1", "e0"), *(("r2", f"e{n}") for n in range(4))]
    assert told(receiver) == waited, "the second rotor did not wait for the first"
    for _ in range(8):
        rested(store)
        sender(store, resting).drain()
    assert listed(store, "pending") == []
    first = [error for rotor, error in told(receiver) if rotor == "r1"]
    assert first == [f"e{n}" for n in range(4) for _ in range(3)]
    assert len(told(receiver)) == 16
    for message in set(receiver.ids()):
        assert len({one.body for one in receiver.got if one.id == message}) == 1


@pytest.mark.parametrize("late", [too_late, drop_by_drop])
def test_a_receiver_has_its_time_in_all_and_no_more(
    store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    hook: Callable[..., str], happens: Callable[..., None], late: Callable[[Got], int],
) -> None:  # fmt: skip
    hook()
    happens(rotor, "e")
    receiver.answer = late
    quick = settings.model_copy(update={"webhook_timeout_s": 0.4, "retry_base_s": 60.0})
    begun = time.monotonic()
    assert sender(store, quick).run_once() is True
    assert time.monotonic() - begun < PATIENCE_S, "drop by drop it would be a thousand seconds"
    (one,) = listed(store)
    assert (one.status, one.attempts) == ("pending", 1)
    assert "within 0.4 s" in str(one.last_error)
    assert sender(store, quick).run_once() is False, "it pauses"


def test_a_receiver_that_is_not_there_is_tried_again_until_it_is(
    store: SqlStore, settings: Settings, rotor: str, hook: Callable[..., str],
    happens: Callable[..., None],
) -> None:  # fmt: skip
    with socket.socket() as gone:  # it has the port and does not listen
        gone.bind(("127.0.0.1", 0))
        hook(url=f"http://localhost:{gone.getsockname()[1]}/hook")
        happens(rotor, "e")
        sender(store, settings).run_once()
    (one,) = listed(store)
    assert one.status == "dead" or one.attempts >= 1
    assert "Refused" in str(one.last_error)


def test_a_redirect_is_not_followed(
    store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    hook: Callable[..., str], happens: Callable[..., None],
) -> None:  # fmt: skip
    hook()
    happens(rotor, "e")
    receiver.answer = then(307)
    sender(store, settings.model_copy(update={"retry_base_s": 60.0})).drain()
    assert [one.path for one in receiver.got] == ["/hook"]
    assert "307" in str(listed(store)[0].last_error)


def test_a_dead_letter_is_shown_lets_others_pass_and_is_sent_when_asked(
    serving: Serving, store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    hook: Callable[..., str], happens: Callable[..., None],
) -> None:  # fmt: skip
    hook()
    happens(rotor, "e0", "e1")
    receiver.answer = then(500, 500, 500)
    few = settings.model_copy(update={"webhook_max_attempts": 3})
    sender(store, few).drain()
    assert [error for _, error in told(receiver)] == ["e0", "e0", "e0", "e1"]
    with serving() as http:
        client = Client(http=http)
        assert client.webhook("ops")["deliveries"] == {
            "pending": 0,
            "delivered": 1,
            "dead": 1,
            "dropped": 0,
        }
        assert "\nbladetwin_deliveries_dead 1\n" in http.get("/metrics").text
        (dead,) = client.deliveries("ops", "dead")
        assert (dead["attempts"], dead["last_error"]) == (3, "answered with status 500")
        assert client.retry_delivery("ops", dead["id"])["status"] == "pending"
        alive = next(client.deliveries("ops", "delivered"))
        assert client.retry_delivery("ops", alive["id"])["status"] == "delivered", "it is left"
        with pytest.raises(ProblemError, match="does not exist"):
            client.retry_delivery("ops", "msg_0")
    sender(store, few).drain()
    assert receiver.ids()[-1] == dead["id"] == receiver.ids()[0]
    assert listed(store, "dead") == []


def test_pauses_double_up_to_a_limit_and_are_scattered(store: SqlStore, settings: Settings) -> None:
    given = settings.model_copy(update={"retry_base_s": 1.0, "webhook_retry_max_s": 100.0})
    one = sender(store, given)
    for attempt, most in [(1, 1.0), (2, 2.0), (5, 16.0), (9, 100.0), (1000, 100.0)]:
        pauses = [one.pause(attempt) for _ in range(200)]
        assert most / 2 <= min(pauses) < 0.6 * most
        assert 0.9 * most < max(pauses) <= most


class Died(BaseException):
    """The worker's process ends here, whatever it was doing."""


def survives(store: SqlStore, settings: Settings, kind: type[Deliverer], when: str) -> list[str]:
    """Messages that arrive where a worker dies at its first sending and another goes on."""
    arrived: list[str] = []

    def dying(url: str, headers: Any, *rest: Any) -> int:
        if when == "after":
            arrived.append(headers["webhook-id"])
        raise Died

    def living(url: str, headers: Any, *rest: Any) -> int:
        arrived.append(headers["webhook-id"])
        return 204

    with pytest.raises(Died):
        kind(store.engine, settings, "dies", dying).run_once()
    with transaction(store.engine, write=True) as connection:  # its lease runs out
        connection.execute(update(webhook).values(lease_until=0.0))
    kind(store.engine, settings, "lives", living).drain()
    return arrived


class RecordsFirst(Deliverer):
    """Mutant: moves on before it has delivered."""

    def deliver(self, webhook: Any, message: Any) -> tuple[str | None, bool]:
        with transaction(self.engine, write=True) as connection:
            own = update(delivery).where(delivery.c.id == message.number)
            connection.execute(own.values(status="delivered"))
        return super().deliver(webhook, message)


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_worker_that_dies_while_sending_loses_nothing(
    store: SqlStore, settings: Settings, rotor: str, hook: Callable[..., str],
    happens: Callable[..., None], when: str,
) -> None:  # fmt: skip
    hook()
    happens(rotor, "e0", "e1", "e2")
    wanted = [one.message_id for one in reversed(listed(store))]
    again = wanted[:1] if when == "after" else []
    assert survives(store, settings, Deliverer, when) == again + wanted


def test_a_worker_that_records_before_it_sends_would_lose_one(
    store: SqlStore, settings: Settings, rotor: str, hook: Callable[..., str],
    happens: Callable[..., None],
) -> None:  # fmt: skip
    hook()
    happens(rotor, "e0", "e1", "e2")
    wanted = [one.message_id for one in reversed(listed(store))]
    assert survives(store, settings, RecordsFirst, "before") == wanted[1:], "the first is lost"


def overtaken(store: SqlStore, settings: Settings) -> list[DeliveryRecord]:
    """The delivery after one worker lost its lease while sending, and another one sent it."""
    slow = sender(store, settings)
    lease = claim_webhook(store.engine, "slow", 30.0)
    assert lease is not None
    (message,) = listed(store)
    assert claim_webhook(store.engine, "quick", 30.0) is None, "one at a time"
    with transaction(store.engine, write=True) as connection:
        connection.execute(update(webhook).values(lease_until=0.0))
    sender(store, settings).drain()
    slow.record(lease, message, "no answer", counts=True)
    return listed(store)


def test_a_worker_whose_lease_ran_out_changes_nothing(
    store: SqlStore, settings: Settings, rotor: str, hook: Callable[..., str],
    happens: Callable[..., None],
) -> None:  # fmt: skip
    hook()
    happens(rotor, "e")
    with pytest.raises(LostLeaseError):
        overtaken(store, settings)
    (one,) = listed(store)
    assert (one.status, one.attempts, one.last_error) == ("delivered", 1, None)


def test_without_the_fence_it_would(
    store: SqlStore, settings: Settings, rotor: str, hook: Callable[..., str],
    happens: Callable[..., None], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    hook()
    happens(rotor, "e")
    monkeypatch.setattr(hook_lease, "holds", lambda lease: webhook.c.id == lease.webhook.id)
    assert overtaken(store, settings)[0].status == "pending", "delivered, and to be sent again"


def test_without_heads_a_refused_one_would_be_overtaken(
    store: SqlStore, settings: Settings, rotor: str, receiver: Receiver, hook: Callable[..., str],
    happens: Callable[..., None], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    hook()
    happens(rotor, "e0", "e1")
    receiver.answer = then(503)
    pausing = settings.model_copy(update={"retry_base_s": 60.0})
    sender(store, pausing).drain()
    assert [error for _, error in told(receiver)] == ["e0"], "e1 waits for it"

    def anything(longest_s: float = 0.0) -> Any:
        rested = delivery.c.not_before.is_(None)
        return (delivery.c.status == "pending") & rested

    monkeypatch.setattr(hook_lease, "due", anything)
    sender(store, pausing).drain()
    assert [error for _, error in told(receiver)] == ["e0", "e1"]


def test_real_workers_killed_between_delivery_and_record_deliver_again_and_lose_nothing(
    store: SqlStore, settings: Settings, rotors: list[str], receiver: Receiver,
    hook: Callable[..., str], happens: Callable[..., None],
) -> None:  # fmt: skip
    secret = hook()
    wanted = {rotor: [f"e{n}" for n in range(3)] for rotor in rotors}
    running: list[subprocess.Popen[bytes]] = []
    killed: list[str] = []
    lock = threading.Lock()

    def answer(got: Got) -> int:
        """The message is here; its sender will never know."""
        with lock:
            if got.id not in killed and len(killed) < 3:
                killed.append(got.id)
                running[-1].kill()
                return 0
        return 204

    receiver.answer = answer
    environ = settings.model_copy(update={"lease_s": 1.0}).environ()
    environ = {**os.environ, **environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "service.cli", "worker", "--role", "deliver"]
    for rotor, errors in wanted.items():
        happens(rotor, *errors)
    end = time.monotonic() + PATIENCE_S
    try:
        while listed(store, "pending"):
            assert time.monotonic() < end, "not all was delivered"
            if not running or running[-1].poll() is not None:
                running.append(subprocess.Popen(command, env=environ))
            time.sleep(0.05)
        assert running[-1].poll() is None
        running[-1].terminate()
        assert running[-1].wait(PATIENCE_S) == 0, "it ends cleanly"
    finally:
        for process in running:
            if process.poll() is None:
                process.kill()
            process.wait()
    assert [process.returncode for process in running] == [-signal.SIGKILL] * 3 + [0]
    assert all(receiver.ids().count(one) >= 2 for one in killed), "told again, with the same id"
    seen: list[str] = []
    for got in receiver.got:
        assert read_webhook(secret, got.headers, got.body, tolerance_s=600.0)["id"] == got.id
        seen += [] if got.id in seen else [got.id]
    assert len(seen) == 6
    for rotor, errors in wanted.items():
        own = [g for i in seen for g in [next(x for x in receiver.got if x.id == i)]]
        came = [json.loads(g.body)["data"] for g in own]
        assert [one["error"] for one in came if one["rotor"] == rotor] == errors


def test_serve_starts_a_worker_that_delivers_where_there_is_a_key_file(settings: Settings) -> None:
    from service.processes import worker_roles

    assert worker_roles(settings).count("deliver") == 1
    assert worker_roles(settings.model_copy(update={"sealers": 0})).count("deliver") == 1
    assert "deliver" not in worker_roles(settings.model_copy(update={"webhook_key_file": ""}))


def test_nothing_in_the_database_makes_a_signature_and_another_key_file_is_noticed(
    serving: Serving, store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    key_file: Path, happens: Callable[..., None],
) -> None:  # fmt: skip
    with serving() as http:
        asked = {"json": {"id": "ops", "url": receiver.url}, "headers": {"Idempotency-Key": "k1"}}
        first = http.post("/v1/webhooks", **asked)
        second = http.post("/v1/webhooks", **asked)
        assert (first.status_code, second.status_code) == (201, 201)
        assert second.json()["secret"] is None, "a kept answer would hold the secret"
    secret = first.json()["secret"]
    happens(rotor, "e")
    with store.read() as tx:
        rows = [
            str(value)
            for table in metadata.sorted_tables
            for row in tx.connection.execute(select(table))
            for value in row
        ]
    raw = base64.b64decode(secret.removeprefix("whsec_"))
    for hidden in (secret, secret.removeprefix("whsec_"), raw.hex(), key_file.read_text().strip()):
        assert not any(hidden in one for one in rows)
    key_file.write_text("8e" * 32)
    sender(store, settings.model_copy(update={"webhook_retry_max_s": 0.5})).run_once()
    (one,) = listed(store)
    assert (one.status, one.attempts, receiver.got) == ("pending", 0, []), "no attempt is counted"
    assert "is not the key of ops" in str(one.last_error)
    key_file.write_text("7d" * 32)
    time.sleep(0.6)
    sender(store, settings).drain()
    assert [got.id for got in receiver.got] == [one.message_id]


def test_a_delivery_is_written_with_what_it_tells_or_not_at_all(
    store: SqlStore, rotor: str, hook: Callable[..., str]
) -> None:
    hook()

    def fails() -> None:
        with transaction(store.engine, write=True) as connection:
            note(connection, rotor, "blocked", {"error": "e", "event": None})
            raise Died

    with pytest.raises(Died):
        fails()
    assert listed(store) == []


def test_deliveries_do_not_hang_on_the_outbox_being_kept(
    store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    hook: Callable[..., str], happens: Callable[..., None],
) -> None:  # fmt: skip
    hook()
    happens(rotor, *(f"e{n}" for n in range(5)))
    with transaction(store.engine, write=True) as connection:
        connection.execute(delete(t.outbox))
    sender(store, settings).drain()
    assert [error for _, error in told(receiver)] == [f"e{n}" for n in range(5)]


def test_delivered_and_dead_ones_are_pruned_and_others_stay(
    store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    hook: Callable[..., str], happens: Callable[..., None],
) -> None:  # fmt: skip
    hook()
    happens(rotor, *(f"e{n}" for n in range(6)))
    receiver.answer = then(500)
    sender(store, settings.model_copy(update={"webhook_max_attempts": 1})).drain()
    happens(rotor, "e6")
    with transaction(store.engine, write=True) as connection:
        prune(connection, "ops", {"delivered": 2, "dead": 1})
    kept = [(json.loads(one.body)["data"]["error"], one.status) for one in reversed(listed(store))]
    assert kept == [("e0", "dead"), ("e4", "delivered"), ("e5", "delivered"), ("e6", "pending")]
    with transaction(store.engine, write=True) as connection:
        prune(connection, "ops", {"dead": 0})
    assert [one.status for one in listed(store)] == ["pending", "delivered", "delivered"]


@pytest.mark.parametrize("patience_s", [PATIENCE_S, 0.0])
def test_what_is_committed_after_a_webhook_was_made_is_told_it(
    store: SqlStore, rotor: str, hook: Callable[..., str], monkeypatch: pytest.MonkeyPatch,
    patience_s: float,
) -> None:  # fmt: skip
    """A commit that was under way had looked for webhooks before: it is waited for.

    The control has no patience; SQLite lets one write at a time.
    """
    monkeypatch.setattr(webhooks, "PATIENCE_S", patience_s)
    hasty = patience_s == 0.0 and store.engine.dialect.name == "postgresql"
    made = threading.Thread(target=hook)
    with transaction(store.engine, write=True) as connection:
        note(connection, rotor, "blocked", {"error": "before", "event": None})
        made.start()
        made.join(PATIENCE_S if hasty else 0.5)
        early = not made.is_alive()
    made.join(PATIENCE_S)
    assert early is hasty
    assert listed(store) == []
    with transaction(store.engine, write=True) as connection:
        note(connection, rotor, "blocked", {"error": "after", "event": None})
    assert [json.loads(one.body)["data"]["error"] for one in listed(store)] == ["after"]


def test_a_webhook_deleted_while_it_is_served_is_told_nothing_more(
    store: SqlStore, settings: Settings, rotor: str, receiver: Receiver,
    hook: Callable[..., str], happens: Callable[..., None],
) -> None:  # fmt: skip
    hook()
    happens(rotor, "e0", "e1")

    def answer(got: Got) -> int:
        delete_webhook(store, "ops")
        return 204

    receiver.answer = answer
    sender(store, settings).drain()
    assert len(receiver.got) == 1
    with store.read() as tx:
        assert tx.connection.execute(select(delivery)).all() == []


def test_a_webhook_made_anew_under_its_name_is_another_one(
    store: SqlStore, settings: Settings, rotor: str, hook: Callable[..., str],
    happens: Callable[..., None],
) -> None:  # fmt: skip
    """Who still serves the old one, under the same fence, neither sends nor records for the new."""
    hook()
    happens(rotor, "e0")
    old = claim_webhook(store.engine, "old", 30.0)
    assert old is not None
    delete_webhook(store, "ops")
    hook()
    happens(rotor, "e1")
    new = claim_webhook(store.engine, "new", 30.0)
    assert new is not None
    assert new.fence == old.fence
    (one,) = listed(store)
    slow = sender(store, settings)
    with pytest.raises(LostLeaseError):
        slow.record(old, one, None, counts=True)
    slow._give_back(old)
    assert not slow._beat(old)
    assert slow._beat(new), "the new one's lease is not given back by the old one"
    assert listed(store)[0].status == "pending"


def test_a_receiver_that_fails_lets_others_have_their_turn(
    store: SqlStore, settings: Settings, hook: Callable[..., str], happens: Callable[..., None]
) -> None:
    """Four rotors have news for a receiver that hangs: one message of them is tried a turn."""
    names = [f"r{i}" for i in range(4)]
    for name in names:
        create_rotor(store, name, "rotor-blade", [BladeRecord("B1")], 64, 7)
    hook("dead")
    hook("well")
    for name in names:
        happens(name, "e")
    tried: list[str] = []

    def send(url: str, headers: Any, *rest: Any) -> int:
        owner = turns[-1]
        tried.append(owner)
        if owner == "dead":
            raise SendError("no answer within 5 s")
        return 204

    turns: list[str] = []
    worker = sender(store, settings, send=send)
    real = worker._serve

    def serve(lease: Any) -> None:
        turns.append(lease.webhook.id)
        real(lease)

    worker._serve = serve  # type: ignore[method-assign]
    for _ in range(2):
        assert worker.run_once()
    assert sorted(set(turns)) == ["dead", "well"]
    assert tried.count("dead") == 1
    assert tried.count("well") == 4


def test_webhooks_need_the_scope_operate_and_a_key_for_all_rotors(
    serving: Serving, key: Callable[..., dict[str, str]], receiver: Receiver
) -> None:
    body = {"id": "ops", "url": receiver.url}
    with serving(keys="always") as http:
        few = http.post("/v1/webhooks", json=body, headers=key("read", "ingest"))
        some = http.post("/v1/webhooks", json=body, headers=key("operate", rotors=["r1"]))
        assert (few.status_code, some.status_code) == (403, 403)
        assert http.post("/v1/webhooks", json=body, headers=key("operate")).status_code == 201
        trail = http.get("/v1/audit", headers=key("operate")).json()["items"]
    assert [one["what"] for one in trail].count("POST /v1/webhooks") == 3


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"url": "http://127.0.0.1/x"}, "url"),
        ({"url": "https://user:pw@plant.example/"}, "url"),
        ({"url": "ftp://plant.example/"}, "url"),
        ({"events": ["sealt"]}, "events"),
        ({"events": []}, "events"),
        ({"rotors": []}, "rotors"),
        ({"id": "a/b"}, "id"),
        ({"retries": 3}, "retries"),
    ],
)
def test_a_webhook_that_cannot_be_used_is_refused_with_its_fault(
    serving: Serving, change: dict[str, Any], field: str
) -> None:
    with serving(webhook_networks="") as http:
        body = {"id": "ops", "url": "https://plant.example/x"} | change
        answer = http.post("/v1/webhooks", json=body)
        assert answer.status_code == 422
        assert any(field in one["field"] for one in answer.json()["faults"])
        assert "pw" not in answer.text
        assert http.get("/v1/webhooks").json()["items"] == []


def test_without_a_key_file_webhooks_are_refused_and_it_says_what_to_set(serving: Serving) -> None:
    with serving(webhook_key_file="") as http:
        answer = http.post("/v1/webhooks", json={"id": "ops", "url": "https://plant.example/x"})
    assert (answer.status_code, answer.json()["type"]) == (
        409,
        "urn:bladetwin:problem:webhooks-off",
    )
    assert "BLADETWIN_WEBHOOK_KEY_FILE" in answer.json()["detail"]


def test_a_key_file_that_is_too_short_is_refused(serving: Serving, key_file: Path) -> None:
    key_file.write_text("short")
    with serving() as http:
        answer = http.post("/v1/webhooks", json={"id": "ops", "url": "https://plant.example/x"})
    assert answer.status_code == 422
    assert "holds 5 bytes" in answer.json()["detail"]


def test_sending_errors_are_recorded_and_not_raised(
    store: SqlStore, settings: Settings, rotor: str, hook: Callable[..., str],
    happens: Callable[..., None],
) -> None:  # fmt: skip
    def broken(*words: Any) -> int:
        raise SendError("the moon is in the way")

    hook()
    happens(rotor, "e")
    sender(store, settings.model_copy(update={"retry_base_s": 60.0}), send=broken).drain()
    assert listed(store)[0].last_error == "the moon is in the way"
    assert find_webhook(store, "ops").counts == {"pending": 1}
    assert replace(listed(store)[0], attempts=1) == listed(store)[0]
