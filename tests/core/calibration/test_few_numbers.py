"""What few numbers tell with a noise they hardly know: a funnel, whose mouth needs nodes as well.

y = exp(l) + s t + sigma e. Given sigma the spread of s grows with it, so that s has tails as long
as those of the noise. The reference is exact: the same messages on a grid over the whole box.
"""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration import space as spaces
from core.calibration.online import Workspace, begun, update
from core.calibration.space import SharedSpace
from core.calibration.state import RotorSpec, RotorState, shared_posterior
from core.calibration.stored import StoredPosterior
from core.model import Model
from core.network import Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.rng import stream
from core.smc.particles import normalised
from core.surrogate.formula import FormulaInput, FormulaModel

GRID = (160, 30)


def sums() -> Model:
    shared = Parameter("s", "shared", Prior("uniform", 0.0, 2.0))
    local = Parameter("l", "local", Prior("uniform", -1.0, 1.5))
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in (shared, local))
    formula = {"y": lambda x, t: np.exp(x[:, 1]) + t * x[:, 0]}
    quantity = Quantity("y", "1", "scalar", Prior("log_uniform", 0.02, 1.0), -50.0, 50.0)
    return Model(
        Network("sums", (shared, local), (quantity,)), FormulaModel(inputs, formula, "sums")
    )


MODEL = sums()


def read(blades: int, times: tuple[float, ...], seed: int) -> tuple[RotorSpec, list[Inspection]]:
    """A rotor drawn from the prior, and its readings."""
    rng = stream(5, "few numbers", blades, seed)
    s, sigma = 2.0 * rng.random(), 0.02 * 50.0 ** rng.random()
    readings = []
    for b in range(blades):
        own = np.exp(rng.uniform(-1.0, 1.5))
        y = own + s * np.array(times) + sigma * rng.standard_normal(len(times))
        readings += [Inspection(f"{b}-{i}", f"b{b}", "y", t, y[[i]]) for i, t in enumerate(times)]
    return RotorSpec(f"r{seed}", tuple(f"b{b}" for b in range(blades)), 200, seed), readings


def of_s(state: RotorState) -> tuple[float, float]:
    """Mean and sd of s in a state."""
    posterior = shared_posterior(state.meta, state.arrays.__getitem__)
    w, s = posterior.particles.w, posterior.column("s")
    return float(w @ s), float(np.sqrt(w @ (s - w @ s) ** 2))


def sd_over_exact(spec: RotorSpec, readings: list[Inspection]) -> float:
    step = begun(MODEL, spec, readings, workspace=Workspace())
    axes = [(np.arange(n) + 0.5) / n for n in GRID]
    unit = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    log_p = step.space.log_prior(unit) + sum(m.column(unit) for m in step.messages.values())
    w, s = normalised(log_p), 2.0 * unit[:, 0]
    return of_s(step.sealed())[1] / float(np.sqrt(w @ (s - w @ s) ** 2))


def space_of(blades: int, times: tuple[float, ...]) -> SharedSpace:
    return begun(MODEL, *read(blades, times, 0), workspace=Workspace()).space


def test_what_is_told_with_an_unknown_noise_is_as_wide_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two blades read twice. Tails of the noise alone (control): s is a fifth too sharp."""
    rotors = [read(2, (0.0, 2.0), seed) for seed in range(8)]
    ours = np.median([sd_over_exact(*one) for one in rotors])
    monkeypatch.setattr(spaces, "FEWER", 0)
    control = np.median([sd_over_exact(*one) for one in rotors])
    assert 0.88 < ours < 1.12
    assert control < 0.8


def test_all_have_long_tails_where_no_noise_is_told_by_a_dozen_numbers() -> None:
    assert space_of(3, (0.0, 1.0, 2.0)).heavy == (0, 1)
    assert space_of(4, (0.0, 1.0, 2.0)).heavy == (1,)
    assert space_of(8, (0.0, 1.0, 2.0)).heavy == ()
    spec, readings = read(1, (0.0, 1.0), 0)
    known = [Inspection(r.id, r.blade, "y", r.time_h, r.values, sigma=0.1) for r in readings]
    assert begun(MODEL, spec, known, workspace=Workspace()).space.heavy == ()


def test_first_readings_arrive_one_by_one_and_what_is_stored_goes_on() -> None:
    """Provisional states between are readable; a stored one is the prior of another network."""
    spec, readings = read(2, (0.0, 2.0), 1)
    state, work = update(MODEL, spec, readings[:1]), Workspace()
    for count in (2, 3, 4):
        quick = update(MODEL, spec, readings[:count], state, quick=True, workspace=work)
        state = update(MODEL, spec, readings[:count], quick, workspace=work)
        assert state.sealed
        assert of_s(quick)[0] == pytest.approx(of_s(state)[0], abs=of_s(state)[1])
    assert state.digest == update(MODEL, spec, readings).digest
    assert state.meta["health"]["status"] == "ok"
    stored = StoredPosterior.of(MODEL, state, ["s"])
    unit = ((np.arange(200) + 0.5) / 200)[:, None]
    w = normalised(stored.log_density(unit))
    mean, sd = of_s(state)
    assert w @ (2.0 * unit[:, 0]) == pytest.approx(mean, abs=0.2 * sd)
    assert stored.error_nat < 1.0
