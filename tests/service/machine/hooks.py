"""Webhooks are told what the outbox holds, in order, signed, at least once, by a sender that fails
and dies."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import strategies as st
from sqlalchemy import select, text, update

from service.client import read_webhook
from service.hooks import KINDS
from service.store import tables as t
from service.store.engine import transaction
from service.store.hook_tables import delivery, webhook
from service.worker.deliver import Deliverer
from tests.service.machine.log import Crash, Log
from tests.service.machine.steps import act
from tests.service.modelled import Json


@dataclass
class Hook:
    """A webhook: as it was asked for, the newest note then, and what it was sent, by id."""

    asked: Json
    secret: str
    born: int
    got: dict[str, Json] = field(default_factory=dict)


class Hooks(Log):
    """Webhooks, and a sender in place of the network."""

    def __init__(self) -> None:
        super().__init__()
        self.hooks: dict[str, Hook] = {}
        self.mail: list[tuple[str, Mapping[str, str], bytes, int]] = []

    @act(
        3,
        what=st.sampled_from(["create", "create", "deliver", "deliver", "list", "delete"]),
        name=st.sampled_from(["w1", "w2"]),
        events=st.sampled_from([None, None, ["sealed"], ["diagnosed", "blocked"]]),
        only=st.sampled_from([None, None, ["a"]]),
        fails=st.lists(st.booleans(), max_size=4),
        dies=st.booleans(),
    )
    def webhook(
        self,
        what: str,
        name: str,
        events: list[str] | None,
        only: list[str] | None,
        fails: list[bool],
        dies: bool,
    ) -> None:
        if what == "create":
            self.create_hook(name, events, only)
        elif what == "deliver":
            self.deliver(fails, dies)
        elif what == "list":
            self.list_hooks(len(fails) + 1)
        else:
            self.delete_hook(name)

    def create_hook(self, name: str, events: list[str] | None, only: list[str] | None) -> None:
        webhook = self.id(name)
        asked = {"id": webhook, "url": f"https://plant.example/{webhook}"}
        asked |= {} if events is None else {"events": events}
        asked |= {} if only is None else {"rotors": [self.id(one) for one in only]}
        answer = self.send("POST", "/v1/webhooks", json=asked)
        there = self.hooks.get(name)
        if there is not None:
            assert answer.status_code == (201 if there.asked == asked else 409)
            assert answer.status_code == 409 or answer.json()["secret"] is None
            return
        assert answer.status_code == 201, answer.text
        with self.store.read() as tx:
            born = tx.connection.execute(text("SELECT max(id) FROM outbox")).scalar() or 0
        self.hooks[name] = Hook(asked, answer.json()["secret"], born)

    def delete_hook(self, name: str) -> None:
        answer = self.send("DELETE", f"/v1/webhooks/{self.id(name)}")
        assert answer.status_code == (404 if self.hooks.pop(name, None) is None else 200)

    def list_hooks(self, size: int) -> None:
        """Those that there are, each with as many deliveries as there were events for it."""
        own = f"{self.prefix}w"
        every = self.pages_of("/v1/webhooks", size)
        told = {one["id"]: one for one in every if one["id"].startswith(own)}
        assert told.keys() == {self.id(name) for name in self.hooks}
        for name, hook in self.hooks.items():
            path, expected = f"/v1/webhooks/{self.id(name)}", self.expected(hook)
            one = self.send("GET", path).json()
            assert one == told[self.id(name)]
            counts = one["deliveries"]
            assert counts["dead"] == 0
            assert counts["pending"] + counts["delivered"] == len(expected)
            assert counts["delivered"] <= len(hook.got)
            listed = self.pages_of(f"{path}/deliveries", size + 2)[::-1]
            assert [d["event"] for d in listed] == [note["type"] for note in expected]
            assert [d["rotor"] for d in listed] == [note["data"]["rotor"] for note in expected]
            assert hook.got.keys() >= {d["id"] for d in listed if d["status"] == "delivered"}
            self.retry_deliveries(path, listed[-1:])

    def retry_deliveries(self, path: str, some: list[Json]) -> None:
        """Only a dead one is sent again; the others stay as they are."""
        for one in some:
            answer = self.send("POST", f"{path}/deliveries/{one['id']}/retry")
            assert (answer.status_code, answer.json()) == (202, one)
        assert self.send("POST", f"{path}/deliveries/none/retry").status_code == 404

    def expected(self, hook: Hook) -> list[Json]:
        """What a webhook is to be told: the notes since it was made that it asked for."""
        query = select(t.outbox).where(t.outbox.c.id > hook.born).order_by(t.outbox.c.id)
        with self.store.read() as tx:
            notes = tx.connection.execute(query).all()
        found = []
        for note in notes:
            payload = json.loads(note.payload)
            kind = "sealed" if note.kind == "applied" else note.kind
            wanted = payload.pop("sealed", True) and kind in hook.asked.get("events", KINDS)
            if wanted and note.rotor_id in hook.asked.get("rotors", [note.rotor_id]):
                found.append({"type": kind, "data": {"rotor": note.rotor_id} | payload})
        return found

    @act(
        2,
        news=st.integers(0, 3),
        fails=st.lists(st.booleans(), max_size=4),
        dies=st.booleans(),
    )
    def deliver_news(self, news: int, fails: list[bool], dies: bool) -> None:
        """Versions are sealed one after the other, and then told."""
        for _ in range(news):
            self.post_fresh("a")
            self.drain()
        self.deliver(fails, dies)

    def deliver(self, fails: list[bool], dies: bool) -> None:
        """Some are refused, and rest; the sender may die between a sending and its note of it."""
        left = list(fails)

        def send(url: str, headers: Mapping[str, str], body: bytes, *given: Any) -> int:
            status = 503 if left and left.pop(0) else 204
            self.mail.append((url, headers, body, status))
            return status

        def dying(*given: Any, **named: Any) -> None:
            raise Crash

        patient = self.service.model_copy(update={"retry_base_s": 1000.0})
        sender = Deliverer(self.store.engine, patient, "sender", send)
        with pytest.MonkeyPatch.context() as patch, suppress(Crash):
            if dies:
                patch.setattr(sender, "record", dying)
            sender.drain()
        self.expire()
        self.read_mail()
        with transaction(self.store.engine, write=True) as connection:
            connection.execute(update(delivery).values(not_before=None))

    def read_mail(self) -> None:
        """Each message is for a webhook that is there, signed with its secret, and in its turn."""
        by_url = {hook.asked["url"]: hook for hook in self.hooks.values()}
        for url, headers, body, status in self.mail:
            if not url.rpartition("/")[2].startswith(f"{self.prefix}w"):
                continue
            assert url in by_url, "a webhook that was deleted is told nothing more"
            hook = by_url[url]
            told = read_webhook(hook.secret, headers, body)
            said = {name: told[name] for name in ("type", "data")}
            if status == 204:
                assert hook.got.setdefault(told["id"], said) == said
        self.mail.clear()
        for hook in self.hooks.values():
            expected = self.expected(hook)
            for rotor in {one["data"]["rotor"] for one in expected}:
                own, got = (
                    [one for one in those if one["data"]["rotor"] == rotor]
                    for those in (expected, hook.got.values())
                )
                assert own[: len(got)] == got
            assert len(hook.got) <= len(expected)

    def expire(self) -> None:
        super().expire()
        with transaction(self.store.engine, write=True) as connection:
            late = update(webhook).where(webhook.c.lease_until.is_not(None))
            connection.execute(late.values(lease_until=1.0))

    def teardown(self) -> None:
        super().teardown()
        if not hasattr(self, "model"):
            return
        self.deliver([], False)
        self.list_hooks(5)
        for name, hook in list(self.hooks.items()):
            assert len(hook.got) == len(self.expected(hook))
            self.delete_hook(name)
