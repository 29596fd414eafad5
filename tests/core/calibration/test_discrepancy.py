"""Discrepancies on the shared level: exact posteriors, recovery, and what they must not break."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from core.calibration.online import update
from core.calibration.state import Posterior, RotorSpec, RotorState, shared_posterior
from core.discrepancy import affine, total
from core.model import Model
from core.network import Discrepancy
from core.observation import Inspection
from tests.core.calibration.drifting import KINDS, LOCAL_SD, S, drifting, measured

NONE = Discrepancy()


def calibrated(model: Model, data: list[Inspection], seed: int = 3) -> RotorState:
    blades = tuple(sorted({r.blade for r in data}))
    return update(model, RotorSpec("r", blades, particles=2000, seed=seed), data)


def shared(state: RotorState) -> Posterior:
    return shared_posterior(state.meta, state.arrays.__getitem__)


def moments(values: np.ndarray, w: np.ndarray) -> tuple[float, float]:
    mean = float(w @ values)
    return mean, float(np.sqrt(w @ (values - mean) ** 2))


def factors(model: Model, posterior: Posterior, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Gain and offset at t, one per shared particle."""
    one = affine(model, model.network.quantity("y"), t)
    zero = np.zeros(len(posterior.particles.log_w))
    gain, offset = (total(terms, posterior.column) for terms in (one.gain, one.offset))
    return 1 + gain + zero, offset + zero


# --- exact answers ------------------------------------------------------------------------------


def grid(kind: str, times: np.ndarray, n: int = 61) -> tuple[np.ndarray, ...]:
    """Every combination of the shared parameters, their log prior mass, gain and offset (N, T).

    The Gaussian process is taken at the readings' times themselves, by its covariance: no modes.
    """
    sd = KINDS[kind].sd
    assert sd is not None
    s = np.linspace(S.low, S.high, 121)
    z = np.linspace(-4, 4, n)
    count = {"constant": 1, "paper": 2, "gp": len(times)}[kind]
    axes = np.meshgrid(s, *[z] * count, indexing="ij")
    s, zs = axes[0].ravel(), np.stack([a.ravel() for a in axes[1:]])
    log_prior = -0.5 * ((s - S.mean) / S.sd) ** 2 - 0.5 * np.sum(zs**2, axis=0)
    log_prior -= np.log(np.exp(log_prior).sum())
    gain, offset = np.ones((len(s), len(times))), np.zeros((len(s), len(times)))
    if kind == "constant":
        offset += sd * zs[0][:, None]
    elif kind == "paper":
        gain += (sd * zs[0] - sd * zs[1] * s)[:, None]
    else:
        apart = (times[:, None] - times) / KINDS[kind].length_h
        root = np.linalg.cholesky(np.exp(-0.5 * apart**2) + 1e-12 * np.eye(len(times)))
        gain += sd * (root @ zs).T
    return s, log_prior, gain, offset


def enumerated(kind: str, data: list[Inspection], sigma: float) -> tuple:
    """Posterior weights on the grid, with the local parameter integrated in closed form."""
    times = np.array(sorted({r.time_h for r in data}))
    s, log_p, gain, offset = grid(kind, times)
    loading = LOCAL_SD * gain * (0.5 + times)
    load = np.sum(loading**2, axis=1)
    for blade in sorted({r.blade for r in data}):
        y = np.array([r.values[0] for r in data if r.blade == blade])
        miss = y - gain * (3 + s[:, None] * times) - offset
        along = np.sum(miss * loading, axis=1)
        chi2 = (np.sum(miss**2, axis=1) - along**2 / (sigma**2 + load)) / sigma**2
        log_det = len(y) * np.log(2 * np.pi * sigma**2) + np.log1p(load / sigma**2)
        log_p = log_p - 0.5 * (chi2 + log_det)
    top = log_p.max()
    w = np.exp(log_p - top)
    return s, gain, offset, w / w.sum(), top + np.log(w.sum())


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_its_exact_posterior_and_evidence(kind: str) -> None:
    times, sigma = (0.5, 2.0), 0.05
    data = measured(lambda y, t: 0.05 * y, 5, blades=4, times=times, noise=sigma, told=sigma)
    model = drifting(KINDS[kind])
    state = calibrated(model, data)
    s, gain, offset, w, evidence = enumerated(kind, data, sigma)
    assert state.meta["log_evidence"] == pytest.approx(evidence, abs=0.06)
    posterior = shared(state)
    pairs = [(posterior.column("s"), s)]
    for i, t in enumerate(times):
        g, o = factors(model, posterior, t)
        pairs.append(
            (g * (3 + t * posterior.column("s")) + o, gain[:, i] * (3 + t * s) + offset[:, i])
        )
        pairs.append((g + o, gain[:, i] + offset[:, i]))
    for got, expected in pairs:
        mean, sd = moments(got, posterior.particles.w)
        true_mean, true_sd = moments(expected, w)
        assert abs(mean - true_mean) < 0.1 * true_sd
        assert sd == pytest.approx(true_sd, rel=0.1)


# --- recovery -----------------------------------------------------------------------------------

WRONG: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "constant": lambda y, t: np.full_like(y, 0.25),
    "paper": lambda y, t: y * (0.06 + 0.02 * 2.1),
    "gp": lambda y, t: y * 0.07 * np.cos(t),
}
TRUE_S = 2.1


def off(values: np.ndarray, w: np.ndarray, truth: float) -> float:
    """Distance of the posterior mean from the truth in posterior standard deviations."""
    mean, sd = moments(values, w)
    return abs(mean - truth) / sd


