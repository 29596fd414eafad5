"""3-D scans as rows: exact where they can be, with and without a discrepancy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.builtin import inspection_plan
from core.calibration.layout import Packed, readings_at
from core.calibration.lines import SAME
from core.calibration.message import BladeMessage
from core.calibration.online import update
from core.calibration.space import shared_space
from core.calibration.state import RotorSpec, shared_posterior
from core.calibration.target import assemble
from core.model import Model, rotor_blade
from core.network import Discrepancy, Network, Parameter, Quantity
from core.observation import Inspection
from core.prior import Prior
from core.response import Response
from core.surrogate.formula import FormulaInput, FormulaModel

NODES, MODES, HORIZON = 20, 4, 2.0
KINDS = {
    "none": Discrepancy(),
    "constant": Discrepancy("constant", sd=0.15, sigma=0.02),
    "paper": Discrepancy("paper", sd=0.04),
}


def amplitudes(x: np.ndarray, t: float) -> np.ndarray:
    """c (n, MODES) of inputs s, l."""
    s, ell = x.T
    return np.stack([4 + s * t, ell * (1 + t), s * ell, ell**2 + t * s**2], axis=1)


class Plate(FormulaModel):
    """A plate of NODES nodes that bends in MODES modes; the simulation knows them exactly."""

    def deformation_modes(self, nodes: object) -> np.ndarray:
        phi = np.random.default_rng(1).standard_normal((NODES, 3, MODES))
        phi[:, 2, 0] += 1.0  # a mode that is partly a translation along z
        return phi[np.asarray(nodes)]

    def mode_response(self, time_h: float, mixing: np.ndarray, degree: int = 5) -> Response:
        x = self.low + np.random.default_rng(0).random((200, 2)) * (self.high - self.low)
        values = amplitudes(x, time_h) @ mixing.T
        return Response.fit(["s", "l"], self.low, self.high, degree, x, a=values)

    def mode_covariance(self, time_h: float) -> np.ndarray:
        return np.eye(MODES)


def plate(discrepancy: Discrepancy) -> Model:
    parameters = (
        Parameter("s", "shared", Prior("uniform", 1.0, 3.0)),
        Parameter("l", "local", Prior("uniform", -1.0, 1.0)),
    )
    inputs = tuple(FormulaInput(p.name, p.prior.low, p.prior.high) for p in parameters)
    noise = Prior("log_uniform", 1e-3, 0.5)
    quantity = Quantity("u", "mm", "vector", noise, -50.0, 50.0, discrepancy=discrepancy)
    surrogate = Plate(inputs, {}, "plate", HORIZON, node_count=NODES)
    return Model(Network("plate", parameters, (quantity,)), surrogate)


def scan(x: np.ndarray, gain: float, offset: np.ndarray, sigma: float, seed: int) -> Inspection:
    nodes = np.arange(NODES)
    phi = Plate((), {}, "").deformation_modes(nodes)
    clean = gain * np.einsum("nab,b->na", phi, amplitudes(x, 1.5)[0]) + offset
    noise = sigma * np.random.default_rng(seed).standard_normal(clean.shape)
    return Inspection("scan", "b", "u", 1.5, clean + noise, nodes=nodes)


@pytest.mark.parametrize("kind", KINDS)
def test_rows_and_remainder_are_the_density_of_the_whole_scan(kind: str) -> None:
    """At any parameters, not only where the scan fits: white noise, three times NODES readings."""
    model, rng = plate(KINDS[kind]), np.random.default_rng(3)
    reading = scan(np.array([[2.1, 0.3]]), 1.08, np.array([0.2, -0.4, 0.6]), 0.05, 2)
    rows = assemble(model, [reading])
    assert rows is not None
    space = shared_space(model, [rows])
    assert space.dim == {"none": 2, "constant": 5, "paper": 4}[kind]
    n = 40
    shared = space.to_x(0.2 + 0.6 * rng.random((n, space.dim)))
    inputs = np.stack([shared[:, 0], rng.uniform(-1, 1, n)], axis=1)
    y, s2, rest = readings_at(rows, space, shared)
    mean, _ = rows.response.evaluate(inputs)
    got = rest - 0.5 * np.sum((y - mean) ** 2 / s2 + np.log(2 * np.pi * s2), axis=1)
    phi = model.surrogate.deformation_modes(np.arange(NODES))
    named = dict(zip(space.names, shared.T, strict=True))
    gain, offset, sigma2 = np.ones(n), np.zeros((n, 3)), named["sigma_obs.u"] ** 2
    if kind == "constant":
        offset = np.stack([named[f"theta.u.{axis}"] for axis in "xyz"], axis=1)
        sigma2 = sigma2 + 0.02**2
    elif kind == "paper":
        gain = 1 + named["theta1.u"] - named["theta2.u"] * named["s"]
        sigma2 = sigma2 + 1e-10
    clean = np.einsum("nab,mb->mna", phi, amplitudes(inputs, 1.5))
    miss = reading.values - gain[:, None, None] * clean - offset[:, None, :]
    expected = -0.5 * np.sum(
        miss**2 / sigma2[:, None, None] + np.log(2 * np.pi * sigma2)[:, None, None], axis=(1, 2)
    )
    assert got == pytest.approx(expected, rel=1e-7)


TRUE_S, OFFSET, NOISE = 2.1, np.array([0.15, -0.2, 0.3]), 0.2


def scanned(seed: int) -> list[Inspection]:
    """A scan of each of three blades; every one of them shifted alike."""
    rng = np.random.default_rng(seed)
    out = []
    for b in range(3):
        x = np.array([[TRUE_S, rng.uniform(-0.7, 0.7)]])
        one = scan(x, 1.0, OFFSET, NOISE, 10 * seed + b)
        out.append(replace(one, id=f"scan-{b}", blade=f"b{b}"))
    return out


def test_an_offset_of_scans_is_recovered_and_without_it_the_noise_takes_it() -> None:
    found, evidence = {}, {}
    for kind in ("constant", "none"):
        state = update(plate(KINDS[kind]), RotorSpec("r", ("b0", "b1", "b2"), 2000, 3), scanned(1))
        evidence[kind] = state.meta["log_evidence"]
        posterior = shared_posterior(state.meta, state.arrays.__getitem__)
        sigma_delta = KINDS[kind].sigma or 0.0
        truth = {"s": TRUE_S, "sigma_obs.u": np.sqrt(NOISE**2 - sigma_delta**2)}
        truth |= {f"theta.u.{a}": c for a, c in zip("xyz", OFFSET, strict=True)}
        w = posterior.particles.w
        for name in posterior.names:
            values = posterior.column(name)
            mean = w @ values
            found[kind, name] = (mean - truth[name]) / np.sqrt(w @ (values - mean) ** 2)
        assert state.meta["health"]["ess_ratio"] > 0.3
    assert {name for kind, name in found if kind == "constant"} == truth.keys()
    assert max(abs(z) for (kind, _), z in found.items() if kind == "constant") < 3
    assert found["none", "sigma_obs.u"] > 4, "negative control"
    assert evidence["constant"] > evidence["none"] + 20


def test_a_scan_whose_remainder_is_no_noise_is_named_and_the_others_are_not() -> None:
    """Noise of 0.2 that one blade's scan says to be 0.1: four rows cannot tell, 56 numbers can."""
    known = [replace(one, sigma=NOISE) for one in scanned(1)]
    model, spec = plate(KINDS["constant"]), RotorSpec("r", ("b0", "b1", "b2"), 600, 3)
    assert update(model, spec, known).meta["health"]["contradicted"] == []
    told = update(model, spec, [*known[:2], replace(known[2], sigma=0.1)]).meta["health"]
    assert [one["blade"] for one in told["contradicted"]] == ["b2"]
    one = told["contradicted"][0]
    q, _ = np.linalg.qr(Plate((), {}, "").deformation_modes(range(NODES)).reshape(3 * NODES, -1))
    whole = np.hstack([q, np.tile(np.eye(3), (NODES, 1))])
    values = known[2].values.ravel()
    left = values - whole @ np.linalg.lstsq(whole, values)[0]
    assert one["rows"] == 3 * NODES - MODES
    assert one["own_nat"] == pytest.approx(0.5 * left @ left / (0.1**2 + 0.02**2), abs=0.1)
    assert one["own_nat"] <= one["misfit_nat"] < one["own_nat"] + 10
    assert told["status"] == "contradicted"
    assert "blade b2" in told["reasons"][0]


