"""The family-wise null, and verdicts, on rotors whose scores are exact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from core.diagnosis import dealing as module
from core.diagnosis.misread import Spared
from core.diagnosis.scan import Scan
from core.diagnosis.verdict import judge
from tests.core.diagnosis import fleet
from tests.core.diagnosis.fleet import SIGMA, rotor, scan

SETS, DEALT, TWELVE = 100, 99, 12


def p_values(noise: str) -> list[float]:
    found = []
    for seed in range(SETS):
        found.append(scan(*rotor(seed, noise=noise)).chance(DEALT, seed))
    return found


@pytest.mark.parametrize("noise", ["normal", "heavy", "walk"])
def test_clean_rotors_alarm_no_more_often_than_said(
    noise: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """5 % nominal; 11 of 100 are 1 % probable at 5 % and 42 % at 10 %. Of twelve blades."""
    monkeypatch.setattr(fleet, "BLADES", TWELVE)
    assert np.mean(np.array(p_values(noise)) <= 0.05) <= 11 / SETS


@pytest.mark.parametrize("noise", ["normal", "heavy", "walk"])
def test_three_clean_blades_alarm_no_more_often_than_said(
    noise: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fleet, "BLADES", 3)
    assert np.mean(np.array(p_values(noise)) <= 0.05) <= 11 / SETS


def test_an_offset_in_all_of_three_blades_is_no_matter_of_signs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Signs of three blades agree by chance in a quarter of all sets, however large they are."""
    monkeypatch.setattr(fleet, "BLADES", 3)
    one = scan(*rotor(1, lambda b, k: 30 * SIGMA if k == 1 else 0.0))
    assert one.chance(DEALT, 1) <= 0.02


def off(size: float, common: float = 0.0) -> Any:
    """The first blade by `size` noises at its last reading, all at the one before by `common`."""
    return lambda b, k: SIGMA * (size * (b == 0) * (k == 2) + common * (k == 1))


def median_p(add: Any) -> float:
    return float(np.median([scan(*rotor(s, add)).chance(DEALT, s) for s in range(5)]))


def far(b: int, k: int) -> float:
    return 60 * SIGMA * (b == 0)


def as_large(seed: int) -> float:
    """Share of dealt sets in which some blade gains as much as the odd one does."""
    one = scan(*rotor(seed, far))
    alone = np.array([name.endswith(", blade") for name in one.found])
    found = one._tried(one.c, one.u)[alone].max()
    return float(np.mean(one.null(DEALT, seed)[:, alone].max(axis=1) >= found))


def test_one_blade_that_is_far_off_alarms() -> None:
    assert median_p(far) <= 1 / (1 + DEALT)
    assert np.median([as_large(s) for s in range(5)]) <= 0.05


def test_dealt_as_it_is_the_odd_blade_would_hide_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """The control: it is drawn at least once in two thirds of the sets."""
    monkeypatch.setattr(module, "ODD", 0.0)
    assert np.median([as_large(s) for s in range(5)]) > 0.15


def test_one_blade_that_is_off_does_not_hide_what_all_have_in_common() -> None:
    assert median_p(off(30.0, 2.0)) <= 0.05


def test_in_one_null_for_all_families_it_would(monkeypatch: pytest.MonkeyPatch) -> None:
    """The control: the largest of all families against that of the dealt sets, all as they are,
    and one reading counts as an effect of its blade."""
    monkeypatch.setattr(module, "ODD", 0.0)
    monkeypatch.setattr(Spared, "least", lambda self, gains, *rest: gains)
    found = []
    for seed in range(5):
        one = scan(*rotor(seed, off(30.0, 2.0)))
        largest = one.null(DEALT, seed).max(axis=1)
        found.append((1 + np.sum(largest >= max(one.found.values()))) / (1 + DEALT))
    assert np.median(found) > 0.05


def test_a_null_that_does_not_know_the_blades_scatter_alarms_too_often(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The control: standard normal scores and no overdispersion, on blades that walk."""
    monkeypatch.setattr(fleet, "BLADES", TWELVE)
    alarms = 0
    for seed in range(SETS):
        one = scan(*rotor(seed, noise="walk"))
        known = np.flatnonzero(np.diag(one.information) > 1e-6)
        information = one.information[np.ix_(known, known)]
        sd = np.sqrt(np.diag(information))
        draw = np.random.default_rng(seed).multivariate_normal
        null = np.abs(draw(np.zeros(len(known)), information, DEALT) / sd).max(axis=1)
        alarms += np.mean(null >= np.abs(one.u[known] / sd).max()) <= 0.05
    assert alarms > 11


def test_a_campaign_that_reads_too_long_is_named() -> None:
    verdict = judge(scan(*rotor(1, lambda b, k: 2 * SIGMA if k == 1 else 0.0)), 1, dealt=DEALT)
    assert (verdict.word, verdict.names) == ("effect", ("campaign offset (campaign c1)",))
    assert verdict.best is not None


def test_the_name_follows_the_label() -> None:
    """The same offset on another campaign's readings."""
    verdict = judge(scan(*rotor(1, lambda b, k: 2 * SIGMA if k == 2 else 0.0)), 1, dealt=DEALT)
    assert verdict.names == ("campaign offset (campaign c2)",)


def test_two_campaigns_are_named_together() -> None:
    one = scan(*rotor(1, lambda b, k: {1: 3 * SIGMA, 2: -3 * SIGMA}.get(k, 0.0)))
    verdict = judge(one, 1, dealt=DEALT)
    assert set(verdict.hypotheses[0].names) <= {
        "campaign offset (campaign c0)",
        "campaign offset (campaign c1)",
        "campaign offset (campaign c2)",
    }


def test_what_no_cell_names_is_not_given_a_name() -> None:
    """A misfit that alternates between blades and visits, of four noises."""
    verdict = judge(scan(*rotor(1, lambda b, k: 4 * SIGMA * (-1) ** (b // 2 + k))), 1, dealt=DEALT)
    assert verdict.word in ("unattributed", "adequate")


def test_an_effect_smaller_than_the_noise_is_not_claimed() -> None:
    verdict = judge(scan(*rotor(2, lambda b, k: 0.1 * SIGMA if k == 1 else 0.0)), 1, dealt=DEALT)
    assert verdict.word == "adequate"
    assert verdict.names == ()


def test_readings_in_another_order_give_the_same_scan() -> None:
    seen, facts = rotor(4, lambda b, k: SIGMA if k == 1 else 0.0)
    again: Scan = scan(seen, dict(reversed(facts.items())))
    assert again.found == scan(seen, facts).found


def test_the_choice_of_rivals_knows_no_discount_but_for_what_concerns_one_blade() -> None:
    """Blades that walk: an alarm is discounted; a rival's evidence is not, but one blade's is."""
    one = scan(*rotor(3, noise="walk"))
    alone = np.array([c.whom == "blade" for c in one.cells])
    common = np.flatnonzero(~alone & (one.phi[: len(alone)] > 1.2))
    assert len(common) > 0
    plain = one.undiscounted
    assert np.all(plain.phi[common] == 1.0)
    assert np.array_equal(plain.phi[: len(alone)][alone], one.phi[: len(alone)][alone])
    u, information = one.u[common], np.diag(one.information)[common]
    exact = 0.5 * u**2 / (1 + information) - 0.5 * np.log1p(information)
    free = [one.cells[i].family.sign == 0 for i in common]
    assert plain.gains[common][free] == pytest.approx(exact[free])
    assert np.array_equal(one.u, plain.u)
