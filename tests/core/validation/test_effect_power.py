"""The study of power: what is planned, how alarms are counted, and a large effect against none."""

from __future__ import annotations

from pathlib import Path

import pytest

from core.errors import InputError
from core.validation import effect_oracle, effect_plans, effect_sets
from core.validation import effect_power as study
from service.studies.power import power_plot
from tests.core.validation.fewer import of_blades


def test_every_size_has_its_sets_and_as_many_clean_ones() -> None:
    keys = study.planned(["campaign", "wear"], (0.5, 2.0), 3)
    assert len(keys) == len(set(keys)) == 3 * 2 * 2 + 3 * 2
    assert {k[:2] for k in keys} == {
        ("campaign", 0.5), ("campaign", 2.0), ("wear", 0.5), ("wear", 2.0), ("clean", 0.0)
    }  # fmt: skip


def test_an_effect_is_not_scaled_beyond_what_finite_elements_were_run_for() -> None:
    plan = effect_plans.plan("fleet-100")
    most = max(s / min(plan.strength(r, "step", s) for r in range(plan.rotors)) for s in (1.0,))
    far = 2.01 * effect_plans.STRONGEST * most
    assert study.sizes_of(plan, "step", (0.5, far)) == (0.5,)
    assert study.sizes_of(plan, "campaign", (0.5, far)) == (0.5, far), "readings alone are changed"


@pytest.mark.parametrize(
    ("conditions", "sizes", "plan", "what"),
    [
        (["fouling", "rust"], (1.0,), "fleet-100", "rust"),
        (None, (0.0, 1.0), "fleet-100", "sizes"),
        (None, (), "fleet-100", "sizes"),
        (None, (1.0,), "rotor-20", "fleet-100"),
    ],
)
def test_what_cannot_be_studied_is_told(
    conditions: list[str] | None, sizes: tuple[float, ...], plan: str, what: str
) -> None:
    with pytest.raises(InputError, match=what):
        study.planned(conditions, sizes, 2, plan)


def test_a_large_offset_alarms_and_no_offset_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Control: the same readings without it, of fifteen of the blades. A cut study goes on."""
    few = of_blades(effect_plans.plan("fleet-100"), range(0, 100, 7))
    monkeypatch.setitem(effect_plans.PLANS, "fleet-15", lambda: few)
    keys = [("campaign", 4.0, 0), ("clean", 0.0, 0)]
    asked = {"seed": 3, "particles": 200, "plan": "fleet-15", "folder": tmp_path}
    found = study.run(keys, **asked)
    assert [one["alarm"] for one in found] == [True, False]
    assert "error" not in found[0]
    monkeypatch.setattr(study, "update", None)
    assert study.run(keys, **asked) == found
    rows = study.curves(found)
    assert rows["campaign"][0]["alarms"] == 1.0
    assert 0.2 < rows["campaign"][0]["error"] < 0.3, "one set tells little"
    power_plot(
        rows, {"campaign": [{"size": 4.0, "alarm": 0.99, "searched": 0.9}]}, tmp_path / "power.png"
    )
    assert (tmp_path / "power.png").read_bytes().startswith(b"\x89PNG")


def test_a_large_offset_alarms_in_the_residuals_too(monkeypatch: pytest.MonkeyPatch) -> None:
    few = of_blades(effect_plans.plan("fleet-100"), range(0, 100, 7))
    monkeypatch.setitem(effect_plans.PLANS, "fleet-15", lambda: few)
    keys = [("campaign", 4.0, 0), ("clean", 0.0, 0)]
    monkeypatch.setattr(study, "judge", None)  # no diagnosis is asked
    found = study.run(keys, seed=3, particles=200, plan="fleet-15", by=study.who("residuals"))
    assert [one["alarm"] for one in found] == [True, False]
    assert "campaign" in found[0]["groups"]
    assert found[0]["p"] <= 0.05 < found[1]["p"]
    with pytest.raises(InputError, match="use diagnosis or residuals"):
        study.who("nobody")


def test_what_oracles_would_notice_is_a_mean_over_the_rotors_of_a_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[int] = []

    def seen(model: object, given: effect_sets.Set, *_: object) -> effect_oracle.Possible:
        asked.append(int(given.case.spec.id.removeprefix("set")))
        return effect_oracle.Possible(2.0 * asked[-1], None, 0.0, 0.1 * asked[-1])

    monkeypatch.setattr(effect_oracle, "possible", seen)
    rotors = min(effect_plans.plan("fleet-100").rotors, effect_oracle.MOST_ROTORS)
    (told,) = study.bounds([("campaign", 1.0)], 3, 200, "fleet-100")["campaign"]
    assert asked == list(range(rotors))
    alarms = [effect_oracle.Possible(2.0 * n, None, 0.0).alarm for n in asked]
    assert (told["size"], told["rotors"]) == (1.0, rotors)
    assert told["alarm"] == pytest.approx(sum(alarms) / rotors, abs=1e-3)
    assert told["searched"] == pytest.approx(0.05 * (rotors - 1))


def test_a_set_that_cannot_be_calibrated_counts_against_the_diagnosis(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Silent where there is an effect; where there is none it was silent as well, which is right
    there, and made the share of false alarms smaller."""

    def never(*_: object, **__: object) -> None:
        raise InputError("readings", 0, "are none", "give some")

    monkeypatch.setattr(study, "update", never)
    keys = [("campaign", 4.0, 0), ("clean", 0.0, 0)]
    found, clean = study.run(keys, seed=3, particles=200)
    assert (found["alarm"], clean["alarm"]) == (False, True)
    assert "are none" in found["error"]
    assert study.curves([found, found | {"alarm": True}])["campaign"][0]["alarms"] == 0.5
