"""Which inspection tells rivals apart: exact information, borne out by simulated readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from core.calibration.online import update
from core.calibration.state import RotorSpec
from core.diagnosis import separate as module
from core.diagnosis.adopt import with_effects
from core.diagnosis.grammar import Cell, Facts
from core.diagnosis.separate import (
    Rival,
    Separation,
    a_set,
    one_reading,
    separate,
    separation_json,
)
from core.errors import InputError
from core.observation import Inspection
from core.planning.ahead import expected
from core.planning.candidates import ANOTHER, Candidate, candidates
from tests.core.calibration.test_exact import SLOPES, conjugate
from tests.core.diagnosis.fleet import READING

SIGMA, BLADES, VISITS, SIZE = 0.15, 4, (0.5, 1.0, 1.5), 0.45
MODEL = conjugate(2)
FAMILY = {f.name: replace(f, size=SIZE) for f in READING}
CELLS = {
    "instrument": Cell(FAMILY["instrument offset"], "constant", "instrument", "g2"),
    "campaign": Cell(FAMILY["campaign offset"], "constant", "campaign", "c1"),
}


def mutual(p: np.ndarray, mean: np.ndarray, sd: np.ndarray) -> float:
    """The same integral by another rule."""

    def integrand(y: float, k: int) -> float:
        f = norm.pdf(y, mean, sd)
        return float(f[k] * np.log(f[k] / (p @ f))) if f[k] > 0 else 0.0

    ends = mean.min() - 9 * sd.max(), mean.max() + 9 * sd.max()
    return sum(
        p[k] * quad(integrand, *ends, args=(k,), points=mean.tolist(), limit=400)[0]
        for k in range(len(p))
    )


@pytest.mark.parametrize("far", [0.2, 1.0, 3.0])
def test_two_normals_have_their_exact_information(far: float) -> None:
    p, mean, sd = np.array([0.3, 0.7]), np.array([0.1, 0.1 + far]), np.array([0.5, 0.8])
    gain, _, _ = one_reading(p, mean[:, None], sd[:, None])
    assert gain[0] == pytest.approx(mutual(p, mean, sd), abs=1e-7)


def test_rivals_that_expect_the_same_are_told_apart_by_nothing() -> None:
    """The negative control; and far apart a reading tells all there is."""
    p = np.array([0.2, 0.5, 0.3])
    gain, share, settled = one_reading(p, np.full((3, 1), 0.4), np.full((3, 1), 0.1))
    assert gain[0] == pytest.approx(0.0, abs=1e-12)
    assert share[0] == pytest.approx(np.sum(p**2))
    assert settled[0] == 0.0
    assert a_set(p, np.full((3, 2), 0.4), np.tile(np.eye(2), (3, 1, 1))).gain == pytest.approx(0.0)
    gain, share, settled = one_reading(p, np.array([[0.0], [50.0], [100.0]]), np.ones((3, 1)))
    assert gain[0] == pytest.approx(-p @ np.log(p))
    assert (share[0], settled[0]) == (pytest.approx(1.0), pytest.approx(1.0))


def test_two_independent_readings_tell_as_much_as_one_that_is_root_two_as_sharp() -> None:
    p, d = np.array([0.4, 0.6]), 1.2
    one = one_reading(p, np.array([[0.0], [d * np.sqrt(2)]]), np.ones((2, 1)))
    two = a_set(p, np.array([[0.0, 0.0], [d, d]]), np.tile(np.eye(2), (2, 1, 1)))
    assert two.gain == pytest.approx(one[0][0], abs=2e-3)
    assert two.share == pytest.approx(one[1][0], abs=2e-3)
    same = np.array([[1.0, 0.9999], [0.9999, 1.0]])
    again = a_set(p, np.array([[0.0, 0.0], [d, d]]), np.tile(same, (2, 1, 1)))
    alone = one_reading(p, np.array([[0.0], [d]]), np.ones((2, 1)))
    assert again.gain == pytest.approx(alone[0][0], abs=2e-3), "the same reading twice adds nothing"


def readings() -> list[Inspection]:
    """Campaign c1 was read by instrument g2, all others by g1: their offsets are one column."""
    rng = np.random.default_rng(11)
    found = []
    for b in range(BLADES):
        local = np.array([-1.0, 0.0]) + 0.6 * rng.normal(size=2)
        for k, t in enumerate(VISITS):
            y = 1.6 + SLOPES[0] * local[0] + SLOPES[1] * t * local[1] + SIGMA * rng.normal()
            y += 0.4 * (k == 1)
            found.append(
                Inspection(f"{b}-{k}", f"b{b}", "y", t, np.array([y]), sigma=SIGMA,
                           campaign=f"c{k}", instrument="g2" if k == 1 else "g1")
            )  # fmt: skip
    return found


class Exact:
    """Both rivals as joint normals of (s, l, a): the readings' mean and covariance."""

    def __init__(self, rival: str) -> None:
        self.rival = rival

    def rows(self, data: list[Inspection]) -> tuple[np.ndarray, np.ndarray]:
        design = np.zeros((len(data), 2 + 2 * BLADES))
        for i, r in enumerate(data):
            b = int(r.blade[1:])
            design[i, 0] = 0.8
            design[i, 1 + 2 * b : 3 + 2 * b] = [SLOPES[0], SLOPES[1] * r.time_h]
            off = r.instrument == "g2" if self.rival == "instrument" else r.campaign == "c1"
            design[i, -1] = float(off)
        mean = np.array([2.0, *([-1.0, 0.0] * BLADES), 0.0])
        sd = np.array([0.5, *([0.6, 0.6] * BLADES), SIZE])
        return design @ mean, (design * sd**2) @ design.T + SIGMA**2 * np.eye(len(data))

    def log_evidence(self, data: list[Inspection]) -> float:
        m, c = self.rows(data)
        off = np.array([float(r.values[0]) for r in data]) - m
        log_det = np.linalg.slogdet(2 * np.pi * c)[1]
        return float(-0.5 * (off @ np.linalg.solve(c, off) + log_det))

    def given(self, data: list[Inspection], more: list[Inspection]) -> tuple[np.ndarray, ...]:
        """Mean and covariance of further readings."""
        m, c = self.rows([*data, *more])
        n = len(data)
        y = np.array([float(r.values[0]) for r in data])
        gain = np.linalg.solve(c[:n, :n], c[:n, n:]).T
        return m[n:] + gain @ (y - m[:n]), c[n:, n:] - gain @ c[:n, n:]


