"""Simulated rotors, drawn under the very assumptions that calibration and prediction make.

Simulation-based calibration is exact only if the truths come from the prior and the data from the
likelihood (Cook, Gelman & Rubin 2006; Talts et al. 2018). A reading at x is therefore

    y = m(x) (1 + nu e1) + s(x) e2 + sigma e3,        e1, e2, e3 ~ N(0, 1) for each reading,

with m and s the mean and the surrogate's standard deviation as compiled for the likelihood
(`core.response`), nu the quantity's declared numerical error and sigma drawn from its prior. The
likelihood takes nu times the reading for nu times the mean: a difference of order nu². A 3-D scan
has the surrogate's error in mode space, with the covariance of `core.calibration.scans`, and white
noise at every node. Held-out readings follow what a prediction assumes: mean and standard deviation
of the Gaussian process itself.

Truths (`Variant.truth`):

    prior   shared and local parameters from the network's priors: every claim must hold
    bounds  coatings exactly at the ends of their range, first blade thin, second thick …: not a
            draw from the prior, so that nothing is promised of parameters (at a bound a truth lies
            below or above every particle), while predictions should still hold
    fe      finite-element runs (`core.validation.fe_rotors`) in place of m, s and nu

`thin-coating` keeps SBC exact with the bounds always near: the prior itself is narrowed to the
thinnest tenth of the range, a network like any other, and the truths come from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from core.calibration.target import DEGREE
from core.errors import InputError
from core.model import Model, rotor_blade
from core.network import Prior
from core.observation import Inspection
from core.rng import stream
from core.validation import fe_rotors

Array = NDArray[np.float64]
COATING = "tbc_thickness"
THREE = (8_000.0, 16_000.0, 24_000.0)
SIX = tuple(7_000.0 * k for k in range(1, 7))
SCANNED = 700
DESTROYED = 3  # last blades of a mixed rotor: CEEQ of one at each outage, then a new blade


@dataclass(frozen=True, slots=True)
class Variant:
    """A kind of rotor.

    blades      places on the disc
    outages_h   hours at which the elongation of every blade is read
    held_out_h  the hour whose readings are predicted
    mixed       Table 1 of the paper: a scan of the first blade at each outage, CEEQ of one of the
                last three, which is then replaced by a new blade
    tbc         range of the coating's prior, where it is not the network's
    """

    name: str
    blades: int = 100
    outages_h: tuple[float, ...] = THREE
    held_out_h: float = 32_000.0
    mixed: bool = False
    truth: Literal["prior", "bounds", "fe"] = "prior"
    tbc: tuple[float, float] | None = None


VARIANTS = {
    v.name: v
    for v in (
        Variant("rotor-100"),
        Variant("rotor-20", blades=20),
        Variant("six-outages", outages_h=SIX, held_out_h=49_000.0),
        Variant("mixed", mixed=True),
        Variant("thin-coating", tbc=(2 / 3, 2 / 3 + 2 / 30)),
        Variant("coating-at-bounds", truth="bounds"),
        Variant("fe", blades=20, truth="fe"),
        Variant("fe-six-outages", blades=20, outages_h=SIX, held_out_h=49_000.0, truth="fe"),
        Variant("fe-mixed", blades=17, mixed=True, truth="fe"),
    )
}


def plan(name: str, blades: int | None = None) -> Variant:
    """A variant by its name, of another size if need be.

    >>> plan("mixed", blades=20).blades
    20
    """
    if name not in VARIANTS:
        raise InputError("variant", name, "is unknown", f"use one of {', '.join(VARIANTS)}")
    found = VARIANTS[name]
    if blades is None:
        return found
    least = DESTROYED + 1 if found.mixed else 1
    if blades < least:
        raise InputError("blades", blades, f"are too few for {name}", f"give {least} or more")
    if found.truth == "fe" and blades > found.blades:
        raise InputError("blades", blades, "are more than were run", f"give {found.blades} at most")
    return replace(found, blades=blades)


def model_of(variant: Variant) -> Model:
    """The built-in model, with the variant's prior of the coating."""
    model = rotor_blade()
    if variant.tbc is None:
        return model
    prior = Prior("uniform", *variant.tbc)
    parameters = tuple(
        replace(p, prior=prior) if p.name == COATING else p for p in model.network.parameters
    )
    return Model(replace(model.network, parameters=parameters), model.surrogate)


