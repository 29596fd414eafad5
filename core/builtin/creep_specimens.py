"""Creep specimens of a single-crystal superalloy: the second model that comes with bladetwin.

A specimen hangs under a constant load and grows; no mesh, no surrogate, a law in closed form. With
the steady rate by Norton's law,

    r = exp(log_rate) (stress / `STRESS0`)^n                   [%/h],     x = r t      [%]

the strain is x alone, or, with what the network keeps asleep (``dormant``) until it is asked for,

    eps(t) = P (1 − exp(−x / eps_p)) + (exp(c x) − 1) / c      [%]
             primary                   tertiary, → x for c → 0

`log_rate` is each specimen's own, drawn from a population over the specimens; n, P, eps_p and c are
shared; the stress is known of each specimen. Both amplitudes P and c are nominally 0. (The nominal
eps_p, 0.04 %, comes from a first look at CMSX-6 at 980 °C; it counts only where P is freed and
eps_p is not.) From c x = `MOST` on, beyond any strain that a specimen lives to see, the exponential
goes on along its tangent, so that every number stays finite and strain still rises with rate and
amplitude.

Names of the service stay: the set of specimens is a "rotor", a specimen a "blade".

F. H. Norton, The Creep of Steel at High Temperatures, 1929; primary creep that saturates with
strain and an exponential tertiary law: e.g. B. F. Dyson, M. McLean, Acta Metall. 31 (1983) 17.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from core.family import Family
from core.network import Level, Network, Parameter, Quantity
from core.prior import Population, Prior
from core.surrogate.closed_form import ClosedForm
from core.surrogate.formula import FormulaInput

Array = NDArray[np.float64]
NAME, QUANTITY = "creep-specimens", "creep_strain"
STRESS0 = 180.0  # MPa; log_rate is the rate at this stress
HORIZON_H = 5000.0
MOST = 60.0  # largest exponent
INPUTS = (
    FormulaInput("log_rate", -18.0, 0.0),
    FormulaInput("n", 1.0, 16.0),
    FormulaInput("primary", 0.0, 3.0),
    FormulaInput("primary_strain", 0.002, 1.0),
    FormulaInput("tertiary", 0.0, 120.0),
    FormulaInput("stress", 50.0, 400.0),
)
FAMILIES = (
    Family(
        "primary creep",
        "a specimen creeps faster at first, until its dislocations have settled",
        "input", "primary", "plus", 0.3, 1, ("constant",), ("all",), "blade", "material",
    ),
    Family(
        "strain of primary creep",
        "primary creep fades over another strain than declared",
        "input", "primary_strain", "plus", 0.05, 0, ("constant",), ("all",), "blade", "material",
    ),
    Family(
        "tertiary creep",
        "creep gets faster with the strain (damage, rafting, necking)",
        "input", "tertiary", "plus", 0.1, 1, ("constant",), ("all",), "blade", "material",
    ),
    Family(
        "offset of the extensometer",
        "every strain is too large or too small by the same, from the first reading on",
        "reading", QUANTITY, "plus", None, 0, ("constant",), ("all", "blade"), "blade", "sensor",
    ),
    Family(
        "drift of the extensometer",
        "the extensometer moves while the test runs",
        "reading", QUANTITY, "plus", None, 0, ("linear",), ("all", "blade"), "blade", "sensor",
    ),
    Family(
        "gain of an extensometer",
        "the strains of one specimen are too large or too small in proportion",
        "reading", QUANTITY, "times", 0.1, 0, ("constant",), ("blade",), "blade", "sensor",
    ),
)  # fmt: skip


def strain(x: Array, time_h: Array | float) -> Array:
    """Creep strain [%] at inputs x (…, 6), in the order of `INPUTS`, and times [h], broadcast.

    >>> x = np.array([np.log(0.01), 7.0, 0.0, 0.04, 0.0, STRESS0])
    >>> strain(x, np.array([0.0, 100.0])).round(12).tolist()
    [0.0, 1.0]
    """
    log_rate, n, primary, primary_strain, tertiary, stress = np.moveaxis(x, -1, 0)
    steady = np.exp(log_rate + n * np.log(stress / STRESS0)) * time_h
    power = np.minimum(tertiary * steady, MOST)
    beyond = np.exp(power) * (tertiary * steady - power)
    grown = (np.expm1(power) + beyond) / np.where(tertiary > 0, tertiary, 1.0)
    small = power < 1e-9  # exp(c x) − 1 = c x there, and c may be zero
    transient = primary * -np.expm1(-np.minimum(steady / primary_strain, MOST))
    return np.asarray(transient + np.where(small, steady, grown))


@cache
def formula() -> ClosedForm:
    """The law; strain rises with everything but the strain over which primary creep fades."""
    return ClosedForm(
        INPUTS,
        {QUANTITY: strain},
        NAME,
        horizon_h=HORIZON_H,
        positive=(QUANTITY,),
        rising=("log_rate", "primary", "tertiary"),
        falling=("primary_strain",),
    )


def network() -> Network:
    """Norton's law; primary and tertiary creep asleep."""
    rate = Population(Prior("uniform", -16.0, -1.0), Prior("log_uniform", 0.01, 1.0))
    return Network(
        name=NAME,
        parameters=(
            Parameter(
                "log_rate",
                "local",
                Prior("uniform", -18.0, 0.0),
                "ln(%/h)",
                "ln r0",
                population=rate,
            ),
            Parameter("n", "shared", Prior("uniform", 1.0, 16.0), "1", "n"),
            Parameter("primary", "dormant", Prior("log_uniform", 0.01, 3.0), "%", "P", 0.0),
            Parameter(
                "primary_strain", "dormant", Prior("log_uniform", 0.002, 1.0), "%", "eps_p", 0.04
            ),
            Parameter("tertiary", "dormant", Prior("log_uniform", 0.01, 120.0), "1/%", "c", 0.0),
            Parameter("stress", "known", Prior("uniform", 50.0, 400.0), "MPa", "sigma"),
        ),
        quantities=(
            Quantity(QUANTITY, "%", "scalar", Prior("log_uniform", 1e-3, 10.0), -1.0, 60.0),
        ),
        families=FAMILIES,
        notes={
            "strain": "in percent, of the initial gauge length",
            "names": "a rotor is a set of specimens, a blade is a specimen",
            "stress0": f"{STRESS0:g} MPa, at which exp(log_rate) is the steady rate in %/h",
        },
    )


def freed(own: Network, levels: Mapping[str, Level]) -> Network:
    """The network with parameters at other levels, e.g. {"primary": "shared"}.

    >>> [p.name for p in freed(network(), {"tertiary": "shared"}).of_level("shared")]
    ['n', 'tertiary']
    """
    for name in levels:
        own.parameter(name)
    parameters = tuple(replace(p, level=levels.get(p.name, p.level)) for p in own.parameters)
    return replace(own, parameters=parameters)
