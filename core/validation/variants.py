"""Kinds of simulated rotors, by name, and who is there at which hour.

Truths (`Variant.truth`):

    prior   shared and local parameters from the network's priors: every claim must hold
    bounds  coatings exactly at the ends of their range, first blade thin, second thick …: not a
            draw from the prior, so that nothing is promised of parameters (at a bound a truth lies
            below or above every particle), while predictions should still hold
    fe      finite-element runs (`core.validation.fe_rotors`) in place of m and s

The runs share the surrogate's mesh. What the network declares of a mesh's error, nu, is therefore
not in them, and a noise that is smaller than that is taken for smaller still: the likelihood holds
a part of it for the simulation's. `fe-nu` and its like have nu drawn, as it is declared.

`eight-shared` is `mixed` with a constant offset of elongations and of scans: T1T, three noises and
four offsets are shared.

`thin-coating` keeps SBC exact with the bounds always near: the prior itself is narrowed to the
thinnest tenth of the range, a network like any other, and the truths come from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from core.errors import InputError
from core.model import Model, rotor_blade
from core.network import Discrepancy
from core.prior import Prior
from core.validation.six_locals import six_locals

COATING = "tbc_thickness"
THREE = (8_000.0, 16_000.0, 24_000.0)
SIX = tuple(7_000.0 * k for k in range(1, 7))
OFFSETS = (
    ("elongation", Discrepancy("constant", sd=0.02)),
    ("deformation", Discrepancy("constant", sd=0.1)),
)
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
    nu          finite-element runs get the numerical error that the network declares
    wrong       discrepancies of quantities, where the network declares none
    six_locals  `core.validation.six_locals` in place of the built-in model
    """

    name: str
    blades: int = 100
    outages_h: tuple[float, ...] = THREE
    held_out_h: float = 32_000.0
    mixed: bool = False
    truth: Literal["prior", "bounds", "fe"] = "prior"
    nu: bool = False
    tbc: tuple[float, float] | None = None
    wrong: tuple[tuple[str, Discrepancy], ...] = ()
    six_locals: bool = False


VARIANTS = {
    v.name: v
    for v in (
        Variant("rotor-100"),
        Variant("rotor-20", blades=20),
        Variant("first-outage", blades=20, outages_h=(8_000.0,), held_out_h=16_000.0),
        Variant("six-outages", outages_h=SIX, held_out_h=49_000.0),
        Variant("mixed", mixed=True),
        Variant("thin-coating", tbc=(2 / 3, 2 / 3 + 2 / 30)),
        Variant("coating-at-bounds", truth="bounds"),
        Variant("eight-shared", mixed=True, wrong=OFFSETS),
        Variant("fe", blades=20, truth="fe"),
        Variant("fe-six-outages", blades=20, outages_h=SIX, held_out_h=49_000.0, truth="fe"),
        Variant("fe-mixed", blades=17, mixed=True, truth="fe"),
        Variant("fe-nu", blades=20, truth="fe", nu=True),
        Variant(
            "fe-nu-six-outages", blades=20, outages_h=SIX, held_out_h=49_000.0, truth="fe", nu=True
        ),
        Variant("fe-nu-mixed", blades=17, mixed=True, truth="fe", nu=True),
        Variant("six-locals", blades=3, outages_h=(8_000.0, 24_000.0), six_locals=True),
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
    """The built-in model, with the variant's prior of the coating and its discrepancies; or that of
    six parameters."""
    if variant.six_locals:
        return six_locals()
    model, wrong = rotor_blade(), dict(variant.wrong)
    if variant.tbc is None and not wrong:
        return model
    network = model.network
    if variant.tbc is not None:
        prior = Prior("uniform", *variant.tbc)
        parameters = (
            replace(p, prior=prior) if p.name == COATING else p for p in network.parameters
        )
        network = replace(network, parameters=tuple(parameters))
    quantities = (
        replace(q, discrepancy=wrong.get(q.name, q.discrepancy)) for q in network.quantities
    )
    return Model(replace(network, quantities=tuple(quantities)), model.surrogate)


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