@dataclass(frozen=True, slots=True)
class Held:
    """A held-out reading, and what it is made of.

    reading  with noise; blade: without; model: the surrogate's mean at the truth (NaN where the
    truth is a finite-element run) [unit]
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


def names_of(variant: Variant) -> tuple[str, ...]:
    """Blades in the order of the truths: those of the start, then those that replace.

    >>> names_of(plan("mixed", blades=4))
    ('B001', 'B002', 'B003', 'B004', 'B002-2', 'B003-2', 'B004-2')
    """
    first = tuple(f"B{i + 1:03d}" for i in range(variant.blades))
    return (*first, *(f"{b}-2" for b in first[-DESTROYED:])) if variant.mixed else first


def hours(variant: Variant, rotor_h: float) -> dict[str, float]:
    """Operating hours of each blade that is there at a rotor's hour (before any is destroyed).

    >>> hours(plan("mixed", blades=4), 16_000.0)
    {'B001': 16000.0, 'B003': 16000.0, 'B004': 16000.0, 'B002-2': 8000.0}
    """
    found = {}
    for blade in names_of(variant):
        own = rotor_h
        if variant.mixed:
            place = int(blade[1:4]) - 1 - (variant.blades - DESTROYED)
            end = variant.outages_h[place] if place >= 0 else np.inf
            if blade.endswith("-2"):
                own = rotor_h - end
            elif rotor_h > end:
                continue
        if own > 0:
            found[blade] = own
    return found


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


def scan(
    model: Model,
    x: Array,
    time_h: float,
    nodes: NDArray[np.int64],
    sigma: float,
    rng: np.random.Generator,
) -> Array:
    """A 3-D scan (n, 3) [mm] at inputs x (d,), with the errors that the likelihood assumes."""
    nu = model.network.quantity("deformation").numerical
    phi = model.surrogate.deformation_modes(nodes.tolist())
    q, r = np.linalg.qr(phi.reshape(3 * len(nodes), -1))
    (z,), (sd,) = model.surrogate.mode_response(time_h, r, degree=DEGREE).evaluate(x[None])
    covariance = r @ model.surrogate.mode_covariance(time_h) @ r.T
    root = sd / np.sqrt(np.diag(covariance))
    unknown = covariance * np.outer(root, root) + np.diag(nu**2 * (z**2 + np.mean(z**2)))
    error = np.linalg.cholesky(unknown) @ rng.standard_normal(len(z))
    noise = sigma * rng.standard_normal((len(nodes), 3))
    return np.asarray((q @ (z + error)).reshape(-1, 3) + noise)


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
            return runs.at(quantity, own, time_h)[which], np.full(len(which), np.nan)
        nodes = [model.surrogate.named[declared.node or "tip"]]
        node = None if declared.kind == "scalar" else nodes
        if held:
            mean, sd = model.surrogate.predict(x[which], quantity, np.array([time_h]), node)
        else:
            response = model.surrogate.response(quantity, np.array([time_h]), node, degree=DEGREE)
            mean, sd = response.evaluate(x[which])
        mean, sd = mean.reshape(len(which)), sd.reshape(len(which))
        e1, e2 = rng.standard_normal((2, len(which)))
        return mean * (1 + declared.numerical * e1) + sd * e2, mean

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
            sigma = shared[model.network.quantity("deformation").sigma_name]
            if runs is not None:
                nodes = runs.scan_nodes
                shape = runs.deformation[own, np.flatnonzero(runs.scan_h == rotor_h)[0]]
                values = shape + sigma * rng.standard_normal(shape.shape)
            else:
                nodes = fe_rotors.scan_nodes(SCANNED)
                values = scan(model, x[0], rotor_h, nodes, sigma, rng)
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
