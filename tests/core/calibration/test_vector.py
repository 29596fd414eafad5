"""exp and log of the vector kernels against numpy."""

from __future__ import annotations

import numpy as np

from core.calibration.vector import exp_each, log_each


def test_exp_is_within_its_stated_error_over_the_whole_range() -> None:
    x = np.concatenate([np.linspace(-699, 699, 200_001), [0.0, 1e-300, -1e-300]])
    out = np.empty_like(x)
    exp_each(x, out)
    assert np.max(np.abs(out / np.exp(x) - 1)) < 2e-11
    far = np.array([-1e9, 1e9])
    cut = np.empty(2)
    exp_each(far, cut)
    assert cut[0] < 1e-300
    assert np.isfinite(cut[1])


def test_log_is_within_its_stated_error_over_normal_numbers() -> None:
    x = np.exp(np.random.default_rng(0).uniform(-700, 700, 200_001))
    out = np.empty_like(x)
    log_each(x, out)
    assert np.max(np.abs(out - np.log(x))) < 1e-12 * 700
    near = 1 + np.linspace(-0.3, 0.4, 10_001)
    out = np.empty_like(near)
    log_each(near, out)
    assert np.max(np.abs(out - np.log(near))) < 1e-12