def reading_of(one: Candidate, number: int, y: float = 0.0) -> Inspection:
    return Inspection(
        f"new-{number}", one.blade, one.quantity, one.time_h, np.array([y]), sigma=SIGMA,
        instrument=one.instrument, campaign="next",
    )  # fmt: skip


@pytest.fixture(scope="module")
def found() -> tuple[Separation, list[Inspection]]:
    data = readings()
    spec = RotorSpec("r", tuple(f"b{b}" for b in range(BLADES)), particles=3200, seed=3)
    facts = {b: Facts() for b in spec.blades}
    rivals = []
    for name, cell in CELLS.items():
        model = with_effects(MODEL, [cell], facts, {"y": SIGMA})
        rivals.append(Rival((name,), model, update(model, spec, data), 0.5))
    asked = candidates(MODEL, spec.blades, data, (0.0, 0.5))
    return separate(rivals, asked), data


def test_the_instrument_that_read_once_has_to_read_again(
    found: tuple[Separation, list[Inspection]],
) -> None:
    got, _ = found
    best, told = got.single[0]
    assert best.instrument == "g2"
    assert told.gain > 0.2
    worst = {c.instrument: t for c, t in reversed(got.single)}
    for instrument in ("g1", ANOTHER):
        assert worst[instrument].gain < 0.02, "both rivals expect the same of it"
    gains = [t.gain for _, t in got.grown]
    assert gains == sorted(gains)
    assert gains[-1] <= got.entropy
    assert {c.instrument for c, _ in got.grown} == {"g2"}


def test_what_the_rivals_expect_is_what_exact_normals_expect(
    found: tuple[Separation, list[Inspection]],
) -> None:
    got, data = found
    at = (("b0", 2.0, 0.5), ("b1", 2.0, 0.5), ("b0", 1.5, 0.0))
    more = [Candidate(blade, "y", hour, ahead, "g2", SIGMA) for blade, hour, ahead in at]
    for rival in got.rivals:
        told = expected(rival.model, rival.state, more)
        taken = [reading_of(c, i) for i, c in enumerate(more)]
        mean, covariance = Exact(rival.names[0]).given(data, taken)
        sd = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(told.mean, mean, atol=0.12 * sd.max())
        np.testing.assert_allclose(told.sd, sd, rtol=0.08)
        got_c = told.covariance([0, 1, 2]) / np.outer(told.sd, told.sd)
        np.testing.assert_allclose(got_c, covariance / np.outer(sd, sd), atol=0.1)


def test_the_recommended_readings_separate_in_the_share_of_cases_that_was_said(
    found: tuple[Separation, list[Inspection]],
) -> None:
    """2,000 readings drawn from each rival, judged by exact evidence of all readings together.

    The control: the share that the set promises is not that of an instrument that tells nothing.
    """
    got, data = found
    rng = np.random.default_rng(5)
    for chosen in ([c for c, _ in got.grown[:1]], [c for c, _ in got.grown]):
        told = got.grown[len(chosen) - 1][1]
        share, settled = outcomes(data, chosen, rng)
        assert share == pytest.approx(told.share, abs=0.03)
        assert settled == pytest.approx(told.settled, abs=0.05)
    idle = [replace(c, instrument="g1") for c in chosen]
    assert outcomes(data, idle, rng)[0] < told.share - 0.1


