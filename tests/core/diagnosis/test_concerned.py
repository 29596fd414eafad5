"""Whether all blades have an effect: against exact densities, in simulated rotors, in a verdict."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from core.diagnosis import Case, Facts, to_json
from core.diagnosis import concerned as module
from core.diagnosis.amplitudes import Amplitude
from core.diagnosis.concerned import ALL, SHARES, Concerned, concerned, shared_out
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.diagnosis.verdict import NAMED, WIDE
from tests.core.diagnosis import fleet
from tests.core.diagnosis.test_diagnose import SPEC, found, readings

OFFSET = next(f for f in FAMILIES if f.name == "campaign offset")
CELL = Cell(OFFSET, "constant", "campaign", "c2")
SOME = {2, 3, 8, 9, 14, 15}  # of 16, every second one odd


def test_it_is_the_ratio_of_the_exact_densities() -> None:
    """Of blades whose readings are normal once their own parameters are integrated out."""
    seen, _ = fleet.rotor(3, lambda b, k: 0.4 * (b % 3 == 0) * (k == 2))
    g = np.zeros(seen.q.shape)
    g[:, 2] = 0.1
    pull = 0.2 * np.random.default_rng(4).normal(size=g.shape)
    told = concerned(seen, [Amplitude(CELL, 1.2, 0.1, g, pull)])
    c = np.linalg.inv(seen.information)
    off = np.einsum("bij,bj->bi", c, seen.q)  # y − f with the effect at 1.2 in all

    def log_p(moved: float) -> np.ndarray:
        nothing = np.zeros(len(g[0]))
        each = zip(off, g, c, strict=True)
        normal = [multivariate_normal(nothing, k).logpdf(o - moved * s) for o, s, k in each]
        return np.array(normal) + moved * pull.sum(axis=1)

    all_have = log_p(0.0).sum()
    shares = []
    for s in SHARES:
        both = np.log(1 - s) + log_p(-1.2), np.log(s) + log_p(1.2 / s - 1.2)
        shares.append(np.logaddexp(*both).sum())
        if s == told[0].share:
            has = np.exp(both[1] - np.logaddexp(*both))
    exact = math.log(np.mean(np.exp(np.array(shares) - all_have)))
    assert told[0].nat == pytest.approx(exact, abs=1e-6)
    assert told[0].share == SHARES[int(np.argmax(shares))]
    assert set(told[0].those) == {seen.blades[b] for b in np.flatnonzero(has > 0.5)}
    assert told[0].all == pytest.approx(3 / (3 + math.exp(exact)))


@pytest.mark.parametrize(("share", "least"), [(1.0, 0.95), (0.3, 0.0)])
def test_what_all_have_is_told_from_what_a_third_has(share: float, least: float) -> None:
    """200 rotors of 100 blades that show two sds each, or a third of them what makes the same mean
    of all; the amplitude is the one that all agree on."""
    rng, stands = np.random.default_rng(8), []
    for _ in range(200):
        has = rng.random(100) < share
        y = 2.0 * has / share + rng.standard_normal(100)
        a = float(y.mean())
        nat, _, _ = shared_out(y - a, np.ones(100), a)
        stands.append(Concerned("", 100, nat, 0.3, ()).stands)
    assert np.mean(stands) >= least
    assert share == 1.0 or np.mean(stands) <= 0.01


def test_its_probability_is_the_frequency() -> None:
    """6,000 rotors of 50 blades with effects of 0.2 to 2 sds each: all have it in three of four, in
    others a share that is drawn. Where P(all) is told, so many of them are."""
    rng = np.random.default_rng(9)
    told, truth = np.empty(6000), np.empty(6000, bool)
    for k in range(len(told)):
        truth[k] = rng.random() < ALL / (1 + ALL)
        share = 1.0 if truth[k] else rng.choice(SHARES)
        y = rng.uniform(0.2, 2.0) * (rng.random(50) < share) / share + rng.standard_normal(50)
        nat, _, _ = shared_out(y - y.mean(), np.ones(50), float(y.mean()))
        told[k] = Concerned("", 50, nat, 0.3, ()).all
    for low, high in ((0.0, 0.2), (0.2, 0.6), (0.6, 0.8), (0.8, NAMED), (NAMED, 1.0)):
        at = (told >= low) & (told <= high)
        mean, n = told[at].mean(), at.sum()
        sd = math.sqrt(mean * (1 - mean) / n)
        assert n > 100
        assert abs(truth[at].mean() - mean) < 3 * sd + 0.03, (low, high, truth[at].mean(), mean)
    assert truth[told >= NAMED].mean() > NAMED


def test_of_one_blade_few_blades_or_a_large_amplitude_nothing_is_asked() -> None:
    seen, _ = fleet.rotor(3)
    g, none = np.full(seen.q.shape, 0.1), np.zeros(seen.q.shape)
    few = np.where(np.arange(len(g))[:, None] < 7, g, 0.0)
    alone = Cell(OFFSET, "constant", "blade", seen.blades[0])
    for one in (
        Amplitude(CELL, 1.0, 0.1, few, none),
        Amplitude(alone, 1.0, 0.1, g, none),
        Amplitude(CELL, 1.01 * WIDE, 0.1, g, none),
    ):
        assert concerned(seen, [one]) == ()
    assert len(concerned(seen, [Amplitude(CELL, 1.0, 0.1, g, none)])) == 1


def test_what_a_third_of_the_blades_has_is_not_claimed_of_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    data = readings(lambda b, t: 0.5 * t**2 * (b in SOME), seed=7)
    one = found(data)
    assert (one.verdict.word, one.verdict.names) == ("unattributed", ())
    (told,) = one.verdict.concerns
    assert (told.effect, told.blades, told.stands) == ("bend", 16, False)
    assert told.share == pytest.approx(len(SOME) / 16, abs=0.1)
    theirs = {f"b{b:02d}" for b in SOME}
    assert set(told.those) <= theirs
    assert len(told.those) >= len(SOME) - 1
    assert any("bend is not in all 16 blades" in why for why in one.verdict.reasons)
    case = Case(SPEC, data, {b: Facts() for b in SPEC.blades})
    (plain,) = to_json(one, case)["concerns"]
    assert plain["stands"] is False
    assert plain["some_nat"] == told.nat > 5.0
    monkeypatch.setattr(module, "NAMED", 0.0)  # the negative control: nothing else refuses it
    assert found(data).verdict.word == "effect"


def test_what_all_blades_have_is_claimed_of_all() -> None:
    one = found(readings(lambda b, t: 0.25 * t**2))
    (told,) = one.verdict.concerns
    assert one.verdict.word == "effect"
    assert told.stands
    assert told.all > 0.99
    assert told.those == ()


def test_words_say_which_it_is() -> None:
    open_ = Concerned("wear", 40, 0.0, 0.3, ("b1",))
    assert "is open: all have 75% of the evidence" in open_.told()
    names = tuple(f"b{i}" for i in range(15))
    some = Concerned("wear", 40, 5.0, 0.4, names).told()
    assert "not in all 40 blades: that some have it has 5.0 nat more, about 40% of them" in some
    assert "b11 and 3 others" in some