@pytest.mark.parametrize("kind", KINDS)
def test_a_discrepancy_is_recovered_and_without_it_the_shared_parameter_is_biased(
    kind: str,
) -> None:
    data = measured(WRONG[kind], 1, s=TRUE_S, told=0.02)
    model = drifting(KINDS[kind])
    posterior = shared(calibrated(model, data))
    w = posterior.particles.w
    assert off(posterior.column("s"), w, TRUE_S) < 2.5
    for t in (0.0, 1.0):
        gain, offset = factors(model, posterior, t)
        y = 3 + TRUE_S * t
        delta = (gain - 1) * y + offset
        truth = WRONG[kind](np.array([y]), t)[0]
        assert off(delta, w, truth) < 2.5
    plain = shared(calibrated(drifting(NONE), data))
    assert off(plain.column("s"), plain.particles.w, TRUE_S) > 6, "negative control"


@pytest.mark.parametrize("kind", KINDS)
def test_a_discrepancy_does_no_harm_where_there_is_none(kind: str) -> None:
    model = drifting(KINDS[kind])
    for seed in (1, 2, 3):
        data = measured(lambda y, t: 0 * y, seed, s=TRUE_S)
        state = calibrated(model, data)
        posterior = shared(state)
        w = posterior.particles.w
        assert state.meta["health"]["ess_ratio"] > 0.1
        assert off(posterior.column("s"), w, TRUE_S) < 2.5
        assert off(np.log(posterior.column("sigma_obs.y")), w, np.log(0.02)) < 2.5
        gain, offset = factors(model, posterior, 1.0)
        assert off((gain - 1) * (3 + TRUE_S) + offset, w, 0.0) < 2.5


def test_the_numerical_error_of_a_corrected_model_is_that_of_its_answer() -> None:
    """A constant far larger than the answer must not bring its own share of the mesh's error."""
    far = Discrepancy("constant", sd=5.0)
    model = drifting(far, numerical=0.05)
    data = measured(lambda y, t: 0 * y, 1, times=(0.5,), blades=1, told=0.01)
    moved = [Inspection("m", "b0", "y", 0.5, data[0].values + 8.0, sigma=0.01)]
    state, shifted = calibrated(model, data), calibrated(model, moved)
    (mean, sd), (mean_moved, sd_moved) = (
        moments(p.column("theta.y") + 0.5 * p.column("s"), p.particles.w)
        for p in (shared(state), shared(shifted))
    )
    assert mean_moved - mean == pytest.approx(8.0, abs=0.1)
    assert sd_moved == pytest.approx(sd, rel=0.03)
    assert sd == pytest.approx(np.hypot(0.05 * 4.05, 0.02), rel=0.15)  # 5 % of the answer


# --- noise by instrument ------------------------------------------------------------------------


def by_two_instruments(sharp: float, blunt: float) -> list[Inspection]:
    """Three readings in four by the blunt instrument, the others by the sharp one."""
    out, rng = [], np.random.default_rng(2)
    for i, clean in enumerate(measured(lambda y, t: 0 * y, 7, s=TRUE_S, blades=12, noise=0.0)):
        name = "sharp" if i % 4 == i // 4 % 4 else "blunt"
        noise = (sharp if name == "sharp" else blunt) * rng.standard_normal(1)
        out.append(replace(clean, values=clean.values + noise, instrument=name))
    return out


def test_each_instrument_has_its_own_noise() -> None:
    data = by_two_instruments(0.01, 0.08)
    posterior = shared(calibrated(drifting(NONE, by_instrument=True), data))
    w = posterior.particles.w
    assert posterior.names == ("s", "sigma_obs.y@blunt", "sigma_obs.y@sharp")
    for name, truth in (("sharp", 0.01), ("blunt", 0.08)):
        assert off(np.log(posterior.column(f"sigma_obs.y@{name}")), w, np.log(truth)) < 2.5
    assert off(posterior.column("s"), w, TRUE_S) < 2.5
    pooled = shared(calibrated(drifting(NONE), data))
    assert pooled.names == ("s", "sigma_obs.y")
    one = np.log(pooled.column("sigma_obs.y"))
    assert off(one, pooled.particles.w, np.log(0.01)) > 5, "negative control"
    assert (
        moments(posterior.column("s"), w)[1] < moments(pooled.column("s"), pooled.particles.w)[1]
    ), "what is known of the noises sharpens the rest"


def test_readings_that_name_no_instrument_share_one_noise() -> None:
    data = by_two_instruments(0.02, 0.02)
    data = [replace(r, instrument=None if r.instrument == "sharp" else "blunt") for r in data]
    names = shared(calibrated(drifting(NONE, by_instrument=True), data)).names
    assert names == ("s", "sigma_obs.y", "sigma_obs.y@blunt")


# --- many shared parameters, and the order of arrival --------------------------------------------


def test_six_shared_parameters_are_calibrated() -> None:
    """s, two noises and three modes: recovered, on enough nodes."""
    model = drifting(KINDS["gp"], by_instrument=True)
    data = by_two_instruments(0.01, 0.05)
    data = [replace(r, values=r.values + WRONG["gp"](r.values, r.time_h)) for r in data]
    state = calibrated(model, data)
    posterior = shared(state)
    w = posterior.particles.w
    assert len(posterior.names) == 6
    assert state.meta["health"]["ess_ratio"] > 0.1
    assert off(posterior.column("s"), w, TRUE_S) < 2.5
    gain, _ = factors(model, posterior, 1.0)
    assert off(gain - 1, w, 0.07 * np.cos(1.0)) < 2.5


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_of_arrival_changes_nothing(kind: str) -> None:
    model = drifting(KINDS[kind])
    data = by_two_instruments(0.03, 0.03)[: 40 if kind == "gp" else 24]
    state = calibrated(model, data)
    before = calibrated(model, data[:-4])
    again = update(model, RotorSpec("r", state.meta["blades"], 2000, 3), data[::-1], before)
    assert again.digest == state.digest
