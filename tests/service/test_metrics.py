"""The metrics are true, well-formed, and of a bounded number of series."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import text, true

from core.observation import Inspection
from service.bootstrap import make_worker
from service.errors import StoreAwayError
from service.fake import FakeScience, FakeState
from service.handlers.adoptions import adopt, back_out
from service.handlers.diagnoses import request_diagnosis
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.prometheus import Counter, Histogram, sample
from service.settings import Settings
from service.store.engine import transaction
from service.store.unit_of_work import SqlStore
from service.worker import claiming
from service.worker import lease as leases
from service.worker.loop import Worker
from tests.service.adopting import Offsets

Make = Callable[..., Inspection]
Post = Callable[..., int]
Series = dict[tuple[str, tuple[tuple[str, str], ...]], float]
NAME = r"[a-zA-Z_:][a-zA-Z0-9_:]*"
LABEL = r'([a-zA-Z_][a-zA-Z0-9_]*)="((?:[^"\\\n]|\\["\\n])*)"'
SAMPLE = re.compile(rf"({NAME})(?:\{{((?:{LABEL})(?:,{LABEL})*)\}})? (\S+)")


def parse(page: str) -> Series:
    """The samples of a page; AssertionError where the format is broken."""
    assert page.endswith("\n")
    kinds: dict[str, str] = {}
    found: Series = {}
    helped = ""
    for line in page.splitlines():
        if line.startswith("# HELP "):
            helped = line.split(" ", 3)[2]
            assert helped not in kinds, f"{helped} comes twice"
        elif line.startswith("# TYPE "):
            _, _, name, kind = line.split(" ")
            assert name == helped, f"{name} has no HELP before its TYPE"
            assert kind in ("counter", "gauge", "histogram")
            assert (kind == "counter") == name.endswith("_total")
            kinds[name] = kind
        else:
            match = SAMPLE.fullmatch(line)
            assert match, f"no sample: {line!r}"
            name, inside, value = match[1], match[2] or "", line.rpartition(" ")[2]
            base = re.sub(r"_(bucket|sum|count)$", "", name)
            assert helped in (name, base if kinds.get(base) == "histogram" else name)
            key = (name, tuple(sorted(re.findall(LABEL, inside))))
            assert key not in found, f"{line!r} comes twice"
            found[key] = math.inf if value == "+Inf" else float(value)
    for (name, labels), value in found.items():
        if name.endswith("_bucket") and dict(labels)["le"] == "+Inf":
            rest = tuple(one for one in labels if one[0] != "le")
            assert found[name.replace("_bucket", "_count"), rest] == value
    return found


def read(api: httpx.Client) -> Series:
    answer = api.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    return parse(answer.text)


def gauge(found: Series, name: str) -> float:
    return found[f"bladetwin_{name}", ()]


class Poor(FakeScience):
    """Carried by a quarter of its nodes, and provisional first."""

    def update(self, *args: Any, **given: Any) -> FakeState:
        state = super().update(*args, **given)
        health = state.meta["health"] | {"ess_ratio": 0.25}
        return replace(state, meta={**state.meta, "health": health})


def test_backlog_age_and_counts_are_those_of_the_tables(
    api: httpx.Client,
    store: SqlStore,
    settings: Settings,
    worker: Worker,
    reading: Make,
    post: Post,
) -> None:
    empty = read(api)
    assert gauge(empty, "database_up") == 1
    assert (gauge(empty, "rotors"), gauge(empty, "backlog_entries")) == (0, 0)
    assert gauge(empty, "oldest_entry_seconds") == 0
    assert ("bladetwin_least_ess_ratio", ()) not in empty, "nothing says one"
    for name in ("r1", "r2"):
        create_rotor(store, name, "rotor-blade", [BladeRecord("B1")], 64, 7)
    worker.drain()
    post("r1", reading("a"), reading("b"))
    post("r2", reading("a"))
    with transaction(store.engine, write=True) as connection:
        older = text("UPDATE event SET received_at = received_at - 100 WHERE seq = 2")
        connection.execute(older)
    behind = read(api)
    assert gauge(behind, "backlog_entries") == 3
    assert gauge(behind, "dirty_rotors") == 2
    assert gauge(behind, "oldest_entry_seconds") < 60, "the oldest by place, which is applied next"
    poor = make_worker(store, Poor(provisional=True), settings, "poor").updater
    poor.role = "apply"
    assert poor.run_once()
    assert poor.run_once()
    between = read(api)
    assert gauge(between, "backlog_entries") == 0
    assert gauge(between, "entries_applied_total") == 3
    assert gauge(between, "provisional_rotors") == 2
    assert gauge(between, "least_ess_ratio") == 0.25
    assert gauge(between, "versions_total") - gauge(between, "versions_sealed_total") == 2
    worker.drain()
    after = read(api)
    assert (gauge(after, "dirty_rotors"), gauge(after, "provisional_rotors")) == (0, 0)
    assert gauge(after, "versions_sealed_total") == 4, "two priors, two sealings"
    assert gauge(after, "least_ess_ratio") == 1.0


def test_a_blocked_rotor_keeps_its_backlog_and_its_age(
    api: httpx.Client, store: SqlStore, worker: Worker, rotor: str, reading: Make, post: Post
) -> None:
    worker.drain()
    post(rotor, reading("a"))
    with transaction(store.engine, write=True) as connection:
        connection.execute(text("UPDATE event SET received_at = received_at - 500"))
        connection.execute(text("UPDATE cursor SET blocked = (1 = 1)"))
    found = read(api)
    assert (gauge(found, "blocked_rotors"), gauge(found, "backlog_entries")) == (1, 1)
    assert 499 < gauge(found, "oldest_entry_seconds") < 600


def taken_over(store: SqlStore, api: httpx.Client) -> list[float]:
    """Takeovers after a claim, a claim of a lease that ran out, and one of a released rotor."""
    engine = store.engine
    counts = []
    assert claiming.claim(engine, "first", 60.0) is not None
    counts.append(gauge(read(api), "takeovers_total"))
    with transaction(engine, write=True) as connection:
        connection.execute(text("UPDATE cursor SET lease_until = 1.0"))
    assert claiming.claim(engine, "second", 60.0) is not None
    counts.append(gauge(read(api), "takeovers_total"))
    assert leases.release(engine, "second") == 1
    assert claiming.claim(engine, "third", 60.0) is not None
    counts.append(gauge(read(api), "takeovers_total"))
    return counts


@pytest.mark.usefixtures("rotor")
def test_only_a_lease_that_ran_out_is_a_takeover(api: httpx.Client, store: SqlStore) -> None:
    assert taken_over(store, api) == [0, 1, 1]


@pytest.mark.usefixtures("rotor")
def test_a_claim_that_counts_every_lease_is_noticed(
    api: httpx.Client, store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(claiming, "ran_out", lambda lease_s: true())
    assert taken_over(store, api) != [0, 1, 1], "mutant"


LOOP = ("diagnoses_done", "diagnoses_failed", "adoptions", "back_outs")


def test_what_the_loop_did_is_counted(
    api: httpx.Client,
    store: SqlStore,
    settings: Settings,
    worker: Worker,
    post: Post,
    reading: Make,
) -> None:
    """A diagnosis of nothing fails; what nobody finished is counted nowhere."""
    science = Offsets()
    diagnoser = make_worker(store, science, settings, "d", "diagnose")

    def ask(rotor: str) -> str:
        job, _ = request_diagnosis(store, science, rotor, (), compare=True, horizon_h=None)
        diagnoser.drain()
        return job.id

    def counted() -> list[float]:
        found = read(api)
        return [gauge(found, f"{name}_total") for name in LOOP]

    for name in ("r1", "r2"):
        create_rotor(store, name, "rotor-blade", [BladeRecord(b) for b in ("B1", "B2")], 64, 7)
    ask("r1")
    assert counted() == [0, 1, 0, 0]
    hours = {"c1": 1e4, "c2": 2e4, "c3": 3e4}
    for name in ("r1", "r2"):
        post(name, *(
            reading(f"{b}-{c}", blade=b, time_h=h, campaign=c, value=h / 1e5 + 0.3 * (c == "c2"))
            for b in ("B1", "B2") for c, h in hours.items()
        ))  # fmt: skip
    found = {name: ask(name) for name in ("r1", "r2")}
    for name in found:
        adopt(store, science, name, found[name])
    assert counted() == [2, 1, 2, 0]
    back_out(store, science, "r2", found["r2"])
    back_out(store, science, "r2", found["r2"])  # already: nothing happens
    assert counted() == [2, 1, 2, 1]
    adopt(store, science, "r2", found["r2"])
    assert counted() == [2, 1, 3, 1], "counters only rise"


def count(found: Series, route: str, status: str, method: str = "GET") -> float:
    labels = (("method", method), ("route", route), ("status", status))
    return found.get(("bladetwin_http_requests_total", labels), 0.0)


def test_requests_are_counted_by_the_route_s_template_and_status(
    api: httpx.Client, worker: Worker, rotor: str
) -> None:
    worker.drain()
    for name in ("r1", "r1", "nobody", "nobody-else"):
        api.get(f"/v1/rotors/{name}")
    for path in ("/no/such/path", "/another", "/v1/rotors/r1/nothing"):
        api.get(path)
    api.request("PROPFIND", "/v1/rotors/r1")
    api.post("/v1/rotors", json={})
    api.get("/v1/rotors/r1/blades/B1/prediction")
    found = read(api)
    assert count(found, "/v1/rotors/{r}", "200") == 2
    assert count(found, "/v1/rotors/{r}", "404") == 2
    assert count(found, "none", "404") == 3
    assert count(found, "/v1/rotors", "422", "POST") == 1
    assert count(found, "/v1/rotors/{r}/blades/{b}/prediction", "200") == 1
    routes = {dict(labels)["route"] for (name, labels) in found if "requests_total" in name}
    assert not any("r1" in route or "nobody" in route for route in routes)
    methods = {dict(labels)["method"] for (name, labels) in found if "requests_total" in name}
    assert methods == {"GET", "POST", "other"}
    labels = (("method", "GET"), ("route", "/v1/rotors/{r}"))
    assert found["bladetwin_http_request_seconds_count", labels] == 4
    assert 0 < found["bladetwin_http_request_seconds_sum", labels] < 60


def test_an_open_stream_is_a_gauge_and_not_an_hour_of_latency(
    api: httpx.Client, worker: Worker, rotor: str
) -> None:
    worker.drain()
    with api.stream("GET", "/v1/rotors/r1/events") as answer:
        lines = answer.iter_lines()
        assert next(lines).startswith("retry:")
        found = read(api)
        assert gauge(found, "event_streams") == 1
        assert count(found, "/v1/rotors/{r}/events", "200") == 1


def test_without_the_database_the_page_still_comes(
    api: httpx.Client, store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def away(self: SqlStore) -> Any:
        raise StoreAwayError("gone")

    monkeypatch.setattr(SqlStore, "read", away)
    found = read(api)
    assert gauge(found, "database_up") == 0
    assert ("bladetwin_backlog_entries", ()) not in found


def test_a_value_on_a_bound_belongs_to_its_bucket_and_buckets_are_cumulative() -> None:
    made = Histogram("h", "What it is.", ("route",), (0.1, 1.0))
    for value in (0.05, 0.1, 0.5, 7.0):
        made.observe(("a",), value)
    found = parse("\n".join(made.lines()) + "\n")
    named = [(dict(labels), value) for (_, labels), value in found.items()]
    buckets = {labels["le"]: value for labels, value in named if "le" in labels}
    assert buckets == {"0.1": 2, "1": 3, "+Inf": 4}
    assert found["h_sum", (("route", "a"),)] == pytest.approx(7.65)


def test_labels_that_hold_anything_are_escaped() -> None:
    made = Counter("c_total", "What it is.", ("route",))
    made.count(('a"b\\c\nd',))
    assert len(parse("\n".join(made.lines()) + "\n")) == 1


@pytest.mark.parametrize(
    "broken",
    [
        'c_total{route="a"b"} 1\n',
        "# TYPE c_total counter\nc_total 1\n",
        "# HELP c x\n# TYPE c counter\nc 1\n",
        "# HELP c_total x\n# TYPE c_total counter\nc_total 1\nc_total 2\n",
        "# HELP c_total x\n# TYPE c_total counter\nc_total one\n",
        "c_total 1",
    ],
)
def test_the_parser_notices_a_broken_page(broken: str) -> None:
    with pytest.raises((AssertionError, ValueError)):
        parse(broken)


def test_a_sample_without_labels_has_no_braces() -> None:
    assert sample("a", {}, 0.5) == "a 0.5"


DASHBOARD = Path(__file__).parents[2] / "docker" / "grafana" / "bladetwin.json"


def test_the_dashboard_asks_for_metrics_that_exist_and_for_every_one_of_them(
    api: httpx.Client, worker: Worker, rotor: str
) -> None:
    worker.drain()
    api.get("/healthz")
    served = {re.sub(r"_seconds_(sum|count)$", "_seconds_bucket", name) for name, _ in read(api)}
    panels = json.loads(DASHBOARD.read_text())["panels"]
    asked = " ".join(target["expr"] for panel in panels for target in panel["targets"])
    assert set(re.findall(r"bladetwin_\w+", asked)) == served
    places = [panel["gridPos"] for panel in panels]
    cells = [(x, y) for p in places for x in range(p["x"], p["x"] + p["w"])
             for y in range(p["y"], p["y"] + p["h"])]  # fmt: skip
    assert len(cells) == len(set(cells)), "panels overlap"
    assert len({panel["id"] for panel in panels}) == len(panels)
