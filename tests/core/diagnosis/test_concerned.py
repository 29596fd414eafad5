"""Whether all blades have an effect: against exact densities, in simulated rotors, in a verdict."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from core.diagnosis import Case, Facts, to_json
from core.diagnosis import concerned as module
from core.diagnosis.amplitudes import Amplitude
from core.diagnosis.concerned import (
    PHI,
    SHARES,
    Concerned,
    concerned,
    heard,
    shared_out,
)
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell
from core.diagnosis.verdict import NAMED, WIDE, Verdict
from tests.core.diagnosis import fleet
from tests.core.diagnosis.test_diagnose import SPEC, found, readings

OFFSET = next(f for f in FAMILIES if f.name == "campaign offset")
CELL = Cell(OFFSET, "constant", "campaign", "c2")
ODDS = 3.0  # of simulated rotors: enough of each
SOME = {2, 3, 8, 9, 14, 15}  # of 16, every second one odd


def test_it_is_the_ratio_of_the_exact_densities() -> None:
    """Of what each blade shows of its amplitude, normal about it with phi times its information."""
    seen, _ = fleet.rotor(3, lambda b, k: 0.4 * (b % 3 == 0) * (k == 2))
    g = np.zeros(seen.q.shape)
    g[:, 2] = 0.1
    pull = 0.2 * np.random.default_rng(4).normal(size=g.shape)
    (told,) = concerned(seen, [Amplitude(CELL, 1.2, 0.1, g, pull)])
    own = np.array([one @ k @ one for one, k in zip(g, seen.information, strict=True)])
    shown = np.einsum("bi,bi->b", g, seen.q) + pull.sum(axis=1)

    def p(moved: float, phi: float) -> np.ndarray:
        return np.asarray(norm.pdf(shown, own * moved, np.sqrt(phi * own)))

    every = np.mean([np.prod(p(0.0, phi)) for phi in PHI])
    some, has = [], {}
    for s in SHARES:
        parts = [((1 - s) * p(-1.2, phi), s * p(1.2 / s - 1.2, phi)) for phi in PHI]
        each = np.array([np.prod(a + b) for a, b in parts])
        some.append(each.mean())
        has[s] = each @ np.array([b / (a + b) for a, b in parts]) / each.sum()
    assert told.nat == pytest.approx(math.log(np.mean(some) / every), abs=1e-9)
    assert told.share == SHARES[int(np.argmax(some))]
    theirs = {seen.blades[b] for b in np.flatnonzero(has[told.share] > 0.5)}
    assert set(told.those) == (theirs if not told.stands else set())
    assert told.all == pytest.approx(10 / (10 + np.mean(some) / every))


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
        stands.append(Concerned("", 100, nat, 0.3).stands)
    assert np.mean(stands) >= least
    assert share == 1.0 or np.mean(stands) <= 0.01


def frequencies(found: np.ndarray, truth: np.ndarray) -> list[tuple[float, float, float]]:
    """P(all) as it is told, how often all have it, and three standard errors, by parts."""
    out = []
    for low, high in ((0.0, 0.2), (0.2, 0.6), (0.6, 0.8), (0.8, NAMED), (NAMED, 1.0)):
        at = (found >= low) & (found <= high)
        mean = found[at].mean()
        out.append((mean, truth[at].mean(), 3 * math.sqrt(mean * (1 - mean) / at.sum())))
    return out


def simulated(calibrated: bool, phi: np.ndarray) -> list[tuple[float, float, float]]:
    """4,000 rotors of 50 blades with effects of 0.2 to 2 sds each; in three of four all have it, in
    others a share that is drawn.

    calibrated  whether the noise is what the blades' scatter makes of it, and not known
    """
    rng = np.random.default_rng(9)
    told, truth = np.empty(4000), np.empty(4000, bool)
    for k in range(len(told)):
        truth[k] = rng.random() < ODDS / (1 + ODDS)
        share = 1.0 if truth[k] else rng.choice(SHARES)
        y = rng.uniform(0.2, 2.0) * (rng.random(50) < share) / share + rng.standard_normal(50)
        own = np.full(50, 1.0 / (y.var() if calibrated else 1.0))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "PHI", phi)
            nat, _, _ = shared_out(own * (y - y.mean()), own, float(y.mean()))
        told[k] = ODDS / (ODDS + math.exp(nat))
    return frequencies(told, truth)


@pytest.mark.parametrize("calibrated", [False, True])
def test_where_all_are_claimed_so_many_are(calibrated: bool) -> None:
    """The amplitude is taken as the mean has it, so that what is rather in some is said too mildly:
    of those told to be in all by 0.44 a quarter are."""
    found = simulated(calibrated, PHI)
    *doubted, likely, claimed = found
    assert abs(claimed[1] - claimed[0]) < 0.02 + claimed[2]
    assert claimed[1] > 0.95
    assert abs(likely[1] - likely[0]) < 0.02 + likely[2]
    assert all(-0.25 < seen - told < error for told, seen, error in doubted)
    assert [seen for _, seen, _ in found] == sorted(seen for _, seen, _ in found)


def test_with_the_noise_taken_for_known_they_are_not() -> None:
    """The negative control: a noise that took scatter for its own, and is taken for known."""
    told, seen, _ = simulated(True, np.ones(1))[-1]
    assert told > 0.95
    assert seen < NAMED


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
    open_ = Concerned("wear", 40, 1.2, 0.3, "", ("b1",))
    assert "is open: all have 75% of the evidence" in open_.told()
    names = tuple(f"b{i}" for i in range(15))
    some = Concerned("wear", 40, 5.0, 0.4, "", names).told()
    assert "not in all 40 blades: that some have it has 5.0 nat more, about 40% of them" in some
    assert "b11 and 3 others" in some


@pytest.mark.parametrize(
    ("word", "nats", "heard_as"),
    [
        ("effect", (-5.0, -5.0), "effect"),
        ("effect", (-5.0, 1.0), "unattributed"),
        ("effect", (5.0,), "unattributed"),
        ("not separable", (-5.0,), "not separable"),
        ("not separable", (1.0,), "not separable"),
        ("not separable", (-5.0, 5.0), "unattributed"),
        ("unattributed", (5.0,), "unattributed"),
    ],
)
def test_an_open_one_is_no_claim_and_one_of_some_no_name(
    word: Any, nats: tuple[float, ...], heard_as: str
) -> None:
    names = ("wear",) if word != "unattributed" else ()
    first = Verdict(word, 0.01, None, names, None, (), {}, {}, (), ("why",))
    told = tuple(Concerned("wear", 40, nat, 0.3) for nat in nats)
    found = heard(first, told)
    assert found.word == heard_as
    assert found.concerns == told
    assert found.names == (names if heard_as == word else ())
    assert [one.told() in found.reasons for one in told] == [nat > -5.0 for nat in nats]


def test_where_nothing_tells_an_effect_is_of_all() -> None:
    assert Concerned("wear", 40, 0.0, 0.3).stands
    assert not Concerned("wear", 40, 0.2, 0.3).stands


def test_beside_an_open_one_others_are_claimed_by_whatever_they_are_called() -> None:
    first = Verdict("effect", 0.01, None, ("loss", "offset"), None, (), {}, {}, (), ("why",))
    told = (Concerned("wear", 24, -9.0, 0.3, "loss"), Concerned("offset", 40, 0.5, 0.3, "offset"))
    found = heard(first, told)
    assert (found.word, found.names) == ("effect", ("loss",))
    assert found.reasons == ("why", told[1].told())
    other = (replace(told[0], nat=0.5), replace(told[1], nat=-9.0))
    assert heard(first, other).names == ("offset",), "wear is claimed by its cause"
    neither = (other[0], told[1])
    assert heard(first, neither).word == "unattributed"
