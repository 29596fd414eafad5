"""What a campaign of all blades tells of rivals: against exact normals, and scans as simulated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from core.calibration.online import RotorSpec, update
from core.diagnosis import of_all as module
from core.diagnosis.adopt import with_effects
from core.diagnosis.families import FAMILIES
from core.diagnosis.grammar import Cell, Facts
from core.diagnosis.of_all import of_all, told_by
from core.diagnosis.separate import Separation, Told, a_set
from core.model import rotor_blade, rotor_blade_wide
from core.observation import Inspection
from core.planning.ahead import Drawn, expected
from core.planning.campaigns import SCANNED, Campaign, awaited, campaigns, compiled_for
from core.planning.candidates import ANOTHER, Candidate, candidates
from core.planning.moments import Awaited
from core.surrogate.driven import Driven
from core.validation.simulate import scan
from tests.core.calibration.test_exact import conjugate
from tests.core.diagnosis.test_separate import (
    BLADES,
    SIGMA,
    Exact,
    found,
    outcomes,
    reading_of,
)

__all__ = ["found"]
NEXT = tuple((f"b{b}", 2.0) for b in range(BLADES))


def by(instrument: str) -> Campaign:
    return Campaign("y", 0.5, NEXT, instrument, SIGMA)


def test_what_a_campaign_is_expected_to_read_is_what_exact_normals_expect(
    found: tuple[Separation, list[Inspection]],
) -> None:
    """Means and the whole covariance; between blades most where the instrument never read yet."""
    got, data = found
    taken = [reading_of(Candidate(b, "y", h, 0.5, "g2", SIGMA), i) for i, (b, h) in enumerate(NEXT)]
    rival = got.rivals[0]
    before = [r for r in data if r.instrument == "g1"]
    spec = RotorSpec("r", tuple(b for b, _ in NEXT), particles=3200, seed=3)
    alike = []
    for read, state in ((data, rival.state), (before, update(rival.model, spec, before))):
        told = awaited(rival.model, state, by("g2"))
        mean, covariance = Exact("instrument").given(read, taken)
        sd = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(told.mean[:, 0], mean, atol=0.12 * sd.max())
        whole = told.common[:, 0] @ told.common[:, 0].T + np.diag(told.own[:, 0, 0])
        unit = np.outer(sd, sd)
        np.testing.assert_allclose(whole / unit, covariance / unit, atol=0.1)
        alike.append(covariance[0, 1] / unit[0, 1])
    assert alike[0] < 0.1 < 0.5 < alike[1]


def test_a_campaign_separates_in_the_share_of_cases_that_was_said(
    found: tuple[Separation, list[Inspection]],
) -> None:
    """Readings from each rival, judged by exact evidence; the control tells nothing."""
    got, data = found
    ((first, told), (_, idle)) = of_all(got.rivals, [by("g1"), by("g2")])
    assert first.instrument == "g2"
    asked = [Candidate(b, "y", h, 0.5, "g2", SIGMA) for b, h in NEXT]
    share, settled = outcomes(data, asked, np.random.default_rng(5))
    assert share == pytest.approx(told.share, abs=0.04)
    assert settled == pytest.approx(told.settled, abs=0.06)
    assert told.gain > got.single[0][1].gain + 0.05, "more than one blade tells"
    assert idle.gain < 0.02
    assert idle.share == pytest.approx(0.5, abs=0.03)


def test_draws_and_densities_are_those_of_the_normal_that_is_meant() -> None:
    """Against the dense covariance, and information against the rule for a few readings."""
    rng = np.random.default_rng(2)

    def normal(moved: float) -> Awaited:
        root = 0.4 * rng.normal(size=(3, 2, 2))
        own = np.einsum("bij,bkj->bik", root, root) + 0.3 * np.eye(2)
        return Awaited(rng.normal(size=(3, 2)) + moved, own, 0.5 * rng.normal(size=(3, 2, 2)))

    def dense(one: Awaited) -> np.ndarray:
        u = one.common.reshape(6, -1)
        out = u @ u.T
        for b in range(3):
            out[2 * b : 2 * b + 2, 2 * b : 2 * b + 2] += one.own[b]
        return out

    each = [normal(0.0), normal(0.4)]
    y = each[0].drawn(40_000, rng)
    assert np.cov(y.reshape(-1, 6).T) == pytest.approx(dense(each[0]), abs=0.03)
    off = y[:50].reshape(-1, 6) - each[1].mean.ravel()
    value = -0.5 * np.einsum("ni,ij,nj->n", off, np.linalg.inv(dense(each[1])), off)
    value -= 0.5 * np.linalg.slogdet(dense(each[1]))[1]
    assert each[1].log_density(y[:50]) == pytest.approx(value)
    p = np.array([0.4, 0.6])
    mean, covariance = np.array([e.mean.ravel() for e in each]), np.array([dense(e) for e in each])
    told, exact = told_by(p, each), a_set(p, mean, covariance)
    assert told.gain == pytest.approx(exact.gain, abs=0.03)
    assert told.share == pytest.approx(exact.share, abs=0.03)
    assert told_by(p, [each[0], each[0]]).gain == pytest.approx(0.0, abs=1e-9)


def test_a_scan_is_expected_as_it_is_simulated() -> None:
    """Scans simulated at a blade's particles: mean and covariance of their part on the modes."""
    model, blades = rotor_blade(), ("B1", "B2")
    data = [
        Inspection(f"{b}-{h}", b, "elongation", h, np.array([y]), sigma=0.02)
        for b in blades
        for h, y in ((8e3, 0.12), (16e3, 0.2))
    ]
    state = update(model, RotorSpec("r", blades, 800, 3), data)
    (now, _) = [c for c in campaigns(model, blades, data) if c.quantity == "deformation"]
    assert now.nodes is not None
    assert len(now.nodes) == SCANNED
    assert now.blades == (("B1", 16e3), ("B2", 16e3))
    nodes = np.array(now.nodes[::8])
    asked = replace(now, nodes=tuple(nodes.tolist()), sigma=0.001)
    told = awaited(model, state, asked)
    phi = model.surrogate.deformation_modes(nodes.tolist())
    q, _ = np.linalg.qr(phi.reshape(3 * len(nodes), -1))
    rng, drawn = np.random.default_rng(4), Drawn.of(state, "B1")
    names = model.input_names
    x = np.stack([drawn.posterior.column(n) for n in names], axis=1)
    some = rng.choice(len(x), 1500, p=drawn.w)
    noise = {"sigma_obs.deformation": 0.001}
    z = np.array([q.T @ scan(model, x[i], 16e3, nodes, noise, rng).ravel() for i in some])
    whole = told.own[0] + told.common[0] @ told.common[0].T
    sd = np.sqrt(np.diag(whole))
    assert (z.mean(axis=0) - told.mean[0]) / sd == pytest.approx(0.0, abs=0.1)
    assert np.cov(z.T) / np.outer(sd, sd) == pytest.approx(whole / np.outer(sd, sd), abs=0.12)