def outcomes(
    data: list[Inspection], chosen: list[Candidate], rng: np.random.Generator
) -> tuple[float, float]:
    """Share of the true rival and how often one has 0.9 afterwards, from even shares."""
    exact = [Exact(name) for name in CELLS]
    taken = [reading_of(c, i) for i, c in enumerate(chosen)]
    moments = [e.given(data, taken) for e in exact]
    shares, settled = [], []
    for k in range(2):
        ys = rng.multivariate_normal(*moments[k], size=2000)
        log = np.array(
            [
                -0.5 * np.einsum("ni,ij,nj->n", ys - m, np.linalg.inv(c), ys - m)
                - 0.5 * np.linalg.slogdet(c)[1]
                for m, c in moments
            ]
        )
        after = np.exp(log - np.logaddexp(*log))
        shares.append(after[k].mean())
        settled.append((after.max(axis=0) >= 0.9).mean())
    return float(np.mean(shares)), float(np.mean(settled))


def test_calibrating_anew_with_a_reading_moves_the_evidence_as_exact_normals_say(
    found: tuple[Separation, list[Inspection]],
) -> None:
    """One recommended reading, as the instrument's rival expects it."""
    got, data = found
    best = got.single[0][0]
    first, second = (Exact(name) for name in CELLS)
    y = first.given(data, [reading_of(best, 0)])[0][0]
    more = [*data, reading_of(best, 0, float(y))]
    spec = RotorSpec("r", tuple(f"b{b}" for b in range(BLADES)), particles=3200, seed=3)
    log = [update(r.model, spec, more).meta["log_evidence"] for r in got.rivals]
    true = first.log_evidence(more) - second.log_evidence(more)
    assert log[0] - log[1] == pytest.approx(true, abs=0.15)
    assert true > 0.5


def test_what_is_told_names_candidates_and_what_each_rival_expects(
    found: tuple[Separation, list[Inspection]],
) -> None:
    told = separation_json(found[0], 3)
    assert [r["names"] for r in told["rivals"]] == [["instrument"], ["campaign"]]
    assert len(told["single"]) == 3
    one = told["single"][0]
    assert {"blade", "quantity", "time_h", "ahead_h", "instrument", "gain_nat", "share"} <= set(one)
    assert len(one["expected"]) == 2
    with pytest.raises(InputError, match="two or more"):
        separate(found[0].rivals[:1], [])


def test_a_set_of_one_is_that_reading_where_rivals_differ_in_how_sure_they_are_too() -> None:
    p, mean, sd = np.array([0.3, 0.7]), np.array([[0.0], [0.3]]), np.array([[0.2], [1.1]])
    gain, share, settled = one_reading(p, mean, sd)
    told = a_set(p, mean, np.square(sd)[:, :, None])
    assert told.gain == pytest.approx(gain[0], abs=2e-3)
    assert told.share == pytest.approx(share[0], abs=2e-3)
    assert told.settled == pytest.approx(settled[0], abs=5e-3)
    assert gain[0] > 0.2


def test_a_set_stops_growing_where_too_little_is_added(
    found: tuple[Separation, list[Inspection]], monkeypatch: pytest.MonkeyPatch
) -> None:
    got, _ = found
    asked = [c for c, _ in got.single[:4]]
    gains = [t.gain for _, t in separate(got.rivals, asked).grown]
    assert len(gains) > 2
    monkeypatch.setattr(module, "NOTHING", 1.01 * (gains[1] - gains[0]))
    assert len(separate(got.rivals, asked).grown) == 1
    monkeypatch.setattr(module, "NOTHING", 0.99 * (gains[1] - gains[0]))
    assert len(separate(got.rivals, asked).grown) >= 2


def test_blades_that_tell_as_much_are_counted(found: tuple[Separation, list[Inspection]]) -> None:
    got, _ = found
    best = got.single[0][0]
    told = separation_json(got)["single"][0]
    same = [t.gain for c, t in got.single if (c.instrument, c.ahead_h) == ("g2", best.ahead_h)]
    assert told["blades_alike"] == sum(g >= 0.9 * max(same) for g in same)
    one = replace(got, single=(got.single[0], *((c, replace(t, gain=0.0)) for c, t in got.single)))
    assert separation_json(replace(one, mean=got.mean[:, [0, *range(len(got.single))]],
                                   sd=got.sd[:, [0, *range(len(got.single))]])
    )["single"][0]["blades_alike"] == 1  # fmt: skip


def test_a_rival_without_a_share_is_no_division_by_nothing(
    found: tuple[Separation, list[Inspection]],
) -> None:
    got, _ = found
    first, second = got.rivals
    told = separate((first, replace(second, weight=0.0)), [c for c, _ in got.single[:3]])
    assert np.isfinite([t.gain for _, t in told.single]).all()
    assert max(t.gain for _, t in told.single) < 1e-6, "nothing is left to tell"