def test_an_offset_of_the_blade_s_scans_places_its_nodes() -> None:
    """Six shared parameters, three of them known by thousands of readings to a hundredth."""
    plan = inspection_plan.load()
    shift = np.array([0.15, -0.1, 0.08])
    readings = []
    for one in map(dict, plan.inspections):
        if one["blade"] <= "B006":
            value = one.pop("value", None)
            one["values"] = [value] if value is not None else one["values"]
            reading = Inspection.from_json(one)
            moved = reading.values + (shift if one["quantity"] == "deformation" else 0.0)
            readings.append(replace(reading, values=moved))
    blade = rotor_blade()
    quantities = tuple(
        replace(q, discrepancy=Discrepancy("constant", sd=0.2)) if q.kind == "vector" else q
        for q in blade.network.quantities
    )
    model = Model(replace(blade.network, quantities=quantities), blade.surrogate)
    names = tuple(sorted({r.blade for r in readings}))
    state = update(model, RotorSpec("r", names, 1000, 1), readings)
    assert state.meta["health"]["ess_ratio"] > 0.3, "0.02 from the whole box"
    posterior = shared_posterior(state.meta, state.arrays.__getitem__)
    w = posterior.particles.w
    for axis, truth in zip("xyz", shift, strict=True):
        values = posterior.column(f"theta.deformation.{axis}")
        mean = w @ values
        assert abs(mean - truth) < 4 * np.sqrt(w @ (values - mean) ** 2)


def test_factors_that_rows_of_a_scan_share_are_computed_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The scanned blade of the plan has 24 rows a scan, all but the first of which are marked."""
    model = rotor_blade()
    bodies = [b for b in inspection_plan.load().inspections if b["quantity"] == "deformation"]
    readings = [
        Inspection(b["id"], b["blade"], b["quantity"], b["time_h"],
                   np.array(b["values"]), nodes=np.array(b["nodes"]))
        for b in bodies[:2]
    ]  # fmt: skip
    rows = assemble(model, readings)
    assert rows is not None
    message = BladeMessage(model, rows, shared_space(model, [rows]), {})
    scans, kb2 = len(readings), message.packed.kb2
    assert np.sum(message.packed.marked != kb2) >= len(rows.y) - scans - 3
    unit = np.random.default_rng(0).random((8, message.space.dim)) * 0.1 + [[0.6, 0.35]]
    rng = np.random.default_rng

    def found() -> list[np.ndarray]:
        exact = message.column(unit)
        return [exact, message.column(unit, rough=True), *message.draws(unit, 20, rng(1), exact)]

    once = found()
    monkeypatch.setattr(Packed, "marked", property(lambda packed: packed.kb2))
    each = found()
    for one, other in zip(once, each, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)
    wrong = message.packed.kb2.copy()
    wrong[1:] = SAME  # the second scan's rows, at another time, with the first one's factors
    monkeypatch.setattr(Packed, "marked", property(lambda packed: wrong))
    assert np.max(np.abs(message.column(unit) - each[0])) > 0.1, "control"
