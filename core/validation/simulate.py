"""Simulated rotors, drawn under the very assumptions that calibration and prediction make.

Simulation-based calibration is exact only if the truths come from the prior and the data from the
likelihood (Cook, Gelman & Rubin 2006; Talts et al. 2018). A reading at x is therefore

    y = m(x) (1 + nu e1) + s(x) e2 + sigma e3,        e1, e2, e3 ~ N(0, 1) for each reading,

with m and s the mean and the surrogate's standard deviation as compiled for the likelihood
(`core.response`), nu the quantity's declared numerical error and sigma drawn from its prior. The
likelihood takes nu times the reading for nu times the mean: a difference of order nu². A 3-D scan
has the surrogate's error in mode space, with the covariance of `core.calibration.scans`, and white
noise at every node. Held-out readings follow what a prediction assumes: mean and standard deviation
of the Gaussian process itself. A declared discrepancy (`core.discrepancy`), its theta drawn from
their priors, moves all of it but the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from core.calibration.responses import DEGREE
from core.calibration.scans import doubt
from core.discrepancy import NONE, affine, parameters, total
from core.model import Model
from core.observation import Inspection
from core.prior import Prior
from core.rng import stream
from core.validation import fe_rotors
from core.validation.variants import COATING, DESTROYED, Variant, hours, names_of

Array = NDArray[np.float64]
SCANNED = 700


@dataclass(frozen=True, slots=True)
class Held:
    """A held-out reading, and what it is made of.

    reading  with noise; blade: without; model: the surrogate's mean at the truth (NaN where the
    truth is a finite-element run, or a discrepancy moves it) [unit]
    """

    blade: str
    quantity: str
    time_h: float
    reading: float
    value: float
    model: float


@dataclass(frozen=True, slots=True)
class Simulated:
    """A rotor's truth, its readings and what is held out.

    cluster  rotors of one number share their truth and differ in noise only
    """

    shared: dict[str, float]
    local: dict[str, dict[str, float]]
    readings: tuple[Inspection, ...]
    held: tuple[Held, ...]
    cluster: int


def truths(model: Model, variant: Variant, rotor: int, seed: int) -> tuple[dict[str, float], Array]:
    """Shared values by name, the noise of each measured quantity among them; inputs (blades, d)."""
    rng = stream(seed, variant.name, "truth", rotor)
    network, names = model.network, names_of(variant)

    def drawn(prior: Prior) -> float:
        return float(prior.quantile(rng.random(1))[0])

    shared = {p.name: drawn(p.prior) for p in network.of_level("shared")}
    for quantity in network.quantities:
        if variant.mixed or quantity.name == "elongation":
            shared[quantity.sigma_name] = drawn(quantity.sigma_obs)
            shared |= {n: drawn(prior) for n, prior in parameters(model, quantity).items()}
    local = {p.name: p.prior.quantile(rng.random(len(names))) for p in network.of_level("local")}
    if variant.truth == "bounds":
        low, high = network.parameter(COATING).prior.box
        local[COATING] = np.where(np.arange(len(names)) % 2 == 0, low, high)
    columns = [
        local[name] if name in local else np.full(len(names), shared[name])
        for name in model.input_names
    ]
    return shared, np.stack(columns, axis=1)


Clean = Callable[[str, float, list[int], bool], tuple[Array, Array]]
"""(quantity, hours, blades, held out?) → the blades' values without noise, and the model's mean."""


def wrong(
    model: Model,
    quantity: str,
    time_h: float,
    shared: Mapping[str, float],
    error: float,
    component: int | None = None,
) -> tuple[float, float, float]:
    """Gain, offset and sigma_delta of a discrepancy; `error` in sds of what its modes leave."""
    one = affine(model, model.network.quantity(quantity), time_h, component)
    if one == NONE:
        return 1.0, 0.0, 0.0
    gain = float(1.0 + total(one.gain, lambda name: np.array(shared[name])))
    offset = float(total(one.offset, lambda name: np.array(shared[name])))
    return gain * (1.0 + one.left * error), offset, one.sigma


def scan(
    model: Model,
    x: Array,
    time_h: float,
    nodes: NDArray[np.int64],
    shared: Mapping[str, float],
    rng: np.random.Generator,
) -> Array:
    """A 3-D scan (n, 3) [mm] at inputs x (d,), with the errors that the likelihood assumes."""
    error = float(rng.standard_normal())
    moved = [wrong(model, "deformation", time_h, shared, error, axis) for axis in range(3)]
    gain, offset, sigma_delta = np.array(moved).T
    noise_sd = np.hypot(shared[model.network.quantity("deformation").sigma_name], sigma_delta)
    nu, surrogate = model.network.quantity("deformation").numerical, model.part("deformation")
    phi = surrogate.deformation_modes(nodes.tolist())
    q, r = np.linalg.qr(phi.reshape(3 * len(nodes), -1))
    (z,), (sd,) = surrogate.mode_response(time_h, r, degree=DEGREE).evaluate(x[None])
    unknown = doubt(surrogate.mode_covariance(time_h), r, z, sd, nu)
    own = np.linalg.cholesky(unknown) @ rng.standard_normal(len(z))
    noise = noise_sd * rng.standard_normal((len(nodes), 3))
    return np.asarray(gain * (q @ (z + own)).reshape(-1, 3) + offset + noise)


def numerical(
    model: Model, shape: Array, nodes: NDArray[np.int64], rng: np.random.Generator
) -> Array:
    """The mesh's error of a deformation (n, 3) [mm], as the likelihood assumes it: by modes."""
    nu = model.network.quantity("deformation").numerical
    phi = model.part("deformation").deformation_modes(nodes.tolist())
    q, _ = np.linalg.qr(phi.reshape(3 * len(nodes), -1))
    z = q.T @ shape.reshape(-1)
    own = nu * np.sqrt(z**2 + np.mean(z**2)) * rng.standard_normal(len(z))
    return np.asarray((q @ own).reshape(-1, 3))


