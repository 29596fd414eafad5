"""The family-wise null, and verdicts, on rotors whose scores are exact."""

from __future__ import annotations

import numpy as np
import pytest

from core.diagnosis.scan import Scan
from core.diagnosis.verdict import judge
from tests.core.diagnosis.fleet import SIGMA, rotor, scan

SETS, DEALT = 100, 99


def p_values(noise: str) -> list[float]:
    found = []
    for seed in range(SETS):
        one = scan(*rotor(seed, noise=noise))
        top = max(one.found.values())
        found.append((1 + np.sum(one.null(DEALT, seed) >= top)) / (1 + DEALT))
    return found


@pytest.mark.parametrize("noise", ["normal", "heavy", "walk"])
def test_clean_rotors_alarm_no_more_often_than_said(noise: str) -> None:
    """5 % nominal; 11 of 100 are 1 % probable at 5 % and 42 % at 10 %."""
    assert np.mean(np.array(p_values(noise)) <= 0.05) <= 11 / SETS


def test_a_null_that_does_not_know_the_blades_scatter_alarms_too_often() -> None:
    """The control: standard normal scores and no overdispersion, on blades that walk."""
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
    assert all(h.agrees for h in verdict.held)


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
