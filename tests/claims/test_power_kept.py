"""The kept alarms at two noises are told as they are: every set counted, and what is missed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.claims.words import WORDS

HERE = Path(__file__).parent
KEPT, LATER, TODAY = (
    json.loads((HERE / f"results/{name}/result.json").read_text())
    for name in ("effects-power", "effects-power-2", "effects-power-3")
)
ASKED = 0.90


@pytest.mark.parametrize("kept", [KEPT, LATER, TODAY], ids=["before", "later", "today"])
def test_alarms_are_told_as_they_are_kept(kept: dict[str, Any]) -> None:
    alarms = {}
    for condition in ("fouling", "worn lot", "clean"):
        own = [one for one in kept["sets"] if one["condition"] == condition]
        assert sorted(one["number"] for one in own) == list(range(24))
        assert not any("error" in one for one in own)
        assert all(one["alarm"] is (one["p"] <= 0.05) for one in own)
        alarms[condition] = sum(one["alarm"] for one in own)
    fouling, worn, clean = alarms.values()
    said = f"fouling {fouling} of 24, a worn lot {worn} of 24, clean sets {clean} of 24"
    assert said in WORDS
    assert max(fouling, worn) / 24 < ASKED
    assert clean / 24 <= 0.075
    assert str(kept["seed"]) in WORDS
    assert int(kept["commit"][:6], 16) == kept["seed"]


@pytest.mark.parametrize("kept", [KEPT, LATER, TODAY], ids=["before", "later", "today"])
def test_the_oracles_are_told(kept: dict[str, Any]) -> None:
    told = {name: rows[0] for name, rows in kept["possible"].items()}
    searched, alone = (
        [round(100 * told[name][what]) for name in ("fouling", "worn lot")]
        for what in ("searched", "alarm")
    )
    assert f"would notice {searched[0]} and {searched[1]} %" in WORDS
    assert f"looks for nothing else {alone[0]} and {alone[1]}." in WORDS


def test_alarms_at_other_sizes_are_told_and_no_set_is_lost() -> None:
    """Fouling and a worn lot where they are noticed; all others at one noise."""
    for name, sets, clean in (("effects-power-large", 12, 24), ("effects-power-small", 8, 8)):
        found = json.loads((HERE / "results" / name / "result.json").read_text())
        assert found["errors"] == 0
        assert str(found["seed"]) in WORDS
        assert int(found["commit"][:6], 16) == found["seed"]
        for condition, rows in found["curves"].items():
            own = [one for one in found["sets"] if one["condition"] == condition]
            assert len(own) == (clean if condition == "clean" else sets * len(rows))
            for row in rows:
                alarms = sum(one["alarm"] for one in own if one["size"] == row["size"])
                assert row["alarms"] == alarms / row["sets"]
                at = "clean" if condition == "clean" else f"{condition} {row['size']:g}"
                assert f"{at}: {alarms} of {row['sets']}" in WORDS


def test_the_whole_curve_is_told_as_it_is_kept() -> None:
    found = json.loads((HERE / "results/effects-power-curve/result.json").read_text())
    assert found["errors"] == 0
    assert int(found["commit"][:6], 16) == found["seed"]
    assert found["sizes"] == [0.5, 1.0, 1.5, 2.0, 3.0, 4.0]
    keys = {(one["condition"], one["size"], one["number"]) for one in found["sets"]}
    assert len(keys) == len(found["sets"]) == 48 + 8 * sum(map(len, found["possible"].values()))
    at_two = []
    for condition, best in found["possible"].items():
        searched = {row["size"]: f"{100 * row['searched']:.0f}" for row in best}
        cells = []
        for size in found["sizes"]:
            own = [o for o in found["sets"] if (o["condition"], o["size"]) == (condition, size)]
            assert len(own) in (0, 8)
            assert all(one["alarm"] is (one["p"] <= 0.05) for one in own)
            alarms = sum(one["alarm"] for one in own)
            cells.append(f"{alarms} ({searched[size]})" if own else "")
            at_two += [alarms] if size == 2.0 else []
        assert f"| {condition} | {' | '.join(cells)} |" in WORDS
    clean = [one for one in found["sets"] if one["condition"] == "clean"]
    assert f"of {len(clean)} clean sets {sum(one['alarm'] for one in clean)} alarms" in WORDS
    assert f"{sum(at_two)} of 64 are noticed, six of eight" in WORDS
    assert sum(n / 8 >= ASKED for n in at_two) == 6


def test_what_residuals_notice_by_themselves_is_told_as_it_is_kept() -> None:
    """Faults of sensors and hardly any physics: why a rotor may ask without an alarm."""
    found = json.loads((HERE / "results/effects-residuals/result.json").read_text())
    assert (found["by"], found["errors"]) == ("residuals", 0)
    assert int(found["commit"][:6], 16) == found["seed"]
    alarms = {}
    for condition, rows in found["curves"].items():
        own = [one for one in found["sets"] if one["condition"] == condition]
        assert sorted(one["number"] for one in own) == list(range(12))
        assert all(one["alarm"] is (one["p"] <= 0.05) is bool(one["groups"]) for one in own)
        alarms[condition] = sum(one["alarm"] for one in own)
        assert rows[0]["alarms"] == alarms[condition] / 12
    said = [f"{name} {alarms[name]} of 12" for name in ("campaign", "instrument", "gain", "step")]
    assert ", ".join(said) in WORDS
    assert f"tertiary {alarms['tertiary']} of 12" in WORDS
    assert alarms["wear"] == alarms["worn lot"] == alarms["fouling"] == alarms["clean"] == 0
    assert "wear, worn lot and fouling 0 of 12, clean 0 of 12" in WORDS
