"""Every number of the blade model, in one place: value, unit, source.

A user with a real blade replaces these trees and nothing else::

    from dataclasses import replace
    mine = replace(Properties(), geometry=replace(Geometry(), wall_root=3.8))

Units: mm, N, MPa, tonne, hour, W, K (degrees Celsius only where a name ends in ``_c``).

Sources
    [A]  ASM Handbook vol. 1 (1990) and Donachie & Donachie, *Superalloys*, 2nd ed.: IN-738LC.
    [B]  ASM cast-superalloy rupture table for IN-738 (470/345 MPa at 815 °C, 330/235 at 870 °C,
         130/90 at 980 °C for 100/1000 h), from memory; the Larson-Miller line is its fit.
    [C]  R. L. Huddleston, J. Pressure Vessel Technol. 107 (1985) 421, in the two-parameter form
         of ASME III-NH, from memory; its constant belongs to austenitic steel: assumed here.
    assumed   plausible for a land-based first-stage blade, belongs to no real one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, is_dataclass
from itertools import pairwise

from core.errors import RangeError

Table = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Material:
    """IN-738LC. Tables are piecewise linear over `temperature_k`, constant beyond its ends."""

    temperature_k: Table = (293.0, 700.0, 1000.0, 1300.0)  # K
    youngs_modulus: Table = (201e3, 178e3, 155e3, 130e3)  # MPa [A]
    secant_expansion: Table = (11.6e-6, 13.2e-6, 14.8e-6, 17.0e-6)  # 1/K from reference_k [A]
    conductivity: Table = (11.5e-3, 17.5e-3, 22.8e-3, 27.5e-3)  # W/(mm K) [A]
    reference_k: float = 293.0  # K, free of thermal strain
    poisson_ratio: float = 0.30  # 1, assumed
    density: float = 8.11e-9  # tonne/mm³ [A]


@dataclass(frozen=True, slots=True)
class Creep:
    """Primary and secondary creep and rupture; the law is in :mod:`core.blade.creep`."""

    larson_miller_a: float = 41566.8  # K [B]
    larson_miller_b: float = 6536.04  # K per decade of stress in MPa [B]
    larson_miller_c: float = 20.0  # 1, with t_r in hours [B]
    monkman_grant: float = 0.02  # strain: minimum rate x rupture time; assumed
    primary_strain: float = 1e-3  # saturated primary strain at 100 MPa; assumed
    primary_exponent: float = 2.0  # 1, of q/100 MPa; assumed
    primary_scale: float = 2e-4  # strain: tau = primary_scale / r_s0; assumed
    transient_sd: float = 0.35  # ln per standard deviate of creep_transient; assumed
    steady_sd: float = 0.35  # ln per standard deviate of creep_steady; assumed
    huddleston: float = 0.24  # 1 [C]
    tertiary_exponent: float = 0.0  # 1, n in r_s/(1 - D)^n; 0: no damage coupling; assumed
    damage_acceleration: float = 0.0  # 1, c in r_s (1 + c D); 0: no damage coupling; assumed


@dataclass(frozen=True, slots=True)
class Geometry:
    """Hollow tapered twisted aerofoil, sections stacked on their centroids. All assumed."""

    span: float = 180.0  # mm
    hub_radius: float = 900.0  # mm
    chord_root: float = 110.0  # mm
    chord_tip: float = 90.0  # mm
    half_thickness_root: float = 11.5  # mm
    half_thickness_tip: float = 8.5  # mm
    wall_root: float = 4.2  # mm, at the thickest place
    wall_tip: float = 3.3  # mm
    edge_wall: float = 0.50  # wall at the leading and trailing edge / wall
    nose: float = 0.30  # c in sin(phi) (1 - c cos(phi)): round leading, slim trailing edge
    camber: float = 0.10  # height of the parabolic camber line / chord
    stagger_deg: float = 35.0  # degrees at the root, chord against the rotor axis
    twist_deg: float = 25.0  # degrees from root to tip
    foundation: float = 20.0  # N/mm³, in-plane bedding of the root face


@dataclass(frozen=True, slots=True)
class Service:
    """Gas, coating, coolant and speed. All assumed."""

    speed_rpm: float = 3600.0  # 1/min
    gas_c: float = 1185.0  # °C at t1t_rate 1, at the hottest span
    gas_per_rate_c: float = 600.0  # °C per unit of t1t_rate
    profile_peak: float = 0.62  # span fraction of the hottest gas
    profile_root: float = 0.78  # gas temperature (°C) at the root / at the peak
    gas_film: float = 3000e-6  # W/(mm² K)
    gas_film_leading: float = 4800e-6  # W/(mm² K) at the leading edge
    leading_width: float = 0.06  # circumferential fraction, standard width of the rise
    tbc_thickness: float = 0.30  # mm nominal
    tbc_conductivity: float = 1.2e-3  # W/(mm K)
    coolant_film: float = 1500e-6  # W/(mm² K)
    coolant_root_c: float = 430.0  # °C
    coolant_tip_c: float = 540.0  # °C

    @property
    def omega(self) -> float:
        """Angular speed in rad/s."""
        return self.speed_rpm * 2 * math.pi / 60


@dataclass(frozen=True, slots=True)
class Properties:
    """The whole declared blade.

    >>> round(Properties().service.omega, 2)
    376.99
    """

    material: Material = field(default_factory=Material)
    creep: Creep = field(default_factory=Creep)
    geometry: Geometry = field(default_factory=Geometry)
    service: Service = field(default_factory=Service)

    def __post_init__(self) -> None:
        for group in (self.material, self.creep, self.geometry, self.service):
            _check(group)
        m = self.material
        for name in ("youngs_modulus", "secant_expansion", "conductivity"):
            if len(getattr(m, name)) != len(m.temperature_k):
                raise RangeError(
                    f"properties.material.{name}",
                    getattr(m, name),
                    f"does not have the {len(m.temperature_k)} values of temperature_k",
                    "give one value per temperature",
                )
        if m.poisson_ratio >= 0.5:
            raise RangeError(
                "properties.material.poisson_ratio",
                m.poisson_ratio,
                "leaves nothing to compress: the elements divide by 1 - 2 nu",
                "give a ratio below 0.5; metals have 0.25 … 0.4",
            )
        if any(a >= b for a, b in pairwise(m.temperature_k)):
            raise RangeError(
                "properties.material.temperature_k",
                m.temperature_k,
                "does not increase",
                "sort the tables by temperature",
            )


_MAY_BE_ZERO = {
    "tertiary_exponent",
    "damage_acceleration",
    "huddleston",
    "transient_sd",
    "steady_sd",
    "stagger_deg",
}
_MAY_BE_ZERO |= {"twist_deg", "camber", "nose", "speed_rpm", "foundation", "poisson_ratio"}


def _check(group: object) -> None:
    assert is_dataclass(group)
    name = type(group).__name__.lower()
    for f in fields(group):
        value = getattr(group, f.name)
        numbers = value if isinstance(value, tuple) else (value,)
        for number in numbers:
            low = 0.0 if f.name in _MAY_BE_ZERO else math.ulp(0.0)
            if not (math.isfinite(number) and number >= low):
                raise RangeError(
                    f"properties.{name}.{f.name}",
                    value,
                    f"must be finite and {'>= 0' if low == 0.0 else '> 0'}",
                    "give a physical value in mm, N, MPa, tonne, hour, W, K",
                )
