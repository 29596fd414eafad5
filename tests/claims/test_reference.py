"""Our posteriors against stored reference posteriors (numpyro's NUTS; `core.validation.reference`).

The files were made by ``bladetwin study reference``; nothing here needs numpyro. Ours have 10,000
particles per blade, as the service keeps them. The acceptance is `core.validation.compare`'s: means
within 0.1 sd, sd ratios 0.95 … 1.05, correlations within 0.05, of every blade and every parameter,
predictions too; log evidence within 0.1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from core.calibration.layout import readings_at
from core.calibration.message import BladeMessage
from core.calibration.online import update
from core.calibration.space import shared_space
from core.calibration.state import Posterior, RotorSpec, RotorState
from core.calibration.target import assemble
from core.errors import InputError
from core.model import Model, rotor_blade
from core.network import Discrepancy
from core.observation import Inspection
from core.smc.particles import Particles
from core.validation.compare import EVIDENCE, Comparison, Moments, posteriors
from core.validation.joint import Target
from core.validation.reference import ROTORS, Stored
from core.validation.simulate import simulate
from core.validation.variants import model_of, plan

FOLDER = Path(__file__).with_name("results") / "reference"
KNOWN = 0.05  # nat of error up to which an evidence is one
KEPT = sorted(path.stem for path in FOLDER.glob("*.json"))


@lru_cache
def kept(name: str) -> Stored:
    return Stored.load(FOLDER / f"{name}.json")


@lru_cache
def calibrated(name: str) -> RotorState:
    one = kept(name)
    return update(one.model, one.rotor, one.readings)


def compared(
    name: str, wrong: Callable[[Posterior], Posterior] = lambda right: right
) -> Comparison:
    """Our posterior of a rotor, made wrong or not, against its reference."""
    one = kept(name)
    found = posteriors(one.rotor, calibrated(name))
    ours = Moments.of(one.model, one.rotor, {b: wrong(p) for b, p in found.items()})
    return Comparison.of(ours, one.moments)


def test_there_are_references_enough() -> None:
    assert len(KEPT) >= 5
    assert set(KEPT) <= set(ROTORS)
    for name in KEPT:
        size = sum((FOLDER / name).with_suffix(end).stat().st_size for end in (".json", ".npz"))
        assert size < 300_000


@pytest.mark.parametrize("name", KEPT)
def test_the_references_have_converged(name: str) -> None:
    """Of the present model; R-hat, Monte-Carlo errors; the thinned draws against all of them."""
    head, m = kept(name).head, kept(name).moments
    assert head["model"] == kept(name).model.digest
    assert head["convergence"]["r_hat"] <= 1.01
    assert head["convergence"]["mean"] < 0.03
    assert head["convergence"]["sd"] < 0.02
    assert head["convergence"]["correlation"] < 0.02
    assert head["convergence"]["divergent"] < 0.01
    assert min(head["ess"].values()) >= 1000
    shared = kept(name).shared
    first = len(m.names) - 1 - shared.shape[1]
    far = np.abs(shared.mean(axis=0) - m.mean[0, first:-1]) / m.sd[0, first:-1]
    assert np.all(far < 4.5 / np.sqrt(len(shared)))


@pytest.mark.parametrize("name", KEPT)
def test_means_spreads_and_correlations_are_those_of_the_reference(name: str) -> None:
    """Every parameter of every blade, the shared ones and predictions; none is left out."""
    found = compared(name).beyond()
    assert not any(found.values()), found


@pytest.mark.parametrize("name", KEPT)
def test_the_evidence_is_that_of_the_reference(name: str) -> None:
    """Importance sampling from NUTS's draws, whose own error is small for all that are kept."""
    there = kept(name).head["log_evidence"]
    assert there["error"] < KNOWN
    assert abs(calibrated(name).meta["log_evidence"] - there["value"]) < EVIDENCE


def narrower(right: Posterior) -> Posterior:
    """Every parameter a tenth closer to its mean."""
    psi, w = right.particles.psi, right.particles.w
    mean = w @ psi
    return Posterior(right.names, Particles(mean + 0.9 * (psi - mean), right.particles.log_w))


