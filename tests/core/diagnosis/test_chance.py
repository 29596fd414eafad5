"""One probability over all families: exact under the null, and what it notices."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.special import logsumexp

from core.diagnosis.chance import family_wise

ROTORS, DEALT, FAMILIES, BLADES = 600, 99, 16, 4
ALONE = np.arange(FAMILIES) < BLADES
INFORMATION, ALIKE = 8.0, 0.8  # nats that an effect is worth, twice; correlation of its families
Array = np.ndarray


def gains(rng: np.random.Generator, count: int, effect: float = 0.0) -> Array:
    """log Bayes factors of normal scores; half of the common families are alike, as causes are."""
    score = rng.standard_normal((count, FAMILIES))
    common = rng.standard_normal((count, 1))
    alike = slice(BLADES, BLADES + (FAMILIES - BLADES) // 2)
    score[:, alike] = np.sqrt(ALIKE) * common + np.sqrt(1 - ALIKE) * score[:, alike]
    score[:, alike] += effect * np.sqrt(INFORMATION * ALIKE)
    z = score * np.sqrt(INFORMATION / (1 + INFORMATION))
    return np.asarray(0.5 * z**2 - 0.5 * np.log1p(INFORMATION))


@cache
def judged(effect: float) -> tuple[Array, Array, Array]:
    """By this rule, by the largest family, and by two groups of which each has its 5 %."""
    rng = np.random.default_rng(7)
    found: list[tuple[float, float, float]] = []
    for _ in range(ROTORS):
        null, own = gains(rng, DEALT), gains(rng, 1, effect)[0]
        largest = (1 + np.sum(null.max(axis=1) >= own.max())) / (1 + DEALT)
        by_group = min(
            (1 + np.sum(logsumexp(null[:, k], axis=1) >= logsumexp(own[k]))) / (1 + DEALT)
            for k in (ALONE, ~ALONE)
        )
        found.append((family_wise(own, null, ALONE), largest, by_group))
    return tuple(np.array(found).T)


@pytest.mark.parametrize("level", [0.02, 0.05, 0.2, 0.5, 0.8])
def test_of_sound_rotors_so_many_alarm_as_is_said(level: float) -> None:
    """Dealt sets and readings are exchangeable here: p is uniform but for its hundredths."""
    share = np.mean(judged(0.0)[0] <= level)
    assert abs(share - level) <= 3 * np.sqrt(level * (1 - level) / ROTORS)


def test_two_groups_of_five_per_cent_each_would_alarm_too_often() -> None:
    """The control."""
    assert np.mean(judged(0.0)[2] <= 0.05) > 0.05 + 3 * np.sqrt(0.05 * 0.95 / ROTORS)


def test_what_many_families_say_together_is_noticed_more_often_than_by_the_largest() -> None:
    mean, largest, _ = (np.mean(p <= 0.05) for p in judged(1.0))
    assert mean > largest + 0.03
    assert mean > 0.6


@pytest.mark.parametrize("place", [0, BLADES])
def test_what_no_dealt_set_comes_near_is_as_rare_as_they_can_tell(place: int) -> None:
    """In either group, however few its families are."""
    null = gains(np.random.default_rng(3), DEALT)
    own = null[0].copy()
    own[place] = 30.0
    assert family_wise(own, null, ALONE) == 1 / (1 + DEALT)


@pytest.mark.parametrize("alone", [np.zeros(FAMILIES, bool), np.ones(FAMILIES, bool)])
def test_one_group_alone_is_ranked_among_the_dealt_sets(alone: Array) -> None:
    rng = np.random.default_rng(5)
    null, own = gains(rng, DEALT), gains(rng, 1)[0]
    rank = 1 + np.sum(logsumexp(null, axis=1) >= logsumexp(own))
    assert family_wise(own, null, alone) == pytest.approx(rank / (1 + DEALT))


def test_each_group_has_its_share_of_the_false_alarms() -> None:
    """A quarter of the families are of one blade: 3 % of their null are 12 % of all."""
    null = gains(np.random.default_rng(11), 399)
    middle, rare = (
        null[np.argsort(logsumexp(null[:, own], axis=1))[rank], own]
        for own, rank in ((~ALONE, 199), (ALONE, 387))
    )
    assert 0.09 < family_wise(np.r_[rare, middle], null, ALONE) < 0.15
