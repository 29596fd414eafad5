"""What an inspection is worth: against exact normals, and against calibrations with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.draws import even_points
from core.calibration.online import update
from core.calibration.state import Arrays, RotorSpec, RotorState, blade_posterior, shared_posterior
from core.errors import InputError
from core.model import Model
from core.observation import Inspection
from core.planning.ahead import Drawn
from core.planning.campaigns import campaigns
from core.planning.candidates import ANOTHER, Candidate, candidates, usual_interval_h
from core.planning.worth import Target, worth
from core.prediction import predict
from tests.core.calibration.test_exact import SLOPES, conjugate, exact, readings

MODEL, BLADES, SIGMA = conjugate(2), 3, 0.2
SPEC = RotorSpec("r", tuple(f"b{b}" for b in range(BLADES)), particles=12_800, seed=1)
DATA = readings(BLADES, [0.0, 0.6], seed=9, sigma=SIGMA)
AIM = Target("b1", "y", 2.0)
ASKED = tuple(
    Candidate(blade, "y", hour, hour - 0.6, None, SIGMA)
    for blade in SPEC.blades
    for hour in (0.6, 1.2, 2.0)
)


@pytest.fixture(scope="module")
def state() -> RotorState:
    return update(MODEL, SPEC, DATA)


def row(blade: str, hour: float) -> np.ndarray:
    out, b = np.zeros(1 + 2 * BLADES), int(blade[1:])
    out[0] = 0.8
    out[1 + 2 * b : 3 + 2 * b] = [SLOPES[0], SLOPES[1] * hour]
    return out


def left(aim: np.ndarray, chosen: list[Candidate]) -> float:
    """The exact sd of a linear quantity once these are read."""
    _, cov, _ = exact(MODEL, DATA, BLADES, 2)
    g = np.array([row(c.blade, c.time_h) for c in chosen])
    inner = g @ cov @ g.T + SIGMA**2 * np.eye(len(g))
    c = g @ cov @ aim
    return float(np.sqrt(aim @ cov @ aim - c @ np.linalg.solve(inner, c)))


def test_what_each_reading_leaves_is_what_exact_normals_leave(state: RotorState) -> None:
    got = worth(MODEL, state, AIM, ASKED)
    aim = row("b1", 2.0)
    _, cov, _ = exact(MODEL, DATA, BLADES, 2)
    now = float(np.sqrt(aim @ cov @ aim))
    assert got.sd == pytest.approx(now, rel=0.06)
    for candidate, sd in got.single:
        true = left(aim, [candidate])
        assert sd / got.sd == pytest.approx(true / now, abs=0.05), candidate
    best = got.single[0][0]
    assert (best.blade, best.time_h) == ("b1", 2.0)
    others = [sd for c, sd in got.single if c.blade != "b1"]
    assert min(others) > 0.9 * got.sd, "the control: other blades tell of the shared one alone"


def test_a_set_is_chosen_and_valued_as_exact_conditioning_does(state: RotorState) -> None:
    got = worth(MODEL, state, AIM, ASKED, count=3)
    now = worth(MODEL, state, AIM, ASKED).sd
    aim = row("b1", 2.0)
    _, cov, _ = exact(MODEL, DATA, BLADES, 2)
    true_now = float(np.sqrt(aim @ cov @ aim))
    sds = [sd for _, sd in got.grown]
    assert sds == sorted(sds, reverse=True)
    for k in range(1, len(got.grown) + 1):
        chosen = [c for c, _ in got.grown[:k]]
        assert sds[k - 1] / now == pytest.approx(left(aim, chosen) / true_now, abs=0.06)
    assert len({id(c) for c, _ in got.grown}) == len(got.grown), "no reading twice"


@pytest.mark.parametrize("y", [0.5, 2.5])
def test_calibrating_with_the_reading_leaves_the_sd_that_was_said(
    state: RotorState, y: float
) -> None:
    """Whatever it reads; of a worthless reading (another blade) next to nothing changes."""
    told = {(c.blade, c.time_h): sd for c, sd in worth(MODEL, state, AIM, ASKED).single}
    for blade in ("b1", "b2"):
        more = Inspection("new", blade, "y", 2.0, np.array([y]), sigma=SIGMA)
        made = update(MODEL, SPEC, [*DATA, more])
        posterior = blade_posterior(made.meta, made.arrays.__getitem__, "b1")
        after = predict(MODEL, posterior, "y", [2.0], noise=False).sd["total"][0]
        assert after == pytest.approx(told[blade, 2.0], rel=0.08)


def test_what_no_reading_takes_away_stays_in_the_sd() -> None:
    """A simulation that is 10 % off: the sd now is that of the prediction, and much of it stays."""
    network = MODEL.network
    rough = replace(network.quantities[0], numerical=0.1)
    model = Model(replace(network, quantities=(rough,)), MODEL.surrogate)
    made = update(model, SPEC, DATA)
    posterior = blade_posterior(made.meta, made.arrays.__getitem__, "b1")
    sd = predict(model, posterior, "y", [2.0], noise=False).sd
    assert sd["surrogate"][0] > 0.1 * sd["total"][0]
    got = worth(model, made, AIM, ASKED)
    assert got.sd == pytest.approx(sd["total"][0], rel=0.02)
    assert all(left >= sd["surrogate"][0] * 0.98 for _, left in (*got.single, *got.grown))
    parameters = np.sqrt(got.sd**2 - sd["surrogate"][0] ** 2)
    assert parameters == pytest.approx(sd["parameters"][0], rel=0.02)


def test_parameters_are_narrowed_as_exact_normals_say(state: RotorState) -> None:
    _, cov, _ = exact(MODEL, DATA, BLADES, 2)
    for target, aim in (
        (Target(parameter="s"), np.eye(7)[0]),
        (Target("b1", parameter="l1"), np.eye(7)[4]),
    ):
        got = worth(MODEL, state, target, ASKED)
        now = float(np.sqrt(aim @ cov @ aim))
        assert got.sd == pytest.approx(now, rel=0.08)
        for candidate, sd in got.single:
            assert sd / got.sd == pytest.approx(left(aim, [candidate]) / now, abs=0.06)
    shared = shared_posterior(state.meta, state.arrays.__getitem__)
    assert worth(MODEL, state, Target(parameter="s"), ASKED).mean == pytest.approx(
        float(shared.particles.mean[0])
    )


def test_fewer_particles_rank_alike(state: RotorState) -> None:
    whole, few = (worth(MODEL, state, AIM, ASKED, most=m) for m in (None, 1500))
    assert few.single[0][0] == whole.single[0][0]
    assert few.single[0][1] / few.sd == pytest.approx(whole.single[0][1] / whole.sd, abs=0.06)


def test_a_noisier_reading_is_worth_less_and_a_useless_one_nothing(state: RotorState) -> None:
    sharp = ASKED[5]
    vague = replace(sharp, sigma=50.0)
    got = dict(worth(MODEL, state, AIM, [sharp, vague]).single)
    assert got[sharp] < 0.8 * got[vague]
    assert got[vague] == pytest.approx(worth(MODEL, state, AIM, [vague]).sd, rel=1e-3)


def test_candidates_start_from_each_blades_latest_reading_and_end_with_the_model() -> None:
    data = [replace(r, instrument="g1", sigma=0.1) for r in DATA]
    found = candidates(MODEL, SPEC.blades, data, (0.0, 1.0, 1e9))
    assert {(c.time_h, c.ahead_h) for c in found} == {(0.6, 0.0), (1.6, 1.0)}
    assert {c.instrument for c in found} == {"g1", ANOTHER}
    assert {c.sigma for c in found} == {0.1}
    assert {c.sigma for c in candidates(MODEL, ["b0"], [replace(data[0], sigma=None)])} == {None}
    by_itself, horizon = candidates(MODEL, SPEC.blades, []), MODEL.part("y").horizon_h
    assert {c.time_h / horizon for c in by_itself} == {0.08, 0.16, 0.32}, "whatever it covers"


def test_what_is_known_without_readings_is_narrowed_by_none(state: RotorState) -> None:
    """Nothing has grown at the start."""
    grown = replace(MODEL.surrogate, formulas={"y": lambda x, t: t * x.sum(axis=1)})  # type: ignore[type-var]
    got = worth(replace(MODEL, surrogate=grown), state, replace(AIM, time_h=0.0), ASKED)
    assert (got.mean, got.sd, got.grown) == (0.0, 0.0, ())
    assert [one for one, _ in got.single] == list(ASKED)
    assert {sd for _, sd in got.single} == {0.0}


def test_a_target_that_is_none_is_refused(state: RotorState) -> None:
    for target, said in (
        (Target(), "not complete"),
        (Target("b1", "y"), "not complete"),
        (Target(parameter="colour"), "not known here"),
        (Target(parameter="l1"), "not known here"),
    ):
        with pytest.raises(InputError, match=said):
            worth(MODEL, state, target, ASKED)
    with pytest.raises(InputError, match="cannot be ranked"):
        worth(MODEL, state, AIM, [])


def test_hours_to_come_follow_the_interval_at_which_blades_are_read() -> None:
    """Not the model's own, which may reach ten times as far as anybody looks."""
    at = [("b0", 0.1), ("b0", 0.3), ("b1", 0.2), ("b1", 0.4), ("b1", 0.6), ("b2", 0.5)]
    data = [replace(DATA[0], id=f"{i}", blade=b, time_h=t) for i, (b, t) in enumerate(at)]
    assert usual_interval_h(data) == pytest.approx(0.2)
    found = candidates(MODEL, ["b0", "b2"], data)
    told = sorted({(c.blade, round(c.time_h, 9)) for c in found})
    assert told == [(b, round(h + s, 9)) for b, h in (("b0", 0.3), ("b2", 0.5))
                    for s in (0.0, 0.1, 0.2, 0.4)]  # fmt: skip
    asked = campaigns(MODEL, ["b0", "b2"], data)
    assert sorted(round(c.ahead_h, 9) for c in asked) == [0.0, 0.2]
    once = [one for one in data if one.id in ("0", "2")]
    assert usual_interval_h(once) == pytest.approx(0.15), "until they were read"


