"""Rotors whose truth is known with and without effects: how old blades are, when they are read.

    rotor-20    20 blades at six visits, two ages (`fe_rotors`, `effect_truths`); effects as they
                were run
    fleet-100   100 blades at three visits, five ages (`effect_fleet`); effects scaled to a size
    fleet-one-age  100 blades at three visits, all of the rotor's age, of another rotor
    fleet-six-visits  100 blades at six visits, five ages, of another
    fleet-scans one of these rotors, and 3-D scans of two blades of five at the first and at
                the last visit, of 96 nodes each (`effect_scans`)
    fleet-scans-2  another rotor of 100 blades, scanned as well

A size is a multiple of the noise: by so much the mean of the concerned blades changes at the last
visit. Effects are run by finite elements at one strength each, and scaled in proportion from
there, up at most to twice that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.validation import effect_fleet as fleet
from core.validation import effect_scans as scans
from core.validation import effect_truths as truths
from core.validation import fe_rotors
from core.validation.effect_fleet import FIVE_AGES, ONE_AGE, SIX_VISITS, Fleet

Array = NDArray[np.float64]
NOISE = 0.02  # mm
SCAN_NOISE = 0.03  # mm, of each coordinate
STRONGEST = 2.0  # times an effect as it was run


@dataclass(frozen=True)
class Scanned:
    """3-D scans of some blades at some of the visits.

    visits  which, (S,); blades: which; nodes (N,)
    shape   deformation without effects [mm], (R, B, S, N, 3); change: by effect, what it adds
    """

    visits: tuple[int, ...]
    blades: tuple[int, ...]
    nodes: NDArray[np.int64]
    shape: Array
    change: Mapping[str, Array]


@dataclass(frozen=True)
class Plan:
    """R rotors of B blades read at V visits.

    visits_h    of the rotor, (V,); offset_h (B,): when blades joined
    coat        which of three coating lots a blade has, (B,); what wears is lot 0
    elongation  without effects [mm], (R, B, V); nan where a blade had not joined
    shares      by effect, elongation with it over that without, (R, B, V); rotors without: nan
    horizon     elongation (R, B) and shares (R, B) at `horizon_h` of each blade, where forecast
    odd_visits  the visit with a campaign's fault, and the first with odd blades' fault
    scans       where blades are scanned
    """

    name: str
    visits_h: Array
    offset_h: Array
    coat: NDArray[np.int64]
    elongation: Array
    shares: Mapping[str, Array]
    odd_visits: tuple[int, int]
    scaled: bool
    horizon_h: float = 0.0
    horizon: Array | None = None
    horizon_shares: Mapping[str, Array] | None = None
    scans: Scanned | None = None

    @property
    def rotors(self) -> int:
        return len(self.elongation)

    @property
    def blades(self) -> int:
        return len(self.coat)

    @property
    def own_h(self) -> Array:
        """Blades' hours at the visits, (B, V); ≤ 0 where a blade had not joined."""
        return np.asarray(self.visits_h - self.offset_h[:, None])

    def with_effect(self, effect: str, size: float | None = None) -> list[int]:
        """Rotors for which the effect was run, and strongly enough for its size.

        Raises InputError where there is none: an effect that is scaled up far is none of physics.
        """
        share = self.shares[effect]
        found = [r for r in range(self.rotors) if np.isfinite(share[r]).any()]
        strengths = [self.strength(r, effect, size) for r in found]
        left = [r for r, strength in zip(found, strengths, strict=True) if strength <= STRONGEST]
        if not left:
            weakest = round(min(strengths, default=0.0), 2)
            raise InputError(
                "size",
                size,
                f"would need the runs with {effect} scaled by {weakest}, more than {STRONGEST:g}",
                "give a smaller one",
            )
        return left

    def strength(self, rotor: int, effect: str, size: float | None) -> float:
        """By how much the effect as it was run is scaled, to change readings by `size` noises."""
        if size is None:
            return 1.0
        if not self.scaled:
            raise InputError("size", size, f"is not for {self.name}", "its effects are as run")
        change = self.elongation[rotor, :, -1] * (self.shares[effect][rotor, :, -1] - 1.0)
        return float(size * NOISE / np.mean(change[change != 0.0]))

    def changed(self, rotor: int, effect: str | None, size: float | None = None) -> Array:
        """Elongation with an effect [mm], (B, V)."""
        sound = self.elongation[rotor]
        if effect is None:
            return np.asarray(sound)
        strength = self.strength(rotor, effect, size)
        return np.asarray(sound * (1.0 + strength * (self.shares[effect][rotor] - 1.0)))

    def scanned(self, rotor: int, effect: str | None, size: float | None = None) -> Array:
        """Deformation with an effect [mm], (B, S, N, 3); no scans where the plan has none."""
        if self.scans is None:
            return np.zeros((self.blades, 0, 0, 3))
        plain = self.scans.shape[rotor]
        if effect is None:
            return np.asarray(plain)
        strength = self.strength(rotor, effect, size)
        return np.asarray(plain + strength * self.scans.change[effect][rotor])

    def ahead(self, rotor: int, effect: str | None, size: float | None = None) -> Array | None:
        """The same at the horizon, (B,); none where the plan has none."""
        if self.horizon is None or effect is None or self.horizon_shares is None:
            return None if self.horizon is None else np.asarray(self.horizon[rotor])
        share = self.horizon_shares[effect][rotor] - 1.0
        return np.asarray(self.horizon[rotor] * (1.0 + self.strength(rotor, effect, size) * share))


