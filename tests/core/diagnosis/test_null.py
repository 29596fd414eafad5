"""What the null of a scan is made of: residuals as large as they are, whatever pulls on them."""

from __future__ import annotations

import tracemalloc
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from core.diagnosis.dealing import Deal, Deck, dealt_sets
from core.diagnosis.scan import Scan
from core.diagnosis.scatter import Scatter
from core.diagnosis.scores import Scores
from core.diagnosis.search import EARNED, prices
from core.diagnosis.signature import Signatures
from core.diagnosis.verdict import judge
from tests.core.diagnosis.fleet import SIGMA, rotor, scan

BLADES, ROWS, SHARED, SETS = 8, 2, 3, 150


@cache
def sound() -> Scores:
    """The rotor whose blades are taken."""
    return rotor(0)[0]


@cache
def few(seed: int) -> Scores:
    """Eight blades of two readings that three shared parameters fit: exact, from the formulas."""
    seen = sound()
    rng = np.random.default_rng(seed)
    slope = np.random.default_rng(1).normal(size=(BLADES, ROWS, SHARED))
    bare = replace(
        seen,
        blades=seen.blades[:BLADES],
        rows=seen.rows[:BLADES],
        place=seen.place[:BLADES, :ROWS],
        q=np.zeros((BLADES, ROWS)),
        information=np.tile(np.eye(ROWS), (BLADES, 1, 1)),
        slope=slope,
        prior=np.full(SHARED, 1e4),
    )
    y = rng.normal(size=(BLADES, ROWS))
    return replace(bare, q=y - bare.imitated @ np.einsum("bns,bn->s", bare.deviation, y))


def over_information(dealt: Mapping[int, np.ndarray], g: np.ndarray) -> float:
    """Mean of U² / I over dealt sets of many rotors, signature g (B, n)."""
    found = []
    for seed, q in dealt.items():
        seen = few(seed)
        information = float(seen.cross(g[:, :, None])[0, 0])
        found.append(np.mean(np.einsum("kbi,bi->k", q, g) ** 2) / information)
    return float(np.mean(found))


def of_white(white: np.ndarray, rows: np.ndarray, seed: int, count: int) -> np.ndarray:
    """Sets of whitened blades as they are, (count, B, n)."""
    return Deal.of(rows, white.shape[1], np.random.default_rng(seed), count).sets(white)


def test_dealt_scores_scatter_as_their_information_says() -> None:
    """Three parameters take 3 of 16 degrees of freedom; dealt as they were the scores scattered
    by that much less than the information says, and so did those of the readings themselves."""
    g = np.random.default_rng(2).normal(size=(BLADES, ROWS))
    dealt = {s: dealt_sets(few(s), 60, s) for s in range(SETS)}
    assert over_information(dealt, g) == pytest.approx(1.0, abs=0.07)
    raw = {s: of_white(few(s).q, np.full(BLADES, ROWS), s, 60) for s in dealt}
    efficient = few(0).efficient(g[:, :, None])[:, :, 0]
    assert over_information(raw, efficient) < 0.9, "the control: dealt as they are"


def test_a_blade_without_companions_is_dealt_rows_of_the_others() -> None:
    white = np.ones((9, 3))
    white[0], white[1:, 2] = 50.0, 0.0
    rows = np.array([3] + 8 * [2])
    sets = of_white(white, rows, 1, 200)
    assert np.mean(np.abs(sets[:, 0, 0]) > 1.5) < 0.5
    assert not np.any(sets[:, 1:, 2]), "what is beyond a blade's rows stays nothing"


def test_other_residuals_of_a_rotor_are_dealt_alike_from_one_deck() -> None:
    """Of blades with companions, of one without (a row less), and of few blades."""
    seen, _ = rotor(3)
    place, information = seen.place.copy(), seen.information.copy()
    place[0, -1], information[0, -1], information[0, :, -1] = -1, 0.0, 0.0
    q = np.where(place >= 0, seen.q, 0.0)
    lonely = replace(seen, place=place, information=information, q=q)
    for one in (seen, lonely, few(1)):
        moved = replace(one, q=one.q + 3.0 * (one.place >= 0))
        deck = Deck.of(one, 40, 7)
        assert np.array_equal(deck.sets(moved.q), dealt_sets(moved, 40, 7))
        assert np.array_equal(deck.sets(one.q), dealt_sets(one, 40, 7))
        assert not np.allclose(deck.sets(moved.q), deck.sets(one.q))


