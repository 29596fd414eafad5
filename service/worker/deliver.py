"""Sends what webhooks are to be told: at least once, and each rotor's events in order.

A worker that has taken a webhook (`service.worker.hook_lease`) sends the heads (of each rotor the
first pending delivery) and only then records what came of it. If it dies in between, the lease runs
out and the same message, with the same id, is sent again: never lost, seldom twice, and a receiver
tells by the id.

A message that was not answered with 2xx is sent again after a pause, doubled each time up to
`webhook_retry_max_s` and shortened by chance (by up to half), while later ones of the same rotor
wait; after `webhook_max_attempts` it is dead: kept (the newest ten thousand), shown, skipped, until
somebody asks for it to be tried again. How many may wait is bounded where they are written
(`service.store.untold`).
"""

from __future__ import annotations

import logging
import random
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from types import FrameType

from sqlalchemy import Engine, select, update

from core.errors import InputError
from service import signing
from service.errors import LostLeaseError, StoreAwayError
from service.hooks import DeliveryRecord, WebhookRecord
from service.outbound import Network, SendError, networks, post
from service.settings import Settings
from service.store import hook_tables as t
from service.store.engine import now_s, transaction
from service.store.webhooks import delivery_of, prune
from service.worker import hook_lease as leases
from service.worker.heartbeat import heartbeats, rest
from service.worker.hook_lease import HookLease
from service.worker.outdated import Outdated
from service.worker.wake import open_wake

log = logging.getLogger("bladetwin.deliver")
w, d = t.webhook.c, t.delivery.c
THREADS = 4  # receivers that are served at once
MOST = 50  # messages to one receiver before others have their turn
KEPT = {"delivered": 200, "dead": 10_000}  # of each webhook, the newest
IDLE_S = 0.5
SCHEMA_S = 5.0  # how often it is looked whether this release may still run on the database
Send = Callable[[str, Mapping[str, str], bytes, float, Sequence[Network]], int]


