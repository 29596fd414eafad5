"""Diagnoses are asked for, cancelled, adopted and backed out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import httpx
from hypothesis import strategies as st

from tests.service.machine.log import Log
from tests.service.machine.steps import act, asking, campaigns, rotors
from tests.service.modelled import Diagnosis, Modelled

EPISODES = (
    "ask",
    "ask, cancel",
    "ask, work, adopt",
    "ask, work, retract, adopt",
    "ask, work, adopt, work, look back",
    "ask, work, adopt, back out",
    "adopt",
    "back out",
    "cancel",
    "look",
)


class Adoptions(Log):
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
            "cancel": lambda: self.cancel(rotor, which),
            "look": lambda: self.look_at_diagnoses(rotor),
            "look back": lambda: self.look_back(rotor),
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

    def cancel(self, rotor: str, which: int) -> None:
        """One that waits is cancelled; one that has ended stays as it is."""
        model, one = self.chosen(rotor, which)
        path = self.path(rotor, "diagnoses", "none" if one is None else one.id)
        answer = self.send("DELETE", path)
        if model is None or one is None:
            assert answer.status_code == 404
            return
        one.status = "cancelled" if one.status == "queued" else one.status
        assert answer.json()["status"] == one.status
        again = self.send("GET", path)
        assert again.json() == answer.json()
        report = self.send("GET", f"{path}/report")
        assert report.status_code == (200 if one.status == "done" else 404)

    def look_at_diagnoses(self, rotor: str) -> None:
        model = self.model.get(rotor)
        if model is None:
            return
        told = self.pages_of(self.path(rotor, "diagnoses"), 3)
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

    def teardown(self) -> None:
        """What was adopted is backed out again, the last first; below lies the model as it was. Of
        two last diagnoses one is done, the other cancelled."""
        super().teardown()
        for rotor, model in getattr(self, "model", {}).items():
            while sheets := model.sheets():
                (one,) = [found for found in model.diagnoses if found.id == sheets[-1][0]]
                self.appended(model, "back-out", one, self.change("DELETE", rotor, one))
            self.diagnose(rotor, "c1")
            self.drain()
            self.cancel(rotor, -1)
            self.diagnose(rotor, "c2")
            self.cancel(rotor, -1)
            self.wait(rotor, 0)
            self.look_at_diagnoses(rotor)