def test_blades_read_at_hours_of_their_own_are_asked_about_at_common_ones() -> None:
    """Sixty blades, sixty hours: single readings and campaigns lie at the next eighth of the usual
    interval, never before a blade's last reading and never beyond the model."""
    names, last = [f"b{b}" for b in range(60)], {f"b{b}": 1.0 + b / 97 for b in range(60)}
    data = [
        Inspection(f"{b}-{h}", b, "y", h, np.array([0.0]))
        for b, own in last.items()
        for h in (own, own / 2)
    ]
    interval, horizon = usual_interval_h(data), MODEL.part("y").horizon_h
    assert interval is not None
    found = candidates(MODEL, names, data)
    hours = {c.time_h for c in found}
    assert len(hours) <= 24
    for c in found:
        exactly = last[c.blade] + c.ahead_h
        assert exactly <= c.time_h + 1e-9
        assert c.time_h <= min(exactly + interval / 8, horizon) + 1e-9
    asked = campaigns(MODEL, names, data)
    assert {h for one in asked for _, h in one.blades} <= hours
    few = [r for r in data if r.blade in names[:5]]
    exact = {round(c.time_h - c.ahead_h, 9) for c in candidates(MODEL, names[:5], few)}
    assert exact == {round(last[b], 9) for b in names[:5]}, "few hours stay what they are"


