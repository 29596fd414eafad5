"""How much a surrogate errs alike at different inputs (`core.surrogate.alike`)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from core.model import rotor_blade_wide
from core.surrogate.alike import _same, alike
from core.surrogate.driven import Driven
from core.surrogate.kernel import Hyper, SharedGP
from tests.core.surrogate.test_anchor import ANCHOR, FINE, FIXED, RANGES, WEAR, WIDE

Array = NDArray[np.float64]
HOUR = 30_000.0


def blades(count: int, spread: float) -> Array:
    """Of one rotor, about the middle of the fine model's box."""
    u = np.random.default_rng(3).uniform(-1, 1, (count, 4))
    u[:, 1] = 0.0
    return np.asarray(FINE.low + 0.5 * (1.0 + spread * u) * (FINE.high - FINE.low))


def test_it_is_the_mean_correlation_of_what_a_process_does_not_know() -> None:
    """Against draws: functions of the prior, conditioned on their values at the runs, are off from
    the mean by what goes together as is told; at unlike inputs, the control, by less."""
    rng = np.random.default_rng(5)
    z, hyper = rng.uniform(-1, 1, (8, 1)), Hyper((0.7,), 1e-6, 0)
    for at in (np.array([[0.8], [0.86], [0.9]]), np.array([[-0.9], [0.1], [0.95]])):
        every = np.vstack([z, at])
        prior = 1.0 / (1.0 + 0.5 * ((every - every.T) / 0.7) ** 2)
        drawn = np.linalg.cholesky(prior + 1e-6 * np.eye(11)) @ rng.normal(size=(11, 20_000))
        process = SharedGP.condition(z, drawn[:8], hyper)
        off = drawn[8:] - process.mean(at)[0]
        r = np.corrcoef(off)[np.triu_indices(3, 1)]
        assert _same(process, at) == pytest.approx(max(r.mean(), 0.0), abs=0.03)
    assert r.mean() < 0.5


def test_blades_that_are_nearly_the_same_err_alike_and_others_hardly() -> None:
    assert alike(FINE, blades(40, 0.05), HOUR) > 0.5
    assert alike(FINE, blades(40, 1.0), HOUR) < 0.2
    assert alike(FINE, blades(1, 1.0), HOUR) == 1.0
    assert alike(FINE, blades(500, 1.0), HOUR) == pytest.approx(
        alike(FINE, blades(100, 1.0), HOUR), abs=0.05
    )


def test_an_anchored_surrogate_without_an_effect_errs_as_its_fine_one() -> None:
    wide = rotor_blade_wide().surrogate
    x = blades(40, 1.0)
    assert alike(wide, x, HOUR) == pytest.approx(alike(FINE, x, HOUR), abs=1e-3)


def test_at_hour_0_nothing_has_grown_that_could_be_off() -> None:
    """Readings of no later hour are no reason to fail a diagnosis."""
    x = np.hstack([blades(3, 0.6), np.full((3, 1), 0.3)])
    assert alike(Driven(WIDE, (WEAR,), RANGES, FIXED, ANCHOR), x, 0.0) == 1.0
    assert alike(rotor_blade_wide().surrogate, blades(3, 0.6), 0.0) == 1.0


def test_what_an_effect_changes_is_known_alike_badly_in_all_blades() -> None:
    x, own = blades(40, 0.6), np.full((40, 1), 0.3)
    without, worn = np.hstack([x, 0.0 * own]), np.hstack([x, own])
    anchored = Driven(WIDE, (WEAR,), RANGES, FIXED, ANCHOR)
    assert alike(anchored, worn, HOUR) > alike(anchored, without, HOUR) + 0.02
    alone = alike(Driven(WIDE, (WEAR,), RANGES, FIXED, None), worn, HOUR)
    assert 0.0 < alone < 1.0


def test_of_two_worn_blades_it_is_what_the_two_surrogates_do_not_know_put_together() -> None:
    """By the joint covariance of the wide process at both blades, as they ran and before, and of
    the fine one; shares by their sds of the elongation."""
    x = np.hstack([blades(2, 0.3), [[0.25], [0.35]]])
    anchored = Driven(WIDE, (WEAR,), RANGES, FIXED, ANCHOR)
    assert ANCHOR is not None
    names = [i.name for i in WIDE.inputs]
    start = np.array([[{**FIXED, **ANCHOR.asleep}.get(n, np.nan) for n in names]] * 2)
    start[:, [names.index(i.name) for i in FINE.inputs]] = x[:, :4]
    middle = start.copy()
    middle[:, names.index("tbc_thickness")] *= 1.0 - x[:, 4] * 0.5 * HOUR / 5e4
    z = WIDE.scaled(np.vstack([middle, start]))
    joint = WIDE.process.cross_covariance(z, z)
    change = np.hstack([np.eye(2), -np.eye(2)])
    moved = change @ joint @ change.T
    nugget = WIDE.process.hyper.nugget
    lengths = np.array(WIDE.process.hyper.lengths)
    far = 0.5 * np.sum(((z[:2] - z[2:]) / lengths) ** 2, axis=1)
    sd = np.sqrt(np.diag(moved) + 2.0 * nugget * far / (1.0 + far))  # the nugget is hardly shared
    between = moved[0, 1] / (sd[0] * sd[1])
    zf = FINE.scaled(x[:, :4])
    own = FINE.process.cross_covariance(zf, zf)[0, 1]
    own /= np.sqrt(np.prod(FINE.process.mean_and_variance(zf, ())[1]))
    relative = [
        sd[:, 0] / y[:, 0]
        for y, sd in (
            FINE.predict(x[:, :4], "elongation", [HOUR]),
            anchored.predict(x, "elongation", np.array([HOUR])),
        )
    ]
    share = np.mean((relative[0] / relative[1]) ** 2)
    assert 0.05 < share < 0.95
    told = share * max(own, 0.0) + (1 - share) * max(between, 0.0)
    assert alike(anchored, x, HOUR) == pytest.approx(told, rel=2e-3)
