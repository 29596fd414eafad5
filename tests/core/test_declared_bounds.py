"""What a declaration may not be: gains that add up below 0, noises of 0, priors of nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import truncnorm

from core.builtin.paper_network import rotor_blade_network
from core.calibration.health import verdict
from core.course import Course
from core.drift import Bias
from core.errors import InputError
from core.network import Network, Parameter, Quantity
from core.prior import Prior
from core.quantity import Discrepancy

SOUND = {"ess_ratio": 0.9, "ess": 460.0, "nodes": 512, "tempered": 1.0, "message_tilt_nat": 0.01}


def gains(*whose: dict[str, str | tuple[str, ...]], low: float = -0.6) -> Network:
    """The paper's network with biases that multiply elongation, one for each of `whose`."""
    network = rotor_blade_network()
    names = [f"gain{k}" for k in range(len(whose))]
    amplitudes = [Parameter(n, "shared", Prior("uniform", low, 0.6)) for n in names]
    biases = [
        Bias(n, "elongation", Course.of(1.0), "times", **own)  # type: ignore[arg-type]
        for n, own in zip(names, whose, strict=True)
    ]
    return replace(network, parameters=(*network.parameters, *amplitudes), biases=tuple(biases))


def test_gains_that_concern_one_reading_add_up() -> None:
    """Control: of two instruments, or two campaigns, no reading has both."""
    gains({"instrument": "a"}, {"instrument": "b"})
    gains({"campaign": "c"}, {"campaign": "d"})
    gains({"blades": ("B1",)}, {"blades": ("B2", "B3")})
    for both in (
        ({"instrument": "a"}, {"campaign": "c"}),
        ({}, {"instrument": "a"}),
        ({"blades": ("B1", "B2")}, {"blades": ("B2", "B3")}),
    ):
        with pytest.raises(InputError, match=r"gain0 .* gain1.* fall to -0.2, below 0.1"):
            gains(*both)
        gains(*both, low=-0.4)


def test_a_gain_beside_the_papers_discrepancy_adds_up_with_it() -> None:
    def beside(network: Network) -> Network:
        of = Discrepancy("paper", prior=Prior("uniform", -0.2, 0.2))
        first, *rest = network.quantities
        return replace(network, quantities=(replace(first, discrepancy=of), *rest))

    beside(rotor_blade_network())
    beside(gains({"instrument": "a"}, low=-0.4))
    with pytest.raises(InputError, match=r"with the discrepancy, fall to .*, below 0.1"):
        beside(gains({"instrument": "a"}))


@pytest.mark.parametrize(
    "noise", [Prior.gaussian(0.03, 0.01), Prior("uniform", 0.0, 0.1), Prior("uniform", -1, 1)]
)
def test_a_noise_is_above_zero(noise: Prior) -> None:
    with pytest.raises(InputError, match="is no standard deviation"):
        Quantity("strain", "1", "scalar", noise, 0.0, 1.0)


@pytest.mark.parametrize("far", [0.5, 5.0, 8.0, 10.0, 30.0])
def test_a_normal_prior_far_below_its_bounds_is_the_mirror_of_one_far_above(far: float) -> None:
    """Against scipy's truncated normal, which goes by the tails."""
    above = Prior("normal", 2.0, 3.0, mean=2.0 - 0.1 * far, sd=0.1)
    below = Prior("normal", -3.0, -2.0, mean=-above.mean, sd=0.1)
    p, u = np.linspace(0.01, 0.99, 9), np.linspace(2.0, 2.2, 9)
    exact = truncnorm(far, far + 10.0, above.mean, 0.1)
    assert above.quantile(p) == pytest.approx(exact.ppf(p), rel=1e-9)
    assert above.quantile(p) == pytest.approx(-below.quantile(1 - p), rel=1e-9)
    assert above.log_density_u(u) == pytest.approx(exact.logpdf(u), rel=1e-9)
    assert above.log_density_u(u) == pytest.approx(below.log_density_u(-u), rel=1e-12)


def test_a_prior_of_nothing_is_refused() -> None:
    with pytest.raises(InputError, match=r"lies too far from 2 .* 3"):
        Prior("normal", 2.0, 3.0, mean=-3.0, sd=0.1)


def test_a_stored_prior_that_is_known_badly_is_told() -> None:
    assert verdict(SOUND | {"prior_error_nat": 0.4}, [], sealed=True)["status"] == "ok"
    told = verdict(SOUND | {"prior_error_nat": 1.5}, [], sealed=True)
    assert told["status"] == "degenerate"
    assert "known to 1.5 nat, 0.5 is allowed" in told["reasons"][0]
