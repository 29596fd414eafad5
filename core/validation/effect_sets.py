"""Simulated rotors with and without undeclared effects: what the study of diagnoses is held on.

A set is one of the finite-element rotors of a plan (`effect_plans`), read by three instruments,
with noise drawn anew; labels of blades, lots, coatings, campaigns and instruments are drawn too, so
that no name gives anything away. What is planted (`CONDITIONS`) comes from finite elements or is
put on readings by the formulas below, none of them the surrogate. A third of the planted kinds is
outside of the grammar. Clean sets come with normal noise, with heavy tails (t with three degrees of
freedom), and with material that creeps in bursts: increments between visits from a gamma
distribution with a coefficient of variation of `BURSTS`.

Of `PAIRS` two are planted together, of physics one at most.

In ``one scanner a visit`` every visit has an instrument of its own, and one of them reads too much:
an offset of the instrument and of the campaign are the same thing, and no reading tells them apart.

Where a plan has 3-D scans, an effect of physics is in them as finite elements say; faults of those
who read elongations, and the formulas' other effects, are not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import RotorSpec
from core.diagnosis.case import Case
from core.diagnosis.clock import with_offsets
from core.diagnosis.grammar import Facts
from core.observation import Inspection
from core.rng import seed_of, stream
from core.validation.effect_plans import NOISE, SCAN_NOISE, Plan

Array = NDArray[np.float64]
INSTRUMENTS = 3
BURSTS = 0.15
OFFSET, GAIN, ODD = 0.04, 0.1, 0.06
SIZE = 2.0  # noises, where a plan's effects are scaled
CLEAN = ("clean", "clean, heavy tails", "clean, bursts")
SENSORS = ("campaign", "instrument", "gain")
PHYSICS = ("wear", "worn lot", "fouling", "step", "tertiary")
NAMED = (*SENSORS, *PHYSICS)
ALIKE = ("one scanner a visit",)
OUTSIDE = ("pulse", "alternating", "some blades late")
CONDITIONS = (*CLEAN, *NAMED, *ALIKE, *OUTSIDE)
AND = " + "
PAIRS = (
    *("campaign + instrument", "campaign + gain", "worn lot + campaign", "wear + instrument"),
    *("fouling + campaign", "step + gain", "pulse + campaign"),
)
COATING, GAS = ("coating wear", "coating loss"), ("firing temperature step", "gas temperature")


@dataclass(frozen=True)
class Set:
    """A simulated rotor: readings, facts of its blades, and the names that would be right.

    each   of what is planted, the names of each that has any
    exact  readings without noise, by their id, shaped as they are; sound: those without what is
           planted as well
    ahead  blades' elongation at the plan's horizon; sound_ahead: without what is planted
    """

    case: Case
    truth: frozenset[str]
    each: tuple[frozenset[str], ...]
    exact: dict[str, Array]
    sound: dict[str, Array]
    ahead: dict[str, float]
    sound_ahead: dict[str, float]

    @property
    def without(self) -> tuple[Inspection, ...]:
        """The readings with the noise that they have, and without what is planted."""
        return tuple(
            replace(r, values=self.sound[r.id] + (r.values - self.exact[r.id]))
            for r in self.case.readings
        )


@dataclass(frozen=True, slots=True)
class Labels:
    """What things are called, drawn at random."""

    blades: list[str]
    lots: list[str]
    coats: list[str]
    visits: list[str]
    readers: list[str]

    @staticmethod
    def drawn(rng: np.random.Generator, plan: Plan) -> Labels:
        counts = {"b": plan.blades, "l": 3, "c": 3, "v": len(plan.visits_h), "s": INSTRUMENTS}
        return Labels(
            *(
                [f"{prefix}{n}" for n in rng.choice(900, count, replace=False) + 100]
                for prefix, count in counts.items()
            )
        )

    def right(self, condition: str, plan: Plan) -> frozenset[str]:
        """The names, or causes, that say what is planted."""
        reader, visit = self.readers[0], self.visits[plan.odd_visits[0]]
        lot = f"(coating lot {self.coats[0]})"
        scanner = self.readers[plan.odd_visits[0] % INSTRUMENTS]
        zero = ("instrument offset", "wrong zero")
        names: dict[str, tuple[str, ...]] = {
            "campaign": (f"campaign offset (campaign {visit})",),
            "instrument": tuple(f"{name} (instrument {reader})" for name in zero),
            "gain": (f"instrument gain (instrument {reader})",),
            "wear": COATING,
            "worn lot": tuple(f"{name} {lot}" for name in COATING),
            "fouling": ("fouling", "gas temperature"),
            "step": GAS,
            "tertiary": ("accelerating creep",),
            ALIKE[0]: tuple(f"{name} (instrument {scanner})" for name in zero),
        }
        return frozenset(names.get(condition, ()))


def effect_of(condition: str, plan: Plan) -> str | None:
    """What is planted by finite elements, if anything."""
    return next((part for part in condition.split(AND) if part in plan.shares), None)


def conditions(plan: Plan) -> tuple[str, ...]:
    """Those that the plan has truths for."""
    lacking = {c for c in (*PHYSICS, "pulse") if effect_of(c, plan) is None}
    if len(plan.visits_h) > INSTRUMENTS:  # an instrument comes twice, which tells it from a visit
        lacking |= set(ALIKE)
    return tuple(c for c in CONDITIONS if c not in lacking)


def pairs(plan: Plan) -> tuple[str, ...]:
    """Those of `PAIRS` that the plan has truths for."""
    possible = conditions(plan)
    return tuple(c for c in PAIRS if all(part in possible for part in c.split(AND)))


def made(
    plan: Plan, condition: str, number: int, seed: int, particles: int, size: float = SIZE
) -> Set:
    """Set `number` of a condition; `size` in noises where the plan's effects are scaled."""
    rng = stream(seed, "effects", condition, number)
    effect, planted = effect_of(condition, plan), condition.split(AND)
    among = (
        plan.with_effect(effect, size if plan.scaled else None)
        if effect
        else list(range(plan.rotors))
    )
    rotor = among[number % len(among)]
    labels = Labels.drawn(rng, plan)
    strength = size if plan.scaled else None
    curves, plain = plan.changed(rotor, effect, strength), plan.changed(rotor, None)
    if condition == "clean, bursts":
        curves = plain = bursts(rng, curves)
    offset, gain, odd = faults(plan, rotor, size)
    own_h, count = plan.own_h, plan.blades
    late = set(rng.choice(count, count // 3, replace=False).tolist())
    odd_visit, odd_from = plan.odd_visits
    readings, exact, sound = [], dict[str, Array](), dict[str, Array]()
    for b in range(count):
        for v in range(len(plan.visits_h)):
            if not np.isfinite(curves[b, v]):
                continue
            by = v % INSTRUMENTS if condition in ALIKE else (b + v) % INSTRUMENTS
            noise = rng.standard_t(3) / np.sqrt(3) if condition == CLEAN[1] else rng.normal()
            y = float(curves[b, v])
            y *= 1.0 + gain * ("gain" in planted and by == 0)
            y += offset * (planted[0] in ALIKE and v == odd_visit)
            y += offset * ("campaign" in planted and v == odd_visit)
            y += offset * ("instrument" in planted and by == 0)
            y += odd * (-1) ** (b // 2 + v) * (condition == "alternating")
            y += odd * (condition == "some blades late" and b in late and v >= odd_from)
            name = f"r{rng.integers(10**9)}"
            values = np.array([round(y + NOISE * noise, 5)])
            at = (name, labels.blades[b], "elongation", float(own_h[b, v]))
            readings.append(
                Inspection(*at, values, instrument=labels.readers[by], campaign=labels.visits[v])
            )
            exact[name], sound[name] = np.array([y]), plain[b, v : v + 1]
    shapes = [plan.scanned(rotor, what, strength) for what in (effect, None)]
    if condition == "clean, bursts" and plan.scans is not None:
        jump = (curves / plan.changed(rotor, None))[:, plan.scans.visits, None, None]
        shapes = [one * jump for one in shapes]
    heavy, own = condition == CLEAN[1], stream(seed, "scans", condition, number)
    for scan, with_it, without in scans(plan, labels, shapes, heavy, own):
        readings.append(scan)
        exact[scan.id], sound[scan.id] = with_it, without
    facts = {
        name: Facts(lot=labels.lots[b % 3 if not plan.scaled else b // 2 % 3],
                    coating_lot=labels.coats[plan.coat[b]])
        for b, name in enumerate(labels.blades)
    }  # fmt: skip
    spec = RotorSpec(
        f"set{number}", tuple(sorted(labels.blades)), particles, seed_of(seed, number) % 2**31
    )
    data = tuple(readings[i] for i in rng.permutation(len(readings)))
    case = Case(spec, data, with_offsets(facts, data, {}))
    ahead, sound_ahead = (
        {} if y is None else dict(zip(labels.blades, y.tolist(), strict=True))
        for y in (plan.ahead(rotor, what, strength) for what in (effect, None))
    )
    each = tuple(right for part in planted if (right := labels.right(part, plan)))
    return Set(case, frozenset().union(*each), each, exact, sound, ahead, sound_ahead)


def scans(
    plan: Plan, labels: Labels, shapes: Sequence[Array], heavy: bool, rng: np.random.Generator
) -> Iterator[tuple[Inspection, Array, Array]]:
    """Scans, each with its shape with and without what is planted and without noise, (N, 3).

    shapes  of all blades, with it and without, (B, S, N, 3) each
    """
    if plan.scans is None:
        return
    nodes = plan.scans.nodes
    for b in plan.scans.blades:
        for k, visit in enumerate(plan.scans.visits):
            exact, sound = (one[b, k] for one in shapes)
            noise = rng.standard_t(3, exact.shape) / np.sqrt(3) if heavy else None
            noise = rng.normal(size=exact.shape) if noise is None else noise
            values = np.round(exact + SCAN_NOISE * noise, 5)
            hour, name = float(plan.own_h[b, visit]), f"r{rng.integers(10**9)}"
            at = (name, labels.blades[b], "deformation", hour)
            scan = Inspection(*at, values, nodes, campaign=labels.visits[visit])
            yield scan, exact, sound


def bursts(rng: np.random.Generator, curves: Array) -> Array:
    """Creep whose increments from visit to visit are gamma variables of the same mean, (B, V)."""
    start = np.where(np.isfinite(curves), curves, 0.0)
    steps = np.diff(start, axis=1, prepend=0.0)
    shape = 1.0 / BURSTS**2
    wild = np.cumsum(steps * rng.gamma(shape, 1.0 / shape, steps.shape), axis=1)
    return np.where(np.isfinite(curves), wild, np.nan)


def faults(plan: Plan, rotor: int, size: float) -> tuple[float, float, float]:
    """Offset [mm], gain, and the offset of what is outside of the grammar [mm].

    Where effects are scaled, a gain moves the readings of the last visit by `size` noises on
    average, and all offsets are that large.
    """
    if not plan.scaled:
        return OFFSET, GAIN, ODD
    step = size * NOISE
    return step, step / float(np.mean(plan.elongation[rotor, :, -1])), step