@pytest.mark.parametrize(("nodes", "each"), [(64, 160), (128, 80), (256, 40)])
@pytest.mark.parametrize(("most", "off"), [(800, 0.1), (4000, 0.05)])
def test_a_part_of_a_blades_draws_has_the_tails_of_all(
    nodes: int, each: int, most: int, off: float
) -> None:
    """Draws of a node are in the order of the outer parameter, ten to a value. Every n-th of them
    put up to a fifth too much, or too little, below the 5 % quantile."""
    u = even_points(np.random.default_rng(0), nodes, each, 10, 3)[:, :, :1]
    own = {
        "blade/b/local": u,
        "blade/b/log_w": np.full((nodes, each), -np.log(each)),
        "shared/x": np.zeros((nodes, 1)),
        "shared/log_w": np.full(nodes, -np.log(nodes)),
    }
    state = RotorState({"local": ["l"], "shared": ["s"]}, Arrays(own, own, own.__getitem__))
    every, some = Drawn.of(state, "b"), Drawn.of(state, "b", most)
    assert every.w.size == nodes * each
    assert 0.75 * most <= some.w.size <= most
    values = some.posterior.column("l")
    assert len(np.unique(values)) > 0.9 * min(nodes * each // 10, some.w.size)
    for share in (0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95):
        tail = min(share, 1.0 - share)
        assert some.w[values <= share].sum() == pytest.approx(share, abs=off * tail), share
    given = some.w.reshape(nodes, -1).sum(axis=1)
    np.testing.assert_allclose(given, 1.0 / nodes, rtol=1e-12)
