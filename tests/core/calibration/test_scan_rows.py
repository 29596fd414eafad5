"""Rows of a scan whose simulation errs: their posterior is that of the whole scan."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from numpy.typing import NDArray

from core.calibration import responses, scans
from core.calibration.responses import DEGREE
from core.model import Model
from core.observation import Inspection
from core.validation.coverage import model_of
from core.validation.simulate import simulate
from core.validation.variants import plan

Array = NDArray[np.float64]
SEED = 11


@cache
def scanned(rotor: int) -> tuple[Model, list[Inspection], float]:
    """The scans of a simulated rotor's first blade, and their noise."""
    variant = plan("mixed")
    model = model_of(variant)
    made = simulate(model, variant, rotor, SEED)
    readings = [one for one in made.readings if one.quantity == "deformation"]
    return model, readings, made.shared["sigma_obs.deformation"]


def whole(model: Model, reading: Inspection, x: Array, sigma: float) -> Array:
    """Log density of a scan's readings in the space of its modes, at inputs x (n, d), in full."""
    surrogate, nu = model.part("deformation"), model.network.quantity("deformation").numerical
    assert reading.nodes is not None
    phi = surrogate.deformation_modes(reading.nodes.tolist())
    q, r = np.linalg.qr(phi.reshape(reading.values.size, -1))
    y = q.T @ reading.values.reshape(-1)
    mean, sd = surrogate.mode_response(reading.time_h, r, degree=DEGREE).evaluate(x)
    relative = r @ surrogate.mode_covariance(reading.time_h) @ r.T
    relative /= np.sqrt(np.outer(np.diag(relative), np.diag(relative)))
    out = np.empty(len(x))
    for some in np.array_split(np.arange(len(x)), -(-len(x) // 1000)):
        z, s = mean[some], sd[some]
        own = relative * (s[:, :, None] * s[:, None, :])
        at = np.arange(z.shape[1])
        own[:, at, at] += nu**2 * (z**2 + np.mean(z**2, axis=1, keepdims=True)) + sigma**2
        root = np.linalg.cholesky(own)
        miss = np.linalg.solve(root, (y - z)[:, :, None])[:, :, 0]
        out[some] = -0.5 * np.sum(miss**2, axis=1) - np.log(root[:, at, at]).sum(axis=1)
    return out


def by_rows(rows: scans.ScanRows, x: Array, sigma: float) -> Array:
    """The same by the rows that the calibration reads."""
    mean, sd = rows.response.evaluate(x)
    variance = sd**2 + rows.extra + sigma**2
    return np.asarray(np.sum(-0.5 * (rows.y - mean) ** 2 / variance - 0.5 * np.log(variance), 1))


def posterior_of(density: Array, prior: Array, x: Array) -> tuple[Array, Array]:
    w = np.exp(density - prior - (density - prior).max())
    w /= w.sum()
    mean = w @ x
    return mean, np.sqrt(w @ (x - mean) ** 2)


def off(rotor: int) -> tuple[Array, Array]:
    """By how many sds, and how much wider, the rows' posterior is than the whole scans'.

    All four inputs are unknown; points from a wide Student-t around the whole scans' posterior.
    """
    model, readings, sigma = scanned(rotor)
    kept = [
        scans.scan_rows(model, r, sigma, partial(responses.scanned, model, r)) for r in readings
    ]
    box = np.array([model.network.parameter(name).prior.box for name in model.input_names])
    low, high = box.T
    rng = np.random.default_rng(rotor)
    unit, drawn = rng.random((20_000, len(low))), np.zeros(20_000)
    for _ in range(6):  # from the box to the posterior, by rows alone
        x = low + unit * (high - low)
        told = sum(by_rows(one, x, sigma) for one in kept) - drawn
        power = 1.0
        while True:
            w = np.exp(power * (told - told.max()))
            w /= w.sum()
            if 1 / np.sum(w**2) > 300:
                break
            power *= 0.7
        mean = w @ unit
        spread = 1.5 * (w[:, None] * (unit - mean)).T @ (unit - mean)
        root = np.linalg.cholesky(spread + 1e-12 * np.eye(len(low)))
        z = rng.standard_normal((4000, len(low))) / np.sqrt(rng.chisquare(6, 4000) / 6)[:, None]
        unit = mean + z @ root.T
        inside = np.all((unit > 0) & (unit < 1), axis=1)
        unit, z = unit[inside], z[inside]
        drawn = -(6 + len(low)) / 2 * np.log1p(np.sum(z**2, axis=1) / 6)
    x = low + unit * (high - low)
    mean, sd = posterior_of(sum(whole(model, r, x, sigma) for r in readings), drawn, x)
    mean_rows, sd_rows = posterior_of(sum(by_rows(one, x, sigma) for one in kept), drawn, x)
    return (mean_rows - mean) / sd, sd_rows / sd


@pytest.mark.parametrize("rotor", [24, 26])
def test_the_rows_posterior_is_the_whole_scans_s(rotor: int) -> None:
    """Of 30 rotors those where rows whose errors were taken at the best fit alone erred most."""
    shift, wider = off(rotor)
    assert np.abs(shift).max() < 0.03
    assert wider == pytest.approx(1.0, abs=0.02)


def test_errors_of_the_best_fit_everywhere_would_not_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control: the surrogate's error in `extra`, as it is at the best fit."""
    real = scans.scan_rows

    def fixed(*given: object, **named: object) -> scans.ScanRows:
        rows = real(*given, **named)  # type: ignore[arg-type]
        best = 0.5 * (rows.response.low + rows.response.high)
        _, sd = rows.response.evaluate(best[None])
        still = replace(rows.response, ka=np.zeros(len(sd[0])))
        return replace(rows, response=still, extra=rows.extra + sd[0] ** 2)

    monkeypatch.setattr(scans, "scan_rows", fixed)
    assert max(np.abs(off(rotor)[0]).max() for rotor in (24, 26)) > 0.2


def test_with_the_turn_of_its_rows_a_scan_s_density_is_that_of_its_readings() -> None:
    """In evidence, too: the rows are W z, and what W stretches is told beside the remainder."""
    model, readings, sigma = scanned(24)
    box = np.array([model.network.parameter(name).prior.box for name in model.input_names])
    low, high = box.T
    x = low + np.random.default_rng(1).random((20_000, len(low))) * (high - low)
    for reading in readings:
        rows = scans.scan_rows(model, reading, sigma, partial(responses.scanned, model, reading))
        in_full, told = whole(model, reading, x, sigma), by_rows(rows, x, sigma)
        w = np.exp(in_full - in_full.max())
        left = float(w @ (in_full - told) / w.sum())
        assert left == pytest.approx(rows.dense.turned, abs=0.2), "rows are exact at the best fit"
        remainder = replace(rows.dense, turned=0.0)
        at = np.array([sigma]), np.zeros((1, 0))
        gained = rows.dense.log_density(*at) - remainder.log_density(*at)
        assert float(gained[0]) == pytest.approx(rows.dense.turned, abs=1e-9)
        assert abs(rows.dense.turned) > 0.6, "negative control: the two differ without it"