def test_shares_of_the_blades_are_those_of_the_efficient_signatures() -> None:
    seen, _ = rotor(3)
    g = np.random.default_rng(1).normal(size=(*seen.q.shape, 5))
    shared = np.tensordot(seen.deviation, g, axes=((0, 1), (0, 1)))
    c, own = seen.shares(g, shared)
    efficient = seen.efficient(g)
    assert c == pytest.approx(np.einsum("bic,bi->bc", efficient, seen.q))
    assert own == pytest.approx(
        np.einsum("bic,bij,bjc->bc", efficient, seen.information, efficient)
    )


def test_cells_of_single_blades_take_the_room_of_their_signatures() -> None:
    seen, _ = rotor(3)
    columns = 40 * len(seen.blades)
    g = np.zeros((*seen.q.shape, columns))
    for c in range(columns):
        g[c % len(seen.blades), :, c] = 1.0 + c
    found = Signatures(g, np.zeros_like(g))
    tracemalloc.start()
    Scan.of([], seen, Signatures(g[:, :, :0], g[:, :, :0]), {"all": found})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3.5 * g.nbytes + 3 * 8 * columns**2


def test_three_blades_that_tell_nearly_all_count_as_three() -> None:
    own = np.r_[np.full(3, 10.0), np.full(17, 0.1)][:, None]
    concerned, alone = np.ones((20, 1), bool), np.zeros(1, bool)
    one = Scatter.of(own, concerned, alone)
    assert not one.many[0]
    rng = np.random.default_rng(1)
    excess = []
    for _ in range(4000):
        c = np.sqrt(own) * rng.normal(size=own.shape)
        off = c - c.sum() / own.sum() * own
        excess.append(float((off**2).sum()))
    assert np.mean(excess) == pytest.approx(float(one.expected[0]), rel=0.05)
    assert float(one.expected[0]) < 0.75 * own.sum() * 19 / 20, "the control: as if all told alike"


def test_an_effect_with_a_sign_has_the_exact_bayes_factor_of_a_half_normal_prior() -> None:
    one = scan(*rotor(1, lambda b, k: SIGMA if k == 1 else 0.0))
    signed = int(np.argmax(one._signs > 0)) if np.any(one._signs > 0) else 0
    signs = one._signs.copy()
    signs[signed] = 1
    object.__setattr__(one, "_signs", signs)
    object.__delattr__(one, "gains") if "gains" in one.__dict__ else None
    u, information = one._scaled
    a = np.linspace(0.0, 12.0, 200_001)
    likelihood = np.exp(a * u[signed] - 0.5 * a**2 * information[signed, signed])
    prior = 2.0 * np.exp(-0.5 * a**2) / np.sqrt(2 * np.pi)
    exact = np.log(np.trapezoid(likelihood * prior, a))
    assert one.gains[signed] == pytest.approx(exact, abs=1e-4)
    assert one.gain(signed) == pytest.approx(exact, abs=1e-4)


def test_prices_are_those_of_all_cells_that_were_searched() -> None:
    """Without any effect the mean of exp(gain − price) over all is e^−EARNED."""
    found = prices(scan(*rotor(1)))
    assert sum(np.exp(EARNED - p) for p in found.values()) == pytest.approx(1.0)
    assert min(found.values()) > EARNED


def test_one_null_is_enough_for_a_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    null = Scan.null

    def counted(self: Scan, count: int, seed: int) -> np.ndarray:
        asked.append(seed)
        return null(self, count, seed)

    monkeypatch.setattr(Scan, "null", counted)
    verdict = judge(scan(*rotor(1, lambda b, k: 2 * SIGMA if k == 1 else 0.0)), 1, dealt=99)
    assert verdict.word == "effect"
    assert asked == [1]