def test_blades_of_several_ages_are_compiled_for_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """One reading or a campaign, a worn lot or the others: once a model and a quantity."""
    hours = {"B1": 8e3, "B2": 16e3, "B3": 16e3}
    data = [Inspection(b, b, "elongation", h, np.array([0.2])) for b, h in hours.items()]
    wear = Cell(next(f for f in FAMILIES if f.name == "coating wear"), "linear", "coating_lot", "C")
    facts = {b: Facts(coating_lot="C" if b == "B3" else "D") for b in hours}
    model = with_effects(rotor_blade_wide(), [wear], facts, {"elongation": 0.02}, hours)
    state = update(model, RotorSpec("r", tuple(hours), 400, 3), data)
    made, whole = [], Driven.compiled

    def counted(self: Driven, wanted: Any, times: Any, *more: Any) -> Any:
        made.append(([one.quantity for one in wanted], list(times)))
        return whole(self, wanted, times, *more)

    monkeypatch.setattr(Driven, "compiled", counted)
    asked = [c for c in candidates(model, tuple(hours), data, [0.0]) if c.quantity == "elongation"]
    several = expected(model, state, asked)
    length, shape = ["elongation"], ["deformation"]
    assert sorted(made) == [(length, [8e3, 16e3]), (length, [16e3])]
    assert expected(model, state, asked[1:2]).mean[0] == several.mean[1]
    made.clear()
    whole_rotor = [c for c in campaigns(model, tuple(hours), data) if c.ahead_h > 0]
    some = [one for one in whole_rotor if one.quantity != "ceeq"]
    each = [awaited(model, state, one) for one in some]
    later = [h + one.ahead_h for one in some[:1] for h in (8e3, 16e3)]
    expect = [(length, later), (length, later[1:]), (shape, later), (shape, later[1:])]
    assert made == expect, "elongations, then scans"

    model = with_effects(rotor_blade_wide(), [wear], facts, {"elongation": 0.02}, hours)
    made.clear()
    compiled_for(model, state, asked, some)
    both = [["elongation", "deformation"]]
    assert [names for names, _ in made] == 2 * both, "all at once, of each of the two models"
    for one, before in zip(some, each, strict=True):
        again = awaited(model, state, one)
        for name in ("mean", "own", "common"):
            assert np.array_equal(getattr(again, name), getattr(before, name)), name
    assert expected(model, state, asked).mean.tolist() == several.mean.tolist()
    assert len(made) == 2, "nothing is compiled a second time"