def shifted(right: Posterior) -> Posterior:
    """T1T by 0.2 sd."""
    psi, w = right.particles.psi.copy(), right.particles.w
    j = right.names.index("t1t_rate")
    sd = np.sqrt(w @ (psi[:, j] - w @ psi[:, j]) ** 2)
    psi[:, j] += 0.2 * sd
    return Posterior(right.names, Particles(psi, right.particles.log_w))


def apart(right: Posterior) -> Posterior:
    """Local parameters that know nothing of the shared ones."""
    rng, n = np.random.default_rng(0), 10_000
    one, other = (rng.choice(len(right.particles.w), n, p=right.particles.w) for _ in range(2))
    psi = np.concatenate([right.particles.psi[one, :3], right.particles.psi[other, 3:]], axis=1)
    return Posterior(right.names, Particles(psi, np.zeros(n)))


@pytest.mark.parametrize("name", KEPT)
@pytest.mark.parametrize(
    ("wrong", "seen"), [(narrower, "ratio"), (shifted, "mean"), (apart, "correlation")]
)
def test_a_wrong_posterior_fails_the_same_comparison(
    name: str, wrong: Callable[[Posterior], Posterior], seen: str
) -> None:
    """Negative controls."""
    assert compared(name, wrong).beyond()[seen]


@pytest.mark.parametrize("name", KEPT)
def test_a_message_has_no_jumps_along_t1t(name: str) -> None:
    """On lines through the posterior, where the reference lies: a part of a tube that is missed at
    some values is a jump there, and no average over nodes hides it."""
    one, shared = kept(name), kept(name).shared.astype(float)
    readings = [[i for i in one.readings if i.blade == b] for b in one.rotor.blades]
    rows = [found for own in readings if (found := assemble(one.model, own)) is not None]
    space = shared_space(one.model, rows)
    target, s = Target.of(one.model, one.rotor, one.readings), shared.shape[1]
    assert space.names == target.shared
    assert space.names[0] == "t1t_rate"
    working = np.where(target.logarithmic[:s], np.log(shared), shared)
    unit = (working - target.low[:s]) / (target.high - target.low)[:s]
    jumps = []
    for q in (0.1, 0.5, 0.9):
        at = np.tile(np.quantile(unit, q, axis=0), (81, 1))
        at[:, 0] = np.linspace(*np.quantile(unit[:, 0], [0.02, 0.98]), 81)
        for own, found in zip((r for r in readings if r), rows, strict=True):
            column = BladeMessage(one.model, found, space, {}).column(at)
            bend = np.abs(np.diff(column, 2)).max()
            if bend > 0.1:
                jumps.append(f"{own[0].blade} at {q}: {bend:.2f} nat")
    assert not jumps, jumps


def readings() -> list[Inspection]:
    """Two blades of a warm rotor."""
    values = {"B1": (0.31, 0.44), "B2": (0.21, 0.52)}
    return [
        Inspection(f"{b}-{k}", b, "elongation", t, np.array([v]))
        for b, own in values.items()
        for k, (t, v) in enumerate(zip((8e3, 24e3), own, strict=True))
    ]


@pytest.fixture(scope="module")
def model() -> Model:
    return rotor_blade()


def test_the_sampled_target_is_the_product_of_the_readings_densities(model: Model) -> None:
    """Against the rows themselves, at a point off every centre."""
    target = Target.of(model, RotorSpec("two", ("B1", "B2")), readings())
    rng = np.random.default_rng(3)
    shared, local, total = rng.random(2), rng.random((2, 3)), 0.0
    for b, blade in enumerate(target.blades):
        rows = assemble(model, [i for i in readings() if i.blade == blade])
        assert rows is not None
        u = target.low + np.concatenate([shared, local[b]]) * (target.high - target.low)
        x = dict(zip(target.shared + target.local, u, strict=True))
        mean, sd = rows.response.evaluate(np.array([[x[n] for n in model.input_names]]))
        var = np.exp(2 * u[1]) + rows.extra + (rows.relative * rows.y) ** 2 + sd[0] ** 2
        total += float(np.sum(-0.5 * (rows.y - mean[0]) ** 2 / var - 0.5 * np.log(2 * np.pi * var)))
    assert abs(target.log_joint(np, shared, local) - total) < 1e-9 * abs(total)


