"""The kept hours of load and pairs of workers say what the README beside them says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.claims.words import WORDS

HERE = Path(__file__).parent
KEPT = sorted((HERE / "results/load").glob("*/result.json"))
HOURS = [path for path in KEPT if json.loads(path.read_text())["minutes"] == 60]
POSTS, READS = 107_568, 361_015


def test_there_are_hours_of_both_databases() -> None:
    assert len(HOURS) >= 9
    kept = [json.loads(path.read_text()) for path in HOURS]
    assert {name for one in kept for name in one["databases"]} == {"sqlite", "postgresql"}


@pytest.mark.parametrize("path", HOURS, ids=lambda path: path.parent.name)
def test_an_hour_is_told_as_it_is_kept(path: Path) -> None:
    kept = json.loads(path.read_text())
    ((database, one),) = kept["databases"].items()
    gauges = [sample["gauges"] for sample in one["samples"]]
    entries = max(gauge["backlog_entries"] for gauge in gauges)
    oldest = max(gauge["oldest_entry_seconds"] for gauge in gauges)
    row = (
        f"| {kept['commit'][:7]}, {database} | {kept.get('api_processes', 1)} "
        f"| {one['posts']['p99']:.1f} | {one['reads']['p99']:.1f} "
        f"| {entries:.0f} / {oldest:.1f} |"
    )
    (said,) = [line for line in WORDS.splitlines() if line.startswith(row)]
    late = one["posts"]["p99"] > 250 or one["reads"]["p99"] > 100
    assert ("**failed**" in said) is late
    assert ("**holds, nothing grows**" in said) is kept["passed"]
    assert (one["posts"]["good"], one["reads"]["good"]) == (POSTS, READS)
    assert (one["posted"], one["applied"], one["locked"]) == (POSTS, POSTS, False)
    assert one["not_good"] == {}


def test_two_workers_are_as_much_faster_than_one_as_it_says() -> None:
    kept = json.loads((HERE / "results/load/pairs-4620221/result.json").read_text())
    gain = kept["databases"]["postgresql"]["gain"]
    assert sorted(gain["ratios"])[2] == gain["median"] >= 1.7
    said = ", ".join(f"{ratio:.2f}" for ratio in gain["ratios"])
    assert f"{gain['median']:.2f} times as fast in the middle\nof five pairs ({said};" in WORDS