@cache
def rotor_20() -> Plan:
    """24 rotors of 20 blades, four of them with effects."""
    kept, visits = fe_rotors.load(), truths.VISITS_H[:6]
    offset = np.array([truths.offset_h(b) for b in range(fe_rotors.BLADES)])
    late = (offset / truths.VISITS_H[0]).round().astype(int)
    shape = (len(kept.inputs), fe_rotors.BLADES, len(visits))
    elongation = np.full(shape, np.nan)
    named = {"worn lot": "wear", "step": "step", "tertiary": "tertiary", "pulse": "pulse"}
    shares = {effect: np.full(shape, np.nan) for effect in named}
    for rotor in range(shape[0]):
        curves = np.stack([kept.at("elongation", rotor, h) for h in truths.VISITS_H], axis=1)
        run = {e: truths.share(rotor, named[e]) for e in shares if rotor in truths.ROTORS}
        for b in range(shape[1]):
            own = np.arange(len(visits)) - late[b]
            read = own >= 0
            elongation[rotor, b, read] = curves[b, own[read]]
            for effect, share in run.items():
                shares[effect][rotor, b, read] = share[b, own[read]]
    worn = truths.WORN
    coat = np.array([0 if b in worn else 1 if b < worn[0] else 2 for b in range(shape[1])])
    return Plan("rotor-20", np.array(visits), offset, coat, elongation, shares, (3, 4), False)


@cache
def of_fleet(name: str, of: Fleet) -> Plan:
    """Rotors of 100 blades."""
    with np.load(of.shipped, allow_pickle=False) as data:
        elongation, share = data["elongation"], data["share"]
    return _fleet(name, of, elongation, dict(zip(fleet.EFFECTS, share, strict=True)))


def _fleet(name: str, of: Fleet, elongation: Array, shares: Mapping[str, Array]) -> Plan:
    """Of elongations (R, B, V + 1) and shares by effect, the last of each at the horizon."""
    coat = np.arange(fleet.BLADES) % 3
    every = dict(shares)
    every["worn lot"] = np.where((coat == 0)[None, :, None], every["wear"], 1.0)
    return Plan(
        name,
        np.array(of.visits_h),
        np.array([of.late(b) for b in range(fleet.BLADES)]),
        coat,
        elongation[:, :, :-1],
        {effect: own[:, :, :-1] for effect, own in every.items()},
        of.odd,
        True,
        fleet.HORIZON_H,
        elongation[:, :, -1],
        {effect: own[:, :, -1] for effect, own in every.items()},
    )


@cache
def fleet_scans(rotor: str = scans.FIRST) -> Plan:
    """A rotor of 100 blades whose shapes are known, and scans of these; the first is one of
    ``fleet-100``."""
    kept, visits = scans.load(rotor), [0, len(FIVE_AGES.visits_h) - 1]
    name = "fleet-scans" if rotor == scans.FIRST else "fleet-scans-2"
    of_one = {effect: own[None] for effect, own in kept.shares.items()}
    whole = _fleet(name, FIVE_AGES, kept.elongation[None], of_one)
    every = {effect: one[None, :, visits] for effect, one in kept.change.items()}
    every["worn lot"] = np.where((whole.coat == 0)[None, :, None, None, None], every["wear"], 0.0)
    scanned = tuple(b for b in range(fleet.BLADES) if b % 5 in (0, 2))
    shape = kept.shape[None, :, visits]
    return replace(whole, scans=Scanned(tuple(visits), scanned, kept.nodes, shape, every))


PLANS: Mapping[str, Callable[[], Plan]] = {
    "rotor-20": rotor_20,
    "fleet-100": partial(of_fleet, "fleet-100", FIVE_AGES),
    "fleet-one-age": partial(of_fleet, "fleet-one-age", ONE_AGE),
    "fleet-six-visits": partial(of_fleet, "fleet-six-visits", SIX_VISITS),
    "fleet-scans": fleet_scans,
    "fleet-scans-2": partial(fleet_scans, scans.SECOND),
}


def plan(name: str) -> Plan:
    """A plan by its name; InputError where there is none."""
    if name not in PLANS:
        raise InputError("plan", name, "is unknown", f"use {', '.join(PLANS)}")
    return PLANS[name]()
