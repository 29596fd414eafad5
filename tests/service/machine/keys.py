"""Keys are made and revoked: who may do what, who has done what, and what strangers learn.

What a key may do is said here in a few lines (`scope_of`, `beyond`), not read from the table of the
service.
"""

from __future__ import annotations

from hypothesis import strategies as st

from service.access import SCOPES
from service.api.scopes import RULES
from service.handlers.keys import revoke_key
from tests.service.machine.log import Log, readings
from tests.service.machine.steps import Key, act, rotors
from tests.service.modelled import Json

GUARDED = sorted(name for name, rule in RULES.items() if rule.scope != "open")
NAMES = {"{b}": "B1", "{i}": "i0", "{m}": "rotor-blade", "{id}": "none", "{d}": "none"}
NAMES |= {"{w}": "none"}
QUERIES = {"/life": {"limit": "0.3"}, "/field": {"quantity": "ceeq", "times": "8000"}}
PASSING = ("/events", "/metrics", "/operations")  # what they tell changes by itself
OWN = ("/v1/rotors", "/v1/audit")  # a key for some rotors sees those alone


def scope_of(method: str, path: str) -> str:
    """read: everything but who does what; ingest: readings; operate: all that changes else."""
    if method == "GET":
        return "operate" if path.startswith(("/v1/webhooks", "/v1/audit")) else "read"
    return "ingest" if "/inspections" in path else "operate"


def beyond(method: str, path: str) -> bool:
    """Of what names no rotor, what tells a key for some rotors nothing of the others."""
    told = ("/openapi.json", "/v1/models", "/v1/jobs/", "/v1/audit")
    return method == "GET" and (path.startswith(told) or path == "/v1/rotors")


def refusal(key: Key | None, method: str, path: str) -> int | None:
    """Status of the refusal; None: the key may."""
    if key is None or key.revoked:
        return 401
    if scope_of(method, path) not in key.scopes:
        return 403
    _, _, rotor = path.partition("/v1/rotors/")
    if not rotor:
        return None if key.only is None or beyond(method, path) else 403
    return None if key.only is None or rotor.partition("/")[0] in key.only else 404


class Keys(Log):
    """Clients with a key that may do some things, with one that was revoked, and with none."""

    def __init__(self) -> None:
        super().__init__()
        self.made: list[Key] = []
        self.stranger = b""

    @act(
        2,
        scopes=st.lists(st.sampled_from(SCOPES), min_size=1, unique=True),
        only=st.sampled_from([(), (), ("a",), ("b",)]),
        revokes=st.booleans(),
        which=st.integers(0, 9),
    )
    def make_key(self, scopes: list[str], only: tuple[str, ...], revokes: bool, which: int) -> None:
        self.made.append(self.new_key(scopes, [self.id(one) for one in only]))
        if revokes:
            key = self.made[which % len(self.made)]
            _, now = revoke_key(self.store, key.id)
            assert now != key.revoked
            key.revoked = True

    @act(
        6,
        route=st.sampled_from(GUARDED),
        rotor=rotors,
        which=st.integers(-1, 9),
        one=readings,
        forged=st.booleans(),
    )
    def ask(self, route: str, rotor: str, which: int, one: Json, forged: bool) -> None:
        """One of the keys, or none (`which` -1), asks for a route."""
        key = self.made[which % len(self.made)] if self.made and which >= 0 else None
        method, path = route.split(" ")
        for name, value in (NAMES | {"{r}": self.id(rotor)}).items():
            path = path.replace(name, value)
        status = refusal(key, method, path)
        if status == 401:
            self.turned_away(key, method, path, forged)
        elif status is not None:
            assert key is not None
            answer = self.send(method, path, key)
            assert answer.status_code == status, (route, key, answer.text)
        elif method == "GET":
            assert key is not None
            self.as_others(key, path)
        elif path.endswith("/inspections"):
            assert key is not None
            self.post_by(key, rotor, one)

    def turned_away(self, key: Key | None, method: str, path: str, forged: bool) -> None:
        """All who have no key are told the same, whether there is such a path or not."""
        token = self.key.token[:-4] + "0000" if key is None else key.token
        headers = {"Authorization": f"Bearer {token}"} if key is not None or forged else {}
        for asked in (path, "/v1/no/such/path"):
            answer = self.http.request(method, asked, headers=headers)
            assert answer.status_code == 401, (path, answer.text)
            self.stranger = self.stranger or answer.content
            assert answer.content == self.stranger

    def as_others(self, key: Key, path: str) -> None:
        """What a key may read, it reads as any other does."""
        asked = next((q for end, q in QUERIES.items() if path.endswith(end)), {})
        asked = {"quantity": "ceeq"} if path.endswith("/B1/field") else asked
        if path.endswith("/events"):
            rotor = path.split("/")[3].removeprefix(self.prefix)
            if rotor not in self.model:
                assert self.send("GET", path, key).status_code == 404
            return
        answers = [self.send("GET", path, by, params=asked) for by in (self.key, key)]
        assert answers[0].status_code == answers[1].status_code, path
        if path in OWN and key.only is not None:
            name = "rotor" if path == "/v1/audit" else "id"
            assert {one[name] for one in answers[1].json()["items"]} <= set(key.only)
        elif not path.endswith(PASSING) and answers[0].status_code == 200:
            assert answers[0].content == answers[1].content

    def post_by(self, key: Key, rotor: str, one: Json) -> None:
        """An Idempotency-Key is its owner's: another's with the same text is another."""
        own = sum(path.endswith("/inspections") for _, path, *_ in self.trails.get(key.id, []))
        header = {"Idempotency-Key": f"{self.prefix}-post-{own}"}
        self.posted(rotor, [one], key, json=one, headers=header)

    def teardown(self) -> None:
        super().teardown()
        if not hasattr(self, "model"):
            return
        self.make_key(["read"], ("a",), False, 0)
        for route, rotor in (("POST /v1/rotors", "a"), ("GET /v1/rotors/{r}", "b")):
            self.ask(route, rotor, len(self.made) - 1, {}, False)
        for key in (self.key, *self.made):
            rows = self.pages_of("/v1/audit", 200, key=key.id)[::-1]
            told = [(*row["what"].split(" ")[:1], row["path"], row["status"]) for row in rows]
            trail = self.trails.get(key.id, [])
            assert told == [row[:3] for row in trail]
            entries = [row["entries"] for row in rows]
            spans = [e and (e["first_seq"], e["last_seq"]) for e in entries]
            assert spans == [row[3] for row in trail]
