"""The rules of the state machine for what lies beside the log and the workers.

A moment is asked for again and again, and tells of the same entries each time; webhooks are told
what the outbox holds, in order, signed, at least once, by a sender that fails and dies; exported
files come back under the same and another id, here and in another database; and diagnoses are
adopted and backed out.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import httpx
import pytest
from hypothesis import strategies as st
from sqlalchemy import select, text, update

from service.bootstrap import make_worker
from service.client import read_webhook
from service.errors import ConflictError
from service.handlers.rotors import view_rotor
from service.handlers.transfer import Imported, export_rotor, import_rotor
from service.moments import moment
from service.ports import Event
from service.store import tables as t
from service.store.engine import transaction
from service.store.log import read_entries
from service.store.unit_of_work import SqlStore
from service.worker.deliver import Deliverer
from tests.service.machine import Crash, Machine, act, asking, campaigns, rotors
from tests.service.modelled import Diagnosis, Json, Modelled

DAY = 86_400.0
EPISODES = (
    "ask",
    "ask, work, adopt",
    "ask, work, retract, adopt",
    "ask, work, adopt, back out",
    "adopt",
    "back out",
    "look",
)
PARTS = ((), ("posterior",), ("blades", "B1", "posterior"))


class Moments(Machine):
    """Reads as of a moment."""

    @act(
        3,
        rotor=rotors,
        days=st.sampled_from([None, None, 0, 0, -1, 1]),
        parts=st.sampled_from(PARTS),
    )
    def moment(self, rotor: str, days: int | None, parts: tuple[str, ...]) -> None:
        if days is None:
            self.ask_again(rotor, parts)
        else:
            self.ask_as_of_now(rotor, days)

    def ask_as_of_now(self, rotor: str, days: int) -> None:
        """Remember a moment; one before the rotor, or in the future, is none of its own."""
        time.sleep(0.003)
        at = moment(time.time() - 0.001 + days * DAY)
        model = self.model.get(rotor)
        if model is None or days:
            answer = self.send("GET", self.path(rotor), params={"at": at})
            assert answer.status_code == (404 if model is None else 422)
            return
        model.moments.append((at, len(model.entries)))
        self.as_of(rotor, model, at, len(model.entries), ())
        time.sleep(0.003)

    def ask_again(self, rotor: str, parts: tuple[str, ...]) -> None:
        """Each moment tells of the entries that had come by then, whatever came since."""
        model = self.model.get(rotor)
        for at, head in () if model is None else model.moments:
            assert model is not None
            self.as_of(rotor, model, at, head, parts)

    def as_of(
        self, rotor: str, model: Modelled, at: str, head: int, parts: tuple[str, ...]
    ) -> None:
        answer = self.send("GET", self.path(rotor, *parts), params={"at": at})
        told = answer.json()
        if answer.status_code == 200:
            basis = told["rests_on"] if parts else told["posterior"]
            assert basis["through_seq"] == head
            if not parts:
                self.compare(model, told)
            elif basis["sealed"]:
                digest = basis["state_digest"]
                assert model.sealed.setdefault(head, digest) == digest
            return
        now = self.send("GET", self.path(rotor)).json()
        first = now["version"] == 0 and now["head_seq"] == head
        waits = first or now["applied_seq"] < head
        assert answer.status_code == (409 if waits else 410), answer.text
        assert head not in {seen["through_seq"] for seen in model.versions.values()}
        assert not waits or f"wait_for={head}&" in told["detail"]


@dataclass
class Hook:
    """A webhook: as it was asked for, the newest note then, and what it was sent, by id."""

    asked: Json
    secret: str
    born: int
    got: dict[str, Json] = field(default_factory=dict)


class Hooks(Machine):
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
        told: dict[str, Json] = {}
        cursor: str | None = None
        while True:
            params = {"limit": str(size)} | ({} if cursor is None else {"cursor": cursor})
            page = self.send("GET", "/v1/webhooks", params=params).json()
            own = [one for one in page["items"] if one["id"].startswith(f"{self.prefix}w")]
            told |= {one["id"]: one for one in own}
            if (cursor := page["next"]) is None:
                break
        assert told.keys() == {self.id(name) for name in self.hooks}
        for name, hook in self.hooks.items():
            counts = told[self.id(name)]["deliveries"]
            assert counts["dead"] == 0
            assert counts["pending"] + counts["delivered"] == len(self.expected(hook))
            assert counts["delivered"] <= len(hook.got)

    def expected(self, hook: Hook) -> list[Json]:
        """What a webhook is to be told: the notes since it was made that it asked for."""
        query = select(t.outbox).where(t.outbox.c.id > hook.born).order_by(t.outbox.c.id)
        with self.store.read() as tx:
            notes = tx.connection.execute(query).all()
        found = []
        for note in notes:
            payload = json.loads(note.payload)
            kind = "sealed" if note.kind == "applied" else note.kind
            wanted = payload.pop("sealed", True) and kind in hook.asked.get("events", [kind])
            if wanted and note.rotor_id in hook.asked.get("rotors", [note.rotor_id]):
                found.append({"type": kind, "data": {"rotor": note.rotor_id} | payload})
        return found

    @act(fails=st.lists(st.booleans(), max_size=4), dies=st.booleans())
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
            connection.execute(update(t.delivery).values(not_before=None))

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
            late = update(t.webhook).where(t.webhook.c.lease_until.is_not(None))
            connection.execute(late.values(lease_until=1.0))

    def teardown(self) -> None:
        super().teardown()
        if not hasattr(self, "model"):
            return
        self.deliver([], False)
        for name, hook in list(self.hooks.items()):
            assert len(hook.got) == len(self.expected(hook))
            self.delete_hook(name)


class Journeys(Machine):
    """Files of rotors, and another database."""

    def __init__(self) -> None:
        super().__init__()
        self.abroad: dict[str, int] = {}  # the last entry of a rotor there, by its id

    @act(
        3, rotor=rotors, what=st.sampled_from(["export", "bring", "both"]), which=st.integers(0, 3)
    )
    def journey(self, rotor: str, what: str, which: int) -> None:
        if what != "bring":
            self.export(rotor, which > 1)
        if what != "export":
            self.bring(rotor, which, which % 2 == 1)

    def export(self, rotor: str, at_rest: bool) -> None:
        model = self.model.get(rotor)
        if model is None:
            return
        if at_rest:
            self.drain()
        path = self.folder / f"{self.id(rotor)}-{len(model.files)}.zip"
        manifest = export_rotor(self.store, self.id(rotor), path, "test")
        assert manifest["head_seq"] == len(model.entries)
        assert manifest["state"] is not None or not at_rest
        if manifest["state"] is not None:
            through, digest = (manifest["state"][name] for name in ("through_seq", "digest"))
            assert through == len(model.entries) or not at_rest
            assert model.sealed.setdefault(through, digest) == digest
        model.files.append((path, len(model.entries)))

    def bring(self, rotor: str, which: int, copy: bool) -> None:
        """Elsewhere it is the same rotor, or a copy under another id; here it is there already."""
        model = self.model.get(rotor)
        if model is None or not model.files:
            return
        path, head = model.files[which % len(model.files)]
        assert not import_rotor(self.store, self.science, path).new
        there = f"{self.id(rotor)}-copy" if copy else self.id(rotor)
        known = self.abroad.get(there)
        told: Imported | None = None
        with suppress(ConflictError):
            told = import_rotor(self.elsewhere, self.science, path, there)
        if known is not None and known < head:
            assert told is None
            return
        assert told is not None
        assert told.new == (known is None)
        assert told.rotor.origin == (self.id(rotor) if copy else None)
        if known is None:
            self.abroad[there] = head
            make_worker(self.elsewhere, self.science, self.service, "abroad").drain()
        self.compare_abroad(rotor, model, there)

    def compare_abroad(self, rotor: str, model: Modelled, there: str) -> None:
        head = self.abroad[there]
        assert entries(self.elsewhere, there) == entries(self.store, self.id(rotor))[:head]
        view = view_rotor(self.elsewhere, there)
        assert view.state is not None
        assert view.state.sealed
        assert view.state.through_seq == view.rotor.head_seq == head
        assert model.sealed.setdefault(head, view.state.digest) == view.state.digest
        effects = [(one["diagnosis"], one["value"]) for one in view.adopted.effects]
        assert effects == model.sheets(head)


def entries(store: SqlStore, rotor: str) -> list[Event]:
    with store.read() as tx:
        return read_entries(tx.connection, rotor, 0, 2**62)


class Adoptions(Machine):
    """Diagnoses, and what becomes of the effects that they name."""

    @act(
        3,
        rotor=rotors,
        what=st.sampled_from(EPISODES),
        campaign=campaigns,
        which=st.sampled_from([-1, -1, -2, 0]),
    )
    def diagnosis(self, rotor: str, what: str, campaign: str, which: int) -> None:
        steps: dict[str, Callable[[], None]] = {
            "ask": lambda: self.diagnose(rotor, campaign),
            "work": self.drain,
            "retract": lambda: self.retract(rotor, f"in-{campaign}"),
            "adopt": lambda: self.adopt(rotor, which),
            "back out": lambda: self.back_out(rotor, which),
            "look": lambda: self.look_at_diagnoses(rotor),
        }
        for step in what.split(", "):
            steps[step]()

    def diagnose(self, rotor: str, campaign: str) -> None:
        answer = self.send("POST", self.path(rotor, "diagnoses"), json=asking(campaign))
        model = self.model.get(rotor)
        if model is None:
            assert answer.status_code == 404
            return
        assert answer.status_code == 202, answer.text
        found, head = answer.json()["diagnosis"]["id"], len(model.entries)
        waiting = {
            (one.campaign, one.through): one.id for one in model.diagnoses if one.status == "queued"
        }
        before = waiting.get((campaign, head))
        assert ("idempotent-replayed" in answer.headers) == (before is not None)
        assert before in (None, found)
        if before is None:
            model.diagnoses.append(Diagnosis(found, campaign, head))

    def drain(self, which: int = 0) -> None:
        super().drain(which)
        for model in self.model.values():
            for one in model.diagnoses:
                if one.status == "queued":
                    self.conclude(model, one)

    def conclude(self, model: Modelled, one: Diagnosis) -> None:
        counting = model.counting(one.through).values()
        one.status = "done" if counting else "failed"
        if counting:
            there = one.campaign in {campaign for _, campaign in model.sheets(one.through)}
            read = one.campaign in {reading.get("campaign") for reading in counting}
            one.verdict = "effect" if read and not there else "adequate"

    def look_at_diagnoses(self, rotor: str) -> None:
        model = self.model.get(rotor)
        if model is None:
            return
        told = self.send("GET", self.path(rotor, "diagnoses")).json()["items"]
        found = {(one["id"], one["status"], one["verdict"]) for one in told}
        assert found == {(one.id, one.status, one.verdict) for one in model.diagnoses}
        history = self.send("GET", self.path(rotor, "adoptions")).json()["items"]
        kinds = ("adoption", "back-out")
        assert [(one["seq"], one["what"], one["diagnosis"]) for one in history] == [
            (seq, name.partition("/")[0], content["diagnosis"])
            for seq, (name, content) in enumerate(model.entries, 1)
            if name.partition("/")[0] in kinds
        ]

    def adopt(self, rotor: str, which: int) -> None:
        model, one = self.chosen(rotor, which)
        answer = self.change("POST", rotor, one)
        if model is None or one is None:
            assert answer.status_code == 404
            return
        if one.id in [found for found, _ in model.sheets()]:
            self.told_again(model, one, answer)
        elif self.adoptable(model, one):
            self.appended(model, "adoption", one, answer)
        else:
            assert answer.status_code == 409, answer.text

    @staticmethod
    def adoptable(model: Modelled, one: Diagnosis) -> bool:
        """It names an effect, of the model that the rotor has, and each of its readings counts."""
        then, now = (
            [campaign for _, campaign in model.sheets(through)] for through in (one.through, None)
        )
        stands = model.counting(one.through).keys() <= model.counting().keys()
        return one.verdict == "effect" and then == now and stands

    def back_out(self, rotor: str, which: int) -> None:
        """Of those that were adopted before, if any were."""
        model, one = self.chosen(rotor, which)
        if model is not None and one is not None:
            known = [found for found in model.diagnoses if self.last_of(model, found)]
            one = known[which % len(known)] if known else one
        answer = self.change("DELETE", rotor, one)
        if model is None or one is None or not self.last_of(model, one):
            assert answer.status_code == 404
            return
        sheets = [found for found, _ in model.sheets()]
        if one.id not in sheets:
            self.told_again(model, one, answer)
        elif sheets[-1] == one.id:
            self.appended(model, "back-out", one, answer)
        else:
            assert answer.status_code == 409, answer.text

    def chosen(self, rotor: str, which: int) -> tuple[Modelled | None, Diagnosis | None]:
        model = self.model.get(rotor)
        if model is None or not model.diagnoses:
            return model, None
        return model, model.diagnoses[which % len(model.diagnoses)]

    def change(self, method: str, rotor: str, one: Diagnosis | None) -> httpx.Response:
        name = "0" if one is None else one.id
        return self.send(method, self.path(rotor, "diagnoses", name, "adoption"))

    def appended(self, model: Modelled, kind: str, one: Diagnosis, answer: httpx.Response) -> None:
        count = sum(name.startswith(("adoption/", "back-out/")) for name, _ in model.entries)
        content = {"diagnosis": one.id, "campaign": one.campaign}
        model.entries.append((f"{kind}/{count + 1}", content))
        assert answer.status_code == 202, answer.text
        assert answer.json()["head_seq"] == len(model.entries)
        assert "idempotent-replayed" not in answer.headers

    def told_again(self, model: Modelled, one: Diagnosis, answer: httpx.Response) -> None:
        assert answer.status_code == 202, answer.text
        assert "idempotent-replayed" in answer.headers
        assert answer.json()["adoption"]["seq"] == self.last_of(model, one)

    @staticmethod
    def last_of(model: Modelled, one: Diagnosis) -> int:
        """The last entry that adopted it or backed it out; 0: none."""
        own: Sequence[int] = [
            seq
            for seq, (name, content) in enumerate(model.entries, 1)
            if name.startswith(("adoption/", "back-out/")) and content["diagnosis"] == one.id
        ]
        return own[-1] if own else 0


class Whole(Moments, Hooks, Journeys, Adoptions):
    """All of the rules."""
