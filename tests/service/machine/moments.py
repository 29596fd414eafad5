"""A moment is asked for again and again, and tells of the same entries each time."""

from __future__ import annotations

import time

from hypothesis import strategies as st

from service.moments import moment
from tests.service.machine.log import Log
from tests.service.machine.steps import act, rotors
from tests.service.modelled import Modelled

DAY = 86_400.0
PARTS = ((), ("posterior",), ("blades", "B1", "posterior"))


class Moments(Log):
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
