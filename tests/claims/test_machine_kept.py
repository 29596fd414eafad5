"""The kept long run of the state machine (`tests/service/test_machine.py`): over every route, and
what is said of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.claims.words import WORDS

HERE = Path(__file__).parent


@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
def test_the_long_run_went_over_every_route_without_a_failure(database: str) -> None:
    kept = json.loads((HERE / "results/machine" / f"{database}.json").read_text())
    assert (kept["sequences"], kept["steps"]) == (200, 40)
    assert sum(kept["answers"].values()) == kept["requests"]
    answers = [one.rpartition(" ") for one in kept["answers"]]
    assert {status for _, _, status in answers if status >= "500"} == set()
    assert {route for route, _, status in answers if status < "300"} >= {*kept["routes"]}
    assert len(kept["routes"]) > 60
    assert f"{kept['requests']:,}" in WORDS
    assert kept["commit"][:7] in WORDS
