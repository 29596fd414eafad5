"""Tests of residuals: quiet where nothing is missing, also with heavy tails; loud where it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from core.diagnosis.foretold import DRAWS
from core.diagnosis.grammar import Facts
from core.diagnosis.omnibus import (
    FAMILY,
    LEAST_FREEDOM,
    MOST_FREEDOM,
    _pairs,
    omnibus,
    tails,
)
from core.diagnosis.visits import Residual, Visit
from core.observation import Inspection

BLADES, VISITS = 20, 4
SHARED, OWN, NOISE = 0.5, 0.6, np.sqrt(1 - 0.25 - 0.36)
FACTS = {f"b{b:02d}": Facts(lot=f"L{b % 3}") for b in range(BLADES)}
Array = np.ndarray


def clean(rng: np.random.Generator, k: int) -> Array:
    return NOISE * rng.standard_normal(BLADES)


def heavy(rng: np.random.Generator, k: int) -> Array:
    return np.asarray(NOISE * rng.standard_t(5, BLADES) * np.sqrt(3 / 5))


def made(
    seed: int, noise: Callable[..., Array] = clean, off: Callable[..., Array] | None = None
) -> list[Visit]:
    """Visits whose z have a shared part, one of each blade, and noise; `off(k)` is put on top."""
    rng = np.random.default_rng(seed)
    found = []
    covariance = SHARED**2 + (1 - SHARED**2) * np.eye(BLADES)
    for k in range(VISITS):
        z = SHARED * rng.normal() + OWN * rng.normal(size=BLADES) + noise(rng, k)
        z = z + (0.0 if off is None else off(k))
        rows = tuple(
            Residual(
                Inspection(f"{name}-{k}", name, "y", float(k), [0.0], campaign=f"c{k // 2}",
                           instrument=f"i{b % 2}"),
                0, k, float(k), 0.0, 0.0, 1.0, float(z[b]), 0.5,
            )
            for b, name in enumerate(FACTS)
        )  # fmt: skip
        draws = np.random.default_rng([seed, k, 1])
        common, own = draws.normal(size=(DRAWS, 1)), draws.normal(size=(DRAWS, BLADES))
        signal = SHARED * common + OWN * own
        found.append(Visit(rows, covariance, signal, np.full((DRAWS, BLADES), NOISE), {}))
    return found


def alarms(noise: Callable[..., Array], sets: int = 100) -> int:
    return sum(bool(omnibus(made(seed, noise), FACTS, seed).alarms) for seed in range(sets))


@pytest.mark.parametrize("noise", [clean, heavy])
def test_clean_rotors_alarm_no_more_often_than_said(noise: Callable[..., Array]) -> None:
    """100 sets at 5 %: 11 or fewer with a probability of 0.996."""
    assert alarms(noise) <= 11


def test_an_independent_null_would_cry_at_what_a_visit_misses_together() -> None:
    """The mutant: without the covariance the shared part is found in nearly every visit."""

    def wrong(seed: int) -> bool:
        visits = [
            Visit(v.residuals, np.eye(BLADES), v.signal * 0, v.noise / NOISE, {})
            for v in made(seed)
        ]
        return bool(omnibus(visits, FACTS, seed).alarms)

    assert sum(wrong(seed) for seed in range(20)) >= 10


@pytest.mark.parametrize(
    ("off", "grouping", "value", "statistic"),
    [
        (lambda k: 2.0 * (np.arange(BLADES) % 2), "instrument", "i1", "mean"),
        (lambda k: 2.5 * (np.arange(BLADES) % 3 == 1), "lot", "L1", "mean"),
        (lambda k: 4.0 * (np.arange(BLADES) == 7), "blade", "b07", "mean"),
        (lambda k: 4.0 * (-1) ** k * (np.arange(BLADES) == 7), "blade", "b07", "variance"),
        (
            lambda k: np.where(k == 2, 2.0, 0.0) * (-1) ** np.arange(BLADES),
            "hour",
            "visit 3",
            "variance",
        ),
        (lambda k: 1.2 * (-1) ** np.arange(BLADES), "all", None, "autocorrelation"),
    ],
)
def test_what_is_planted_alarms_in_its_own_grouping(
    off: Callable[..., Array], grouping: str, value: str | None, statistic: str
) -> None:
    found = omnibus(made(3, clean, off), FACTS, 3)
    assert (grouping, value, statistic) in [
        (t.grouping, t.value, t.statistic) for t in found.alarms
    ], found.tests[:4]


def test_a_group_that_is_another_one_under_a_second_name_is_asked_once() -> None:
    found = omnibus(made(1), {name: Facts(lot="L") for name in FACTS}, 1)
    assert {t.grouping for t in found.tests} == {"all", "blade", "campaign", "instrument", "hour"}


def test_a_group_under_a_second_name_is_asked_of_its_pairs_where_the_first_was_not() -> None:
    """Blades are not asked in pairs, quantities are."""
    visits = made(1)
    for k, visit in enumerate(visits):
        one = replace(visit.residuals[0], reading=replace(visit.residuals[0].reading, quantity="x"))
        visits[k] = replace(visit, residuals=(one, *visit.residuals[1:]))
    found = omnibus(visits, FACTS, 1)
    asked = [t.statistic for t in found.tests if (t.grouping, t.value) == ("quantity", "x")]
    assert asked == ["autocorrelation"], "mean and variance are those of blade b00"


def test_two_gauges_of_one_visit_each_have_their_own_past() -> None:
    visits = made(1)
    rows = [(k, i) for k in range(VISITS) for i in (0, 1)]
    for k, visit in enumerate(visits):
        both = [
            replace(one, reading=replace(one.reading, blade="b00", instrument=f"g{i}"))
            for i, one in enumerate(visit.residuals[:2])
        ]
        visits[k] = replace(visit, residuals=(*both, *visit.residuals[2:]))
    found = _pairs(visits, rows)
    assert len(found) == 2 * (VISITS - 1)
    assert all(later[1] == before[1] for later, before in found)


def test_tails_are_seen_where_there_are_some() -> None:
    rng = np.random.default_rng(1)
    assert tails(rng.normal(size=400), 1.0) == MOST_FREEDOM
    assert tails(rng.standard_t(5, 2000), 1.0) < MOST_FREEDOM
    diluted = np.sqrt(0.5) * (rng.normal(size=4000) + rng.standard_t(6, 4000) / np.sqrt(1.5))
    assert LEAST_FREEDOM <= tails(diluted, 0.5) <= MOST_FREEDOM


def test_every_p_is_a_probability_and_the_family_s_is_never_the_smaller_one() -> None:
    found = omnibus(made(2), FACTS, 2)
    assert all(0 < t.p <= t.p_family + 1e-12 and t.p_family <= 1 for t in found.tests)
    assert [t.alarms for t in found.tests] == [t.p_family <= FAMILY for t in found.tests]
