"""The kept study of adaptive designs says what its curves and the README beside it say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from core.validation.adaptive import Study
from core.validation.adaptive_counts import Point, ratios, summary
from tests.claims.words import WORDS

ROOT = Path(__file__).parent.parent.parent


@pytest.fixture(scope="module")
def kept() -> Any:
    return json.loads((ROOT / "tests/claims/results/adaptive/result.json").read_text())


def test_the_ratios_are_those_of_the_curves(kept: Any) -> None:
    rows = []
    for row in kept["seeds"]:
        shots, curve, control = (
            [Point(**p) for p in row[kind]] for kind in ("one_shot", "adaptive", "uniform")
        )
        assert [one.n for one in shots] == list(Study().sizes) == kept["study"]["sizes"]
        assert curve[0].rms == pytest.approx(shots[0].rms, rel=1e-3), "they begin alike"
        rows.append({"ratios": ratios(curve, shots), "uniform_ratios": ratios(control, shots)})
        assert rows[-1]["ratios"]["ratio"] == pytest.approx(row["ratios"]["ratio"], rel=1e-12)
    assert json.loads(json.dumps(summary(rows))) == kept["summary"]


def test_adaptive_designs_need_at_most_seventy_percent_of_the_runs_over_five_seeds(
    kept: Any,
) -> None:
    told = kept["summary"]
    assert len(kept["seeds"]) == 5
    assert told["ratios"]["reached"] == 5, "no ratio is a bound"
    assert told["ratios"]["mean"] <= 0.70
    assert told["seeds_met"] == 4, "one of five is above"
    assert all(row["ratios"]["by_size"][-1]["ratio"] <= 0.70 for row in kept["seeds"])
    assert told["uniform_ratios"]["mean"] > 0.85, "the control, though its ratios are bounds"
    assert told["uniform_ratios"]["reached"] == 0


def test_the_readme_has_the_kept_figures(kept: Any) -> None:
    text = " ".join(WORDS.split())
    at = kept["summary"]["ratios"]["at_size"]
    assert f"needs {at['26']:.2f}, {at['40']:.2f} and {at['54']:.2f} of them" in text
    mean, sd = (kept["summary"]["ratios"][key] for key in ("mean", "sd"))
    assert f"{mean:.2f} on average (aim: 0.70; sd {sd:.2f})" in text
    low, high = kept["summary"]["ratios"]["range"]
    assert f"is {low:.2f} to {high:.2f}" in text