def test_every_quantity_is_read_by_everybody_and_of_a_formula_there_are_no_shapes() -> None:
    model, blades = rotor_blade(), ("B1", "B2")
    nodes = np.array([1, 7, 9])
    shape = Inspection("s", "B1", "deformation", 9e3, np.zeros((3, 3)), nodes)
    length = Inspection("e", "B1", "elongation", 8e3, np.array([0.1]), instrument="g")
    found = campaigns(model, blades, [shape, length])
    assert {c.quantity for c in found} == {"elongation", "deformation", "ceeq"}
    assert {c.instrument for c in found if c.quantity == "elongation"} == {"g", ANOTHER}
    (now, later) = [c for c in found if c.quantity == "deformation"]
    assert now.nodes == (1, 7, 9)
    assert now.blades == (("B1", 9e3),), "a blade that nobody read has no hours yet"
    assert [b for b, _ in later.blades] == ["B1", "B2"]
    assert now.to_json()["nodes"] == 3
    plain = campaigns(conjugate(2), ("b0",), [Inspection("e", "b0", "y", 1.0, np.array([0.1]))])
    assert {c.quantity for c in plain} == {"y"}


def test_readers_that_no_rival_tells_apart_are_asked_about_once(
    found: tuple[Separation, list[Inspection]],
) -> None:
    got, _ = found
    (_, campaign) = got.rivals
    ((one, told),) = of_all([campaign, campaign], [by("g1"), by("g2")])
    assert one.instrument is None
    assert told.gain == pytest.approx(0.0, abs=1e-9)
    assert len(of_all(got.rivals, [by("g1"), by("g2")])) == 2


def test_of_campaigns_that_tell_as_much_the_one_that_is_sooner_comes_first(
    found: tuple[Separation, list[Inspection]], monkeypatch: pytest.MonkeyPatch
) -> None:
    got, _ = found
    gains = {0.5: 1.2401, 0.25: 1.2399, 0.125: 0.7}
    monkeypatch.setattr(module, "_awaited_by", lambda rivals, asked, known: asked)
    monkeypatch.setattr(module, "told_by", lambda p, asked: Told(gains[asked.ahead_h], 0.9, 0.8))
    asked = [replace(by("g1"), ahead_h=ahead) for ahead in gains]
    assert [one.ahead_h for one, _ in of_all(got.rivals, asked)] == [0.25, 0.5, 0.125]
