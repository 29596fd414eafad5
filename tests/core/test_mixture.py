"""Quantiles of mixtures are those of every component, not of a bell of the same variance."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr

from core import mixture
from core.mixture import mixture_quantiles

Array = NDArray[np.float64]
P = np.array([0.025, 0.05, 0.16, 0.5, 0.84, 0.95, 0.975])
N = 4000


def unlike(kind: str) -> tuple[Array, Array, Array]:
    """Means and sds (N, 2) of components, and their weights."""
    rng = np.random.default_rng(11)
    w = rng.exponential(size=N)
    w /= w.sum()
    mean = np.stack([rng.normal(3.0, 0.2, N), rng.gamma(2.0, 1.0, N)], axis=1)
    sd = {
        "one noise": np.full(N, 0.1),
        "a noise that three readings tell": 0.1 * np.exp(rng.normal(0.0, 1.2, N)),
        "no noise": np.full(N, 1e-4),
        "a few that are far off": np.where(rng.random(N) < 0.02, 20.0, 0.3),
        "none": np.zeros(N),
    }[kind]
    return mean, np.repeat(sd[:, None], 2, axis=1), w


def exact(mean: Array, sd: Array, w: Array, p: float) -> float:
    low, high = float(np.min(mean - 9 * sd)) - 1, float(np.max(mean + 9 * sd)) + 1
    return float(brentq(lambda q: w @ ndtr((q - mean) / sd) - p, low, high, xtol=1e-13))


KINDS = ["one noise", "a noise that three readings tell", "no noise", "a few that are far off"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_quantile_holds_the_share_of_all_components_that_it_says(kind: str) -> None:
    mean, sd, w = unlike(kind)
    found = mixture_quantiles(mean, sd, w, P)
    for t in range(2):
        held = np.array([w @ ndtr((q - mean[:, t]) / sd[:, t]) for q in found[:, t]])
        assert held == pytest.approx(P, abs=1.5e-3)
        both = [exact(mean[:, t], sd[:, t], w, p) for p in P]
        total = np.sqrt(w @ (sd[:, t] ** 2 + (mean[:, t] - w @ mean[:, t]) ** 2))
        assert found[:, t] == pytest.approx(both, abs=0.02 * total)


def test_merged_by_their_means_alone_too_much_would_lie_inside(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Negative control: what was done once. 68 % of a heavy-tailed mixture were 75 %."""
    mean, sd, w = unlike("a noise that three readings tell")
    monkeypatch.setattr(mixture, "WIDTHS", 1)
    low, high = mixture_quantiles(mean, sd, w, np.array([0.16, 0.84]))[:, 0]
    inside = w @ (ndtr((high - mean[:, 0]) / sd[:, 0]) - ndtr((low - mean[:, 0]) / sd[:, 0]))
    assert inside > 0.71


def test_components_without_width_are_steps() -> None:
    mean, sd, w = unlike("none")
    found = mixture_quantiles(mean, sd, w, P)
    for t in range(2):
        assert np.array([w @ (mean[:, t] <= q) for q in found[:, t]]) == pytest.approx(P, abs=3e-3)


def test_few_components_are_not_merged() -> None:
    mean, sd, w = (values[:200] for values in unlike("a noise that three readings tell"))
    w = w / w.sum()
    found = mixture_quantiles(mean, sd, w, P)
    both = [[exact(mean[:, t], sd[:, t], w, p) for t in range(2)] for p in P]
    assert found == pytest.approx(np.array(both), abs=1e-9)


def test_an_hour_s_quantiles_depend_on_no_other_hour() -> None:
    mean, sd, w = unlike("a noise that three readings tell")
    together = mixture_quantiles(mean, sd, w, P)
    for t in range(2):
        alone = mixture_quantiles(mean[:, [t]], sd[:, [t]], w, P)
        assert np.array_equal(alone[:, 0], together[:, t])


def test_quantiles_move_and_stretch_with_the_unit() -> None:
    mean, sd, w = unlike("a noise that three readings tell")
    found = mixture_quantiles(mean, sd, w, P)
    other = mixture_quantiles(1e-6 * (mean + 5.0), 1e-6 * sd, w, P)
    assert other == pytest.approx(1e-6 * (found + 5.0), rel=1e-7)