def simulate(model: Model, variant: Variant, rotor: int, seed: int) -> Simulated:
    """Rotor number `rotor` of a study: a function of the variant, the seed and the number."""
    shared, x = truths(model, variant, rotor, seed)
    runs, own = None, rotor
    if variant.truth == "fe":
        runs = shipped_rotors()
        own = rotor % len(runs.inputs)
        x = runs.inputs[own, : len(x)]
        of_rotor = [p.name for p in model.network.of_level("shared")]
        shared |= {name: float(x[0, model.input_names.index(name)]) for name in of_rotor}
    names, rng = names_of(variant), stream(seed, variant.name, "noise", rotor)

    def clean(quantity: str, time_h: float, which: list[int], held: bool) -> tuple[Array, Array]:
        declared = model.network.quantity(quantity)
        if runs is not None:
            value = runs.at(quantity, own, time_h)[which]
            if variant.nu:
                value = value * (1 + declared.numerical * rng.standard_normal(len(which)))
            return value, np.full(len(which), np.nan)
        surrogate = model.part(quantity)
        nodes = [declared.node_among(surrogate.named)]
        node = None if declared.kind == "scalar" else nodes
        if held:
            mean, sd = surrogate.predict(x[which], quantity, np.array([time_h]), node)
        else:
            response = surrogate.response(quantity, np.array([time_h]), node, degree=DEGREE)
            mean, sd = response.evaluate(x[which])
        mean, sd = mean.reshape(len(which)), sd.reshape(len(which))
        e1, e2 = rng.standard_normal((2, len(which)))
        value = mean * (1 + declared.numerical * e1) + sd * e2
        if declared.discrepancy.kind == "none":
            return value, mean
        errors = rng.standard_normal((2, len(which)))
        moved = [wrong(model, quantity, time_h, shared, float(e)) for e in errors[0]]
        gain, offset, sigma_delta = np.array(moved).T
        return gain * value + offset + sigma_delta * errors[1], np.full(len(which), np.nan)

    def read(quantity: str, due: dict[str, float], held: bool) -> list[Held]:
        """One reading of each blade that is due, in groups of equal hours."""
        found = []
        sigma = shared[model.network.quantity(quantity).sigma_name]
        for time_h in sorted(set(due.values())):
            which = [i for i, blade in enumerate(names) if due.get(blade) == time_h]
            values, mean = clean(quantity, time_h, which, held)
            seen = values + sigma * rng.standard_normal(len(which))
            found += [
                Held(names[i], quantity, time_h, *map(float, row))
                for i, *row in zip(which, seen, values, mean, strict=True)
            ]
        return found

    readings: list[Inspection] = []
    for k, rotor_h in enumerate(variant.outages_h):
        due = hours(variant, rotor_h)
        made = read("elongation", due, False)
        if variant.mixed:
            if k < DESTROYED:
                gone = names[variant.blades - DESTROYED + k]
                made += read("ceeq", {gone: due[gone]}, False)
            if runs is not None:
                sigma = shared[model.network.quantity("deformation").sigma_name]
                nodes = runs.scan_nodes
                shape = runs.deformation[own, np.flatnonzero(runs.scan_h == rotor_h)[0]]
                if variant.nu:
                    shape = shape + numerical(model, shape, nodes, rng)
                values = shape + sigma * rng.standard_normal(shape.shape)
            else:
                nodes = fe_rotors.scan_nodes(SCANNED)
                values = scan(model, x[0], rotor_h, nodes, shared, rng)
            readings.append(
                Inspection(f"{names[0]}-d{k}", names[0], "deformation", rotor_h, values, nodes)
            )
        readings += [
            Inspection(
                f"{m.blade}-{m.quantity[0]}{k}",
                m.blade,
                m.quantity,
                m.time_h,
                np.array([m.reading]),
            )
            for m in made
        ]
    due = hours(variant, variant.held_out_h)
    quantities: Sequence[str] = ("elongation", "ceeq") if variant.mixed else ("elongation",)
    held = [h for quantity in quantities for h in read(quantity, due, True)]
    of_level = [p.name for p in model.network.of_level("local")]
    local = {
        blade: {name: float(x[i, model.input_names.index(name)]) for name in of_level}
        for i, blade in enumerate(names)
    }
    return Simulated(shared, local, tuple(readings), tuple(held), own)


@cache
def shipped_rotors() -> fe_rotors.FERotors:
    """The finite-element rotors, read once."""
    return fe_rotors.load()
