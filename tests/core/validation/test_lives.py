"""The study of lives: truths that are followed, chances that are judged, and what is counted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from core.errors import BladetwinError, InputError
from core.model import rotor_blade
from core.observation import Inspection
from core.validation import lives, lives_table
from core.validation.simulate import shipped_rotors, simulate
from core.validation.variants import plan

Record = dict[str, Any]
BLADES = 20


def told(rotors: int, *, wrong: float = 1.0, shift: float = 0.0) -> list[Record]:
    """Records of one who knows all chances by the next outage, or whose probits are wrong."""
    found, rng = [], np.random.default_rng(21)
    for rotor in range(rotors):
        p = ndtr(rng.normal(0.0, 1.5, BLADES))
        pit = np.clip(rng.random(BLADES), 1e-9, 1 - 1e-9)
        said = ndtr(wrong * ndtri(p) + shift)
        limit = {
            "factor": 1.0,
            "limit": 0.3,
            "pit": ndtr(wrong * ndtri(pit) + shift).tolist(),
            "narrow": ndtr(lives.SHARP * ndtri(pit)).tolist(),
            "any": float(rng.random()),
            "independent": float(rng.random()),
            "worst": float(rng.random() ** 3),
            "passes": (rng.random(BLADES) < p).astype(int).tolist(),
        }
        limit |= {who: said.tolist() for who in lives_table.WHO}
        found.append({"rotor": rotor, "cluster": rotor, "seconds": 1.0, "limits": [limit]})
    return found


def test_true_chances_pass_and_wrong_ones_do_not() -> None:
    right = lives_table.summary(told(300))
    assert (right["passed"], right["outside_band"], right["failed"]) == (True, [], {})
    assert right["controls_caught"] == {"narrow": ["1 x"], "worst": ["1 x"]}
    for row in right["reliability"]["twin"]:
        own = np.sqrt(row["told"] * (1.0 - row["told"]) / row["blades"])
        assert abs(row["told"] - row["passed"]) < 4 * own, row
    sure = lives_table.summary(told(300, wrong=1.5))
    assert (sure["passed"], sure["outside_band"]) == (False, ["pit, 1 x"])
    late = lives_table.summary(told(300, shift=-0.3))
    assert not late["passed"]
    assert late["next_outage"]["twin"]["off"] < -lives_table.WITHIN


def test_rotors_that_fail_fail_the_study_and_too_few_claim_nothing() -> None:
    found = told(300)
    found[7] = {"rotor": 7, "cluster": 7, "seconds": 1.0, "error": "no nodes"}
    judged = lives_table.summary(found)
    assert (judged["passed"], judged["failed"]) == (False, {"7": "no nodes"})
    assert not lives_table.summary(told(3))["passed"]
    assert not lives_table.summary([found[7]])["passed"]


def test_decisions_are_counted() -> None:
    chances, passes = [0.04, 0.06, 0.5, 0.01, 0.9], [1, 0, 1, 0, 1]
    limit = {"factor": 1.0, "twin": chances, "passes": passes}
    found = [{"rotor": 0, "cluster": 0, "limits": [limit]}]
    one = lives_table.decisions(found, "twin")
    assert [one[k] for k in ("passing", "missed", "sound", "in_vain")] == [3, 1, 2, 1]
    assert one["brier"] == pytest.approx(np.mean((np.array(chances) - passes) ** 2), abs=1e-5)
    right = [p if bad else 1 - p for p, bad in zip(chances, passes, strict=True)]
    assert one["log_loss"] == pytest.approx(-np.mean(np.log(right)), abs=1e-4)
    rows = lives_table.reliability(found, "twin")
    assert [(r["from"], r["blades"], r["passed"]) for r in rows] == [
        (0.01, 2, 0.5), (0.05, 1, 0.0), (0.5, 1, 1.0), (0.8, 1, 1.0),
    ]  # fmt: skip


def test_the_error_of_a_share_is_between_rotors() -> None:
    """Of outcomes less chances, blades of one rotor together."""
    both = [([0.3, 0.3], [1, 1]), ([0.3, 0.4], [0, 0]), ([0.3], [0])]
    found = [
        {"cluster": k, "limits": [{"factor": 1.0, "twin": told, "passes": passes}]}
        for k, (told, passes) in enumerate(both)
    ]
    (row,) = lives_table.reliability(found, "twin")
    off = np.array([0.7, 0.7, -0.3, -0.4, -0.3])
    sums = [np.sum(off[:2] - off.mean()), np.sum(off[2:4] - off.mean()), off[4] - off.mean()]
    assert row["blades"] == 5
    assert row["error"] == pytest.approx(np.sqrt(np.sum(np.square(sums)) * 3 / 2) / 5, abs=1e-4)


def test_a_trend_is_least_squares_with_its_own_doubt() -> None:
    """Against the linear model at the exponent that was found, and the doubt by simulation."""
    hours = np.array([8e3, 16e3, 24e3])
    truth = np.outer(np.linspace(0.1, 0.3, 40), (hours / 32e3) ** 0.7)
    names = [f"b{k}" for k in range(40)]
    seen = truth + np.random.default_rng(20).normal(0.0, 0.002, truth.shape)
    made = [
        Inspection(f"{name}{t}", name, "y", t, [seen[k, i]])
        for k, name in enumerate(names)
        for i, t in enumerate(hours)
    ]
    mean, sd = lives.trend(made, names, 32e3)
    off = mean - np.linspace(0.1, 0.3, 40)
    assert 0.6 < np.sqrt(np.mean(off**2)) / np.sqrt(np.mean(sd**2)) < 1.5
    assert np.sqrt(np.mean(sd**2)) < 0.004


def test_finite_element_truths_are_the_runs_and_have_the_mesh_s_error_where_it_is_declared() -> (
    None
):
    model = rotor_blade()
    sound, off = (
        lives.curves_of(model, plan(name), simulate(model, plan(name), 3, 5), 3, 5)
        for name in ("fe", "fe-nu")
    )
    hours = lives.hours_of(model, plan("fe"))
    runs = shipped_rotors()
    k = int(np.searchsorted(hours, 32_000.0))
    assert sound[:, k] == pytest.approx(runs.at("elongation", 3, 32_000.0))
    share = off[:, 1:] / sound[:, 1:] - 1.0
    nu = model.network.quantity("elongation").numerical
    assert np.ptp(share, axis=1).max() < 1e-9, "one error of a blade at all hours"
    assert 0.3 * nu < share.std() < 3 * nu


def test_simulated_truths_go_through_their_own_held_out_values() -> None:
    """The same inputs: a held-out value has another error of the surrogate's, and no more."""
    model, variant = rotor_blade(), plan("rotor-20")
    made = simulate(model, variant, 2, 9)
    truth = lives.curves_of(model, variant, made, 2, 9)
    k = int(np.searchsorted(lives.hours_of(model, variant), variant.held_out_h))
    held = np.array([h.model for h in made.held])
    assert np.abs(truth[:, k] / held - 1.0).max() < 0.03
    assert np.abs(truth[:, k] / held - 1.0).max() > 1e-5


