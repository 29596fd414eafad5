"""Rows of the readings with an effect of physics less those without, at the points of every blade.

An input that runs in time is followed through the creep's memory (`core.surrogate.history`), piece
by piece between the hours at which something changes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.answers import Answers
from core.course import Course
from core.diagnosis.grammar import Facts
from core.diagnosis.scores import Scores
from core.drift import Drift
from core.errors import InputError
from core.network import Network
from core.observation import Inspection
from core.surrogate import Surrogate
from core.surrogate.driven import Driven
from core.surrogate.history import Followed, follow
from core.surrogate.targets import DEFORMATION, MEAN_CEEQ

Array = NDArray[np.float64]
PARTS = 6  # of a ramp
Held = dict[tuple[object, ...], Array]


@dataclass(frozen=True, slots=True)
class Physics:
    """What answers for effects.

    rest     values of the inputs that the network lacks
    fields   by each quantity that is read at a node, the one where a reading names none
    network  of the model, with the effects that it has already
    """

    answers: Answers
    rest: Mapping[str, float]
    fields: Mapping[str, int]
    network: Network

    @staticmethod
    def of(network: Network, answers: Answers, rest: Mapping[str, float]) -> Physics:
        """For the quantities of a network."""
        read_at = [q for q in network.quantities if q.kind == "field"]
        there = {q.name: q.default_node for q in read_at if q.default_node in answers.named}
        fields = {q: answers.named[node] for q, node in there.items()}
        return Physics(answers, rest, fields, network)

    def drifts(self, blade: str) -> tuple[Drift, ...]:
        """What moves a blade's inputs in the model already, by the blade's own hours."""
        asleep = {p.name for p in self.network.of_level("dormant")}
        own = (d.of_blade(blade) for d in self.network.drifts if d.name not in asleep)
        return tuple(d for d in own if d is not None)

    def asked(self, reading: Inspection) -> tuple[str, list[int] | None]:
        """Quantity and nodes of a reading."""
        if reading.nodes is not None:
            return reading.quantity, [int(n) for n in reading.nodes]
        node = self.fields.get(reading.quantity)
        return reading.quantity, None if node is None else [node]


@dataclass(frozen=True, slots=True)
class Moving:
    """What an input does, for all blades: `how`, size with its sign, shape, and its clock."""

    input: str
    how: str
    size: float
    course: Course
    rotor: bool

    def moved(self, x: Array, s: Array) -> Array:
        return x + self.size * s if self.how == "plus" else x * (1.0 + self.size * s)


def change(
    physics: Physics, seen: Scores, facts: Mapping[str, Facts], effect: Moving, held: Held
) -> Array:
    """(B, K, n): the rows with the effect less those without, at the points of every blade.

    held  rows without, by the group of readings; filled
    """
    out = np.zeros(seen.answers.shape)
    groups: dict[object, list[tuple[int, int]]] = {}
    drifts = [physics.drifts(blade) for blade in seen.blades]
    for b, i in np.argwhere(seen.real):
        reading, rows = seen.reading(b, i), seen.rows[b]
        if seen.place[b, i] in rows.mixings:
            key: object = ("scan", int(b), int(seen.place[b, i]))
        else:
            nodes = None if reading.nodes is None else tuple(reading.nodes)
            key = (reading.quantity, nodes, drifts[b])
        groups.setdefault(key, []).append((int(b), int(i)))
    for members in groups.values():
        b0, i0 = members[0]
        reading, rows = seen.reading(b0, i0), seen.rows[b0]
        place = int(seen.place[b0, i0])
        if place in rows.mixings:
            hours = np.array([reading.time_h])
            mixing = rows.mixings[place]
            moved = _follow(physics, seen, facts, effect, [b0], hours, mixing, None, held)
            for b, i in members:
                out[b, :, i] = moved[0, :, 0, i - i0]
            continue
        blades = sorted({b for b, _ in members})
        hours = np.unique([seen.reading(b, i).time_h for b, i in members])
        moved = _follow(physics, seen, facts, effect, blades, hours, None, reading, held)
        for b, i in members:
            at = int(np.searchsorted(hours, seen.reading(b, i).time_h))
            out[b, :, i] = moved[blades.index(b), :, at, 0]
    return out


def _follow(
    physics: Physics,
    seen: Scores,
    facts: Mapping[str, Facts],
    effect: Moving,
    blades: Sequence[int],
    hours: Array,
    mixing: Array | None,
    reading: Inspection | None,
    known: Held,
) -> Array:
    """Change of the rows (n, K, T, R) at the points of these blades at hours (T,).

    What is without the effect is the same for all effects, and is computed once (`known`).
    """
    answers, points = physics.answers, seen.answers.shape[1]
    base = answers.base if isinstance(answers, Driven) else answers
    drifts = physics.drifts(seen.blades[blades[0]])  # those of all of them
    names = [i.name for i in base.inputs]
    x = _inputs(physics, seen, blades, names)
    what = _rule(physics, base, reading, mixing)
    if what is None or not isinstance(base, Surrogate):
        flat = _at_once(physics, base, x, effect, hours, reading, mixing)
        return flat.reshape(len(blades), points, *flat.shape[1:])
    clock = [facts[seen.blades[b]].offset_h if effect.rotor else 0.0 for b in blades]
    offset = np.repeat(clock, points)
    steps = {h for d in drifts for h in d.shape.cuts(PARTS)}
    cuts = steps | {h - o for h in effect.course.cuts(PARTS) for o in set(clock)}
    marks = hours[hours > 0]
    low, high = np.array([(i.low, i.high) for i in base.inputs]).T

    def held(middle: Array) -> Array:
        """The inputs (n K, P, d) in the middle of pieces, without the effect."""
        found = np.repeat(x[:, None], len(middle), axis=1)
        for d in drifts:
            j, a = names.index(d.input), np.concatenate([seen.points[b][d.name] for b in blades])
            for p, hour in enumerate(middle):
                found[:, p, j] = d.moved(found[:, p, j], a, float(d.shape.at(hour)))
        return found

    def changed(middle: Array) -> Array:
        """The same with it."""
        found, j = held(middle), names.index(effect.input)
        for o in set(clock):
            s, own = effect.course.at(middle + o), offset == o
            found[own, :, j] = effect.moved(found[own, :, j], s)
        return found

    def along(hours_of: set[float], inputs: Callable[[Array], Array]) -> Array:
        """Rows (n K, marks, R) where inputs run piece by piece."""
        edges = np.array([0.0, *sorted(h for h in hours_of if 0 < h < hours.max())])
        starts = edges[np.searchsorted(edges, marks) - 1]
        ends = np.r_[edges[1:], marks]
        middle = 0.5 * (np.r_[edges[:-1], starts] + ends)  # of the pieces, then those to the marks
        inside = np.clip(inputs(middle), low, high)
        pieces, last = inside[:, : len(edges) - 1], inside[:, len(edges) - 1 :]
        mean, _, _ = follow(base, edges, pieces, marks, last, what, doubt=False)
        return np.asarray(mean)

    key = (tuple(blades), hours.tobytes(), None if mixing is None else mixing.tobytes())
    asked = (*key, "" if reading is None else repr(physics.asked(reading)))
    if asked not in known:
        known[asked] = along(steps, held)
    out = np.zeros((len(x), len(hours), what.curves.forms.shape[2]))
    out[:, hours > 0] = along(cuts, changed) - known[asked]
    return out.reshape(len(blades), points, *out.shape[1:])


def _inputs(physics: Physics, seen: Scores, blades: Sequence[int], names: Sequence[str]) -> Array:
    """Inputs (n K, d) at the points of these blades."""
    points = seen.answers.shape[1]
    columns = [
        np.concatenate(
            [seen.points[b].get(n, np.full(points, physics.rest.get(n, np.nan))) for b in blades]
        )
        for n in names
    ]
    x = np.stack(columns, axis=1)
    if np.isnan(x).any():
        unknown = [n for n, column in zip(names, x.T, strict=True) if np.isnan(column).any()]
        raise InputError("inputs", unknown, "have no value", "give them as nominal ones")
    return x


def _rule(
    physics: Physics, base: Answers, reading: Inspection | None, mixing: Array | None
) -> Followed | None:
    """How rows are followed in time; None where they do not grow from 0 with creep."""
    if not isinstance(base, Surrogate) or MEAN_CEEQ not in base.parts:
        return None
    if mixing is not None:
        creeps = base.parts[DEFORMATION].form == "per ceeq"
        return Followed.mixed(base, mixing) if creeps else None
    try:
        return Followed.of(base, *physics.asked(_given(reading)))
    except InputError:
        return None


def _given(reading: Inspection | None) -> Inspection:
    assert reading is not None
    return reading


def _at_once(
    physics: Physics,
    base: Answers,
    x: Array,
    effect: Moving,
    hours: Array,
    reading: Inspection | None,
    mixing: Array | None,
) -> Array:
    """The same for what has no memory: constant effects only, as the others mean nothing."""
    j = [i.name for i in base.inputs].index(effect.input)
    changed = x.copy()
    s = np.ones(len(x)) if float(effect.course.at(0.0)) == 1.0 else np.zeros(len(x))
    changed[:, j] = effect.moved(x[:, j], s)
    if isinstance(base, Surrogate):
        low, high = np.array([(i.low, i.high) for i in base.inputs]).T
        changed = np.clip(changed, low, high)
    if mixing is not None:
        rows = base.mode_response(float(hours[0]), mixing)
        return np.asarray(rows.evaluate(changed)[0] - rows.evaluate(x)[0])[:, None, :]
    quantity, nodes = physics.asked(_given(reading))
    after, _ = base.predict(changed, quantity, hours, nodes)
    before, _ = base.predict(x, quantity, hours, nodes)
    return np.asarray((after - before).reshape(len(x), len(hours), -1))
