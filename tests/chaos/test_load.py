"""The study of load, short: `bladetwin study load` in full."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest

from service.studies.load import aims, backlog, demand, run, trend
from service.studies.load.crowd import Answered, Crowd
from service.studies.load.table import table
from tests.patience import PATIENCE_S

SEED = 20310504
HOUR = [10.0 * i for i in range(1, 361)]


def noise(spread: float) -> list[float]:
    chosen = random.Random(SEED)
    return [chosen.gauss(0.0, spread) for _ in HOUR]


def test_growth_is_told_with_its_slope_and_outliers_do_not_hide_it() -> None:
    course = [200.0 + 36.0 * at / 3600 + off for at, off in zip(HOUR, noise(2.0), strict=True)]
    course[40] = course[200] = 900.0
    course[300] = 0.0
    found = trend.slope(HOUR, course)
    assert found["verdict"] == "grows"
    assert abs(found["per_hour"] - 36.0) < 1.0
    assert found["interval"][0] < 36.0 < found["interval"][1]


@pytest.mark.parametrize("per_hour", [0.0, -40.0, 1.5])
def test_what_does_not_grow_or_hardly_is_flat(per_hour: float) -> None:
    course = [200.0 + per_hour * at / 3600 + o for at, o in zip(HOUR, noise(2.0), strict=True)]
    assert trend.slope(HOUR, course)["verdict"] == "flat"


def test_caches_that_fill_are_no_growth_and_minutes_are_too_short() -> None:
    course = [min(300.0, 100.0 + at / 4) for at in HOUR]
    assert trend.slope(HOUR, course)["verdict"] == "flat"
    assert trend.slope(HOUR[:40], course[:40])["verdict"] == "too short to tell"
    assert trend.slope(HOUR, [None] * len(HOUR)) == {"verdict": "too short to tell"}


def test_what_is_asked_is_a_function_of_the_seed_at_the_rate_asked_for() -> None:
    first, again = (list(demand.reads(40.0, 100.0, 7, 3, SEED)) for _ in range(2))
    assert first == again
    assert first != list(demand.reads(40.0, 100.0, 7, 3, SEED + 1))
    assert abs(len(first) - 4000) < 4 * 4000**0.5
    share = sum(one.kind == "prediction" for one in first) / len(first)
    assert abs(share - 0.4) < 4 * (0.24 / len(first)) ** 0.5
    ids = [one.body["id"] for one in demand.posts(30.0, 50.0, 7, 3, SEED) if one.body]
    assert len(set(ids)) == len(ids) > 1300
    assert list(demand.posts(0.0, 50.0, 7, 3, SEED)) == []


class Slow(BaseHTTPRequestHandler):
    """Answers one request after the other, each after 0.2 s."""

    def do_GET(self) -> None:
        time.sleep(0.2)
        self.send_response(200)
        self.send_header("content-length", "0")
        self.end_headers()

    def log_message(self, *given: Any) -> None:
        """Nothing on the terminal."""


@pytest.fixture
def slow() -> Iterator[str]:
    server = HTTPServer(("127.0.0.1", 0), Slow)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_latency_counts_from_when_the_request_was_due(slow: str) -> None:
    """Three requests due at once, one thread: the last has waited for the two before it."""
    asked = [demand.Request(0.0, "rotor", "/x") for _ in range(3)]
    crowd = Crowd(slow, iter(asked), 1, time.monotonic())
    while crowd.busy:
        time.sleep(0.02)
    took = sorted(one.took_s for one in crowd.taken())
    assert took[0] >= 0.2
    assert took[1] >= 0.4
    assert took[2] >= 0.6


def test_percentiles_are_of_what_was_answered_well_and_the_rest_is_named() -> None:
    answered = [Answered(0.0, 0.001 * i, 0.0, "post", 202) for i in range(1, 201)]
    answered += [Answered(0.0, 9.0, 0.0, "post", 503, "database-away: full")] * 3
    told = trend.summary(answered)
    assert (told["posts"]["p50"], told["posts"]["p99"], told["posts"]["max"]) == (100, 198, 200)
    assert (told["posts"]["answered"], told["posts"]["good"]) == (203, 200)
    assert told["not_good"] == {"post: 503 database-away: full": 3}
    assert told["reads"]["p99"] is None


def plan(**given: Any) -> run.Plan:
    facts: dict[str, Any] = {
        "minutes": 0.1,
        "rate": 12.0,
        "reads": 24.0,
        "rotors": 4,
        "blades": 5,
        "workers": 1,
        "api_processes": 1,
        "science": "fake",
        "particles": 64,
        "window_s": 1.5,
        "seed": SEED,
    }
    return run.Plan(**facts | given)


def test_under_load_everything_is_answered_and_applied(database_url: str, tmp_path: Path) -> None:
    told = run.loaded(plan(), database_url, tmp_path, tmp_path / "log", lambda done: None)
    assert told["not_good"] == {}
    assert told["posted"] == told["applied"] == told["posts"]["answered"] > 40
    assert told["reads"]["good"] == told["reads"]["answered"] > 90
    assert aims.faults(told) == []
    assert not told["locked"]
    for sample in told["samples"][:-1]:
        assert {"api", "apply 1", "seal 1"} <= set(sample["memory_mb"])
        assert all(mb > 20 for mb in sample["memory_mb"].values())
        assert 0.1 < sample["yardstick_ms"] < 1e3 * PATIENCE_S
        assert sum(sample["machine"].values()) == pytest.approx(1.0, abs=1e-3)
        assert sample["machine"]["used"] > 0.0
    shown = table({"machine": {"processors": 2}, **asdict(plan())}, {"here": told | {"faults": []}})
    assert f"On here: {told['posted']} posted, {told['applied']} applied" in shown
    assert "A fixed piece of Python took " in shown
    assert "of the processors' time was used, " in shown


class Late(Crowd):
    """Answers that are handed out only once nothing more is asked."""

    def taken(self) -> list[Answered]:
        return super().taken() if self._stop.is_set() else []


def test_what_is_answered_after_the_last_sample_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "Crowd", Late)
    url = f"sqlite:///{tmp_path / 'late.db'}"
    told = run.loaded(plan(minutes=0.02), url, tmp_path, tmp_path / "log", lambda done: None)
    assert told["posted"] == told["applied"] > 5


def growing(median: float, per_hour: float) -> dict[str, Any]:
    return {"verdict": "grows", "median": median, "interval": [0.5 * per_hour, per_hour]}


SOUND: dict[str, Any] = {
    "posted": 10, "applied": 10, "not_good": {}, "locked": False,
    "trends": {"memory of api [MiB]": {"verdict": "flat"}},
    "posts": {"p99": 249.0}, "reads": {"p99": 100.0},
}  # fmt: skip
ASKED = {"posts": 250.0, "reads": 100.0}


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        ({"applied": 9}, "10 readings were acknowledged and 9 applied"),
        ({"not_good": {"post: 500 internal-error": 1}}, "1 × post: 500 internal-error"),
        ({"locked": True}, "a database was locked"),
        (
            {"trends": {"memory of api [MiB]": {"verdict": "grows"}}},
            "memory of api [MiB] grows",
        ),
        (
            {"trends": {"backlog [entries]": {"verdict": "grows"}}},
            "backlog [entries] grows",
        ),
        (
            {"trends": {"oldest entry [s]": growing(0.2, 0.08)}},
            "oldest entry [s] grows, and comes to 1 within 10 h of this load",
        ),
        (
            {"trends": {"p99 of reads [ms]": growing(50.0, 5.0)}},
            "p99 of reads [ms] grows, and comes to 100 within 10 h of this load",
        ),
        ({"posts": {"p99": 250.1}}, "p99 of posts is 250.1 ms, asked for 250 ms at most"),
        ({"reads": {"p99": 101.0}}, "p99 of reads is 101 ms, asked for 100 ms at most"),
    ],
)
def test_what_is_lost_refused_locked_growing_or_slow_is_told(
    spoilt: dict[str, Any], said: str
) -> None:
    """Negative controls."""
    assert aims.faults(SOUND, ASKED) == []
    assert aims.faults(SOUND | spoilt, ASKED) == [said]


def test_a_latency_that_stays_below_what_is_asked_for_a_rotor_s_life_may_grow() -> None:
    slow = SOUND | {"trends": {"oldest entry [s]": growing(0.02, 0.05)}}
    assert aims.faults(slow, ASKED) == []


def test_a_latency_without_an_aim_or_without_an_answer_is_not_judged() -> None:
    slow = SOUND | {"posts": {"p99": 9000.0}}
    assert aims.faults(slow, {"reads": 100.0}) == []
    assert aims.faults(SOUND | {"reads": {"p99": None}}, ASKED) == []


def test_a_backlog_is_worked_off_by_two_workers(database_url: str, tmp_path: Path) -> None:
    told = backlog.worked_off(plan(rotors=6), database_url, 2, 60, tmp_path / "log")
    assert (told["workers"], told["entries"]) == (2, 60)
    assert told["entries_per_s"] > 0