def test_a_message_is_the_sampled_target_integrated_over_a_blade(model: Model) -> None:
    """By 48³ Gauss–Legendre points of one writing, nested adaptive quadrature of the other."""
    target = Target.of(model, RotorSpec("two", ("B1", "B2")), readings())
    x, w = np.polynomial.legendre.leggauss(48)
    local = np.stack(np.meshgrid(*[(x + 1) / 2] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    log_w = np.log(np.einsum("i,j,k->ijk", w, w, w).ravel() / 8)
    for b, blade in enumerate(target.blades):
        rows = assemble(model, [i for i in readings() if i.blade == blade])
        assert rows is not None
        message = BladeMessage(model, rows, shared_space(model, [rows]), {})
        own = target.blade == b
        for shared in np.array([[0.3, 0.75], [0.6, 0.7], [0.8, 0.85]]):
            u = target.low[:2] + shared * (target.high - target.low)[:2]
            mean, var = (v[:, target.row[own]] for v in target.rows_at(np, shared, local))
            var = var + target.extra[own] + np.exp(2 * u[1])
            miss = (target.y[own] - mean) ** 2 / var
            log_l = -0.5 * np.sum(miss + np.log(2 * np.pi * var), axis=1) + log_w
            top = log_l.max()
            found = top + np.log(np.exp(log_l - top).sum())
            assert abs(message.column(shared[None])[0] - found) < 1e-3, (blade, shared)


def test_the_sampled_target_holds_priors_offsets_and_scans() -> None:
    """Against the readings as the compiled messages get them, with a normal offset of elongations
    and one of each direction of a scan."""
    variant = plan("eight-shared", 8)
    model = model_of(variant)
    made = simulate(model, variant, 0, 5)
    rotor = RotorSpec("eight", tuple(made.local))
    target = Target.of(model, rotor, made.readings)
    by_blade = [[i for i in made.readings if i.blade == b] for b in rotor.blades]
    rows = [assemble(model, own) for own in by_blade]
    space = shared_space(model, [r for r in rows if r is not None])
    assert space.names == target.shared
    assert len(space.names) == 8
    assert len(target.remainders) == 3
    rng = np.random.default_rng(4)
    shared = 0.5 + 0.1 * rng.standard_normal((4, 8))
    local = rng.random((len(rotor.blades), 3))
    total = space.log_prior(shared)
    x, working = space.to_x(shared), target.low[:8] + shared * (target.high - target.low)[:8]
    inner = target.low[8:] + local * (target.high - target.low)[8:]
    for b, own in enumerate(rows):
        if own is None:
            continue
        y, s2, rest = readings_at(own, space, x)
        for k in range(len(x)):
            at = dict(zip(target.shared + target.local, (*working[k], *inner[b]), strict=True))
            point = np.array([[at[n] for n in model.input_names]])
            mean, sd = (v[0] for v in own.response.evaluate(point))
            var = s2[k] + sd**2
            total[k] += rest[k] - 0.5 * np.sum((y[k] - mean) ** 2 / var + np.log(2 * np.pi * var))
    found = np.array([target.log_joint(np, s, local) for s in shared])
    assert np.allclose(found, total, rtol=1e-9, atol=1e-6)


def test_an_offset_that_goes_with_a_parameter_has_no_second_writing(model: Model) -> None:
    quantities = tuple(
        replace(q, discrepancy=Discrepancy("paper", sd=0.05)) if q.name == "elongation" else q
        for q in model.network.quantities
    )
    other = Model(replace(model.network, quantities=quantities), model.surrogate)
    with pytest.raises(InputError, match="another kind"):
        Target.of(other, RotorSpec("two", ("B1", "B2")), readings())