class Deliverer:
    """Sends due deliveries of one webhook after the other. `send` is `service.outbound.post`.

    remedy   what is to be done before this release may run on the database (`Outdated`)
    """

    def __init__(
        self,
        engine: Engine,
        settings: Settings,
        owner: str,
        send: Send | None = None,
        remedy: Callable[[], str | None] = lambda: None,
    ) -> None:
        self.engine = engine
        self.settings = settings
        self.owner = owner
        self.send = send or _post
        self.networks = networks(settings.webhook_networks)
        self._outdated = Outdated(remedy)
        self._stop = threading.Event()
        self._news = threading.Condition()

    def stop(self, signum: int | None = None, frame: FrameType | None = None) -> None:
        """Finish the message at hand, then end; fits `signal.signal`."""
        self._stop.set()

    def run_once(self) -> bool:
        """Serve one webhook; False: there was nothing to be sent."""
        lease_s = self.settings.lease_s
        longest_s = self.settings.webhook_retry_max_s
        lease = leases.claim_webhook(self.engine, self.owner, lease_s, longest_s)
        if lease is None:
            return False
        try:
            with heartbeats(lambda: self._beat(lease), lease_s):
                self._serve(lease)
            self._give_back(lease)
        except LostLeaseError as error:
            log.warning("%s", error)
        return True

    def _serve(self, lease: HookLease) -> None:
        for _ in range(MOST):
            if self._stop.is_set():
                return
            now = leases.due(self.settings.webhook_retry_max_s)
            query = select(t.delivery).where(d.webhook_id == lease.webhook.id, now)
            with transaction(self.engine, write=False) as connection:
                row = connection.execute(query.order_by(d.id).limit(1)).mappings().first()
            if row is None:
                return
            message = delivery_of(row)
            problem, counts = self.deliver(lease.webhook, message)
            self.record(lease, message, problem, counts=counts)
            if problem is not None:
                return  # others have their turn before this receiver is tried again

    def deliver(self, webhook: WebhookRecord, message: DeliveryRecord) -> tuple[str | None, bool]:
        """Send a message; what went wrong, if anything, and whether the attempt counts."""
        try:
            secret = self._secret(webhook)
        except InputError as error:
            return str(error), False
        body = message.body.encode()
        headers = signing.headers_of(secret, message.message_id, int(time.time()), body)
        headers |= {"content-type": "application/json", "user-agent": "bladetwin"}
        try:
            status = self.send(
                webhook.url, headers, body, self.settings.webhook_timeout_s, self.networks
            )
        except SendError as error:
            return str(error), True
        return (None if 200 <= status < 300 else f"answered with status {status}"), True

    def _secret(self, webhook: WebhookRecord) -> str:
        """The webhook's secret; InputError: the key file is not the one of which it was made."""
        path = self.settings.webhook_key_file
        remedy = "give the key file with which the webhook was made, or make it anew"
        if not path:
            raise InputError(signing.SETTING, "", "is not set for the deliverer", remedy)
        secret = signing.secret_of(signing.read_key(path), webhook.id, webhook.salt)
        if signing.fingerprint(secret) != webhook.fingerprint:
            raise InputError(signing.SETTING, path, f"is not the key of {webhook.id}", remedy)
        return secret

    def record(
        self, lease: HookLease, message: DeliveryRecord, problem: str | None, *, counts: bool
    ) -> None:
        """Write what came of a sending; LostLeaseError: another worker has the webhook."""
        attempts = message.attempts + int(counts)
        dead = problem is not None and attempts >= self.settings.webhook_max_attempts
        status = "delivered" if problem is None else "dead" if dead else "pending"
        pause = self.pause(attempts) if counts else self.settings.webhook_retry_max_s
        with transaction(self.engine, write=True) as connection:
            own = select(w.id).where(leases.holds(lease)).with_for_update(key_share=True)
            if connection.execute(own).first() is None:
                raise LostLeaseError(f"webhook {lease.webhook.id}", lease.fence)
            connection.execute(
                update(t.delivery)
                .where(
                    d.id == message.number,
                    d.webhook_id == lease.webhook.id,
                    d.message_id == message.message_id,
                )
                .values(
                    status=status,
                    attempts=attempts,
                    tried_at=now_s(),
                    not_before=now_s() + pause if status == "pending" else None,
                    last_error=None if problem is None else problem[:1000],
                )
            )
        if problem is not None:
            what = "is dead" if dead else "is sent again later"
            log.warning(
                "%s to webhook %s %s: %s", message.message_id, lease.webhook.id, what, problem
            )

    def pause(self, attempts: int) -> float:
        """Seconds until a message is sent again, after so many attempts."""
        doubled = self.settings.retry_base_s * 2.0 ** min(attempts - 1, 60)
        return min(doubled, self.settings.webhook_retry_max_s) * random.uniform(0.5, 1.0)

    def _beat(self, lease: HookLease) -> bool:
        beat = update(t.webhook).where(leases.holds(lease))
        with transaction(self.engine, write=True) as connection:
            beaten = beat.values(lease_until=now_s() + self.settings.lease_s)
            return connection.execute(beaten).rowcount == 1

    def _give_back(self, lease: HookLease) -> None:
        free = update(t.webhook).where(leases.holds(lease))
        with transaction(self.engine, write=True) as connection:
            prune(connection, lease.webhook.id, KEPT)
            connection.execute(free.values(owner=None, lease_until=None, served_at=now_s()))

    def drain(self) -> None:
        """Send everything that can be sent now."""
        while not self._stop.is_set() and self.run_once():
            pass

    def run(self) -> None:
        """Send until stopped; a database that is away is waited for."""
        threads = [threading.Thread(target=self._loop, name=f"deliver-{i}") for i in range(THREADS)]
        for thread in threads:
            thread.start()
        wake = open_wake(self.engine, "bladetwin_applied", self.settings.poll_ms)
        try:
            while not self._stop.is_set():
                try:
                    wake.wait(IDLE_S)
                except Exception as error:  # the threads look by themselves
                    log.error("%s: %s", type(error).__name__, error)
                    self._stop.wait(1.0)
                with self._news:
                    self._news.notify_all()
        finally:
            wake.close()
            with self._news:
                self._news.notify_all()
            for thread in threads:
                thread.join()

    def _loop(self) -> None:
        while not self._stop.is_set():
            try:
                if not self._outdated.now(SCHEMA_S):
                    self.drain()
            except StoreAwayError as error:
                log.error("%s The worker looks again in 1 s: %s", error, error.reason)
                self._stop.wait(1.0)
            except Exception:
                log.exception("a delivery failed in the worker itself; it looks again in 1 s")
                self._stop.wait(1.0)
            with self._news:
                if not self._stop.is_set():
                    self._news.wait(IDLE_S)
        rest()


def _post(
    url: str,
    headers: Mapping[str, str],
    body: bytes,
    timeout_s: float,
    allowed: Sequence[Network],
) -> int:
    return post(url, headers, body, timeout_s=timeout_s, allowed=allowed)