def test_a_short_study_keeps_every_rotor_and_goes_on_where_it_was(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = plan("rotor-20", blades=3)
    options: Any = {"seed": 3, "particles": 500, "folder": tmp_path}
    found = lives.run(small, rotors=2, **options)
    assert [r["rotor"] for r in found] == [0, 1]
    model = rotor_blade()
    hours = lives.hours_of(model, small)
    due = int(np.searchsorted(hours, small.held_out_h))
    for record in found:
        made = simulate(model, small, record["rotor"], 3)
        truth = lives.curves_of(model, small, made, record["rotor"], 3)[:, due]
        for one in record["limits"]:
            assert one["passes"] == (truth >= one["limit"]).astype(int).tolist()
        assert [one["factor"] for one in record["limits"]] == list(lives.FACTORS)
        for one in record["limits"]:
            assert len(one["pit"]) == len(one["passes"]) == 3
            assert 0.0 <= one["any"] <= 1.0
            assert one["independent"] >= one["worst"] - 1e-9
    begun = []

    def failing(*given: Any, **_: Any) -> None:
        begun.append(given)
        raise BladetwinError("no nodes")

    monkeypatch.setattr(lives, "update", failing)
    more = lives.run(small, rotors=3, **options)
    assert more[:2] == found
    assert (len(begun), more[2]["error"]) == (1, "no nodes")


def test_kinds_whose_truths_have_no_life_of_their_own_are_refused() -> None:
    for name in ("mixed", "eight-shared", "coating-at-bounds", "six-locals"):
        with pytest.raises(InputError, match="has no lives to be told"):
            lives.run(plan(name), rotors=2, seed=1)
    with pytest.raises(InputError, match="too few"):
        lives.run(plan("rotor-20"), rotors=1, seed=1)
