"""Rows of the readings with an effect of physics less those without, at the points of every blade.

An input that runs in time is followed through the creep's memory (`core.surrogate.history`), piece
by piece between the hours at which something changes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from core.answers import Answers
from core.diagnosis.grammar import Facts
from core.diagnosis.moving import Moving, Physics
from core.diagnosis.scores import Scores
from core.drift import Drift
from core.errors import InputError
from core.observation import Inspection
from core.surrogate import Surrogate
from core.surrogate.driven import Driven
from core.surrogate.followed import Followed
from core.surrogate.history import follow
from core.surrogate.targets import DEFORMATION, MEAN_CEEQ

Array = NDArray[np.float64]
PARTS = 6  # of a ramp
Held = dict[tuple[object, ...], Array]


def change(
    physics: Physics, seen: Scores, facts: Mapping[str, Facts], effect: Moving, held: Held
) -> Array:
    """(B, K, n): the rows with the effect less those without, at the points of every blade.

    held  rows without, by the group of readings; filled
    """
    out = np.zeros(seen.answers.shape)
    drifts = [physics.drifts(blade) for blade in seen.blades]
    for members in _groups(seen, drifts).values():
        b0, i0 = members[0]
        mixing = seen.rows[b0].mixings.get(int(seen.place[b0, i0]))
        blades = sorted({b for b, _ in members})
        hours = np.unique([seen.reading(b, i).time_h for b, i in members])
        one = None if mixing is not None else seen.reading(b0, i0)
        modes = None if mixing is None else mixing.modes
        moved = _follow(physics, seen, facts, effect, blades, hours, modes, one, held)
        for b, i in members:
            place = int(seen.place[b, i])
            at = moved[blades.index(b), :, int(np.searchsorted(hours, seen.reading(b, i).time_h))]
            if mixing is None:
                out[b, :, i] = at[:, 0]
                continue
            rows = slice(i, i + at.shape[1])
            out[b, :, rows] = at @ seen.rows[b].mixings[place].turn.T
    return out


def _groups(
    seen: Scores, drifts: Sequence[tuple[Drift, ...]]
) -> dict[object, list[tuple[int, int]]]:
    """Blade and row of what is followed at once: readings of one kind, of blades that run alike.

    Of scans the first row of each, those of blades that were scanned at the same hours together.
    """
    scanned: dict[tuple[int, bytes], list[tuple[int, int]]] = {}
    groups: dict[object, list[tuple[int, int]]] = {}
    for b, i in np.argwhere(seen.real).tolist():
        reading, mixings, place = seen.reading(b, i), seen.rows[b].mixings, int(seen.place[b, i])
        if place not in mixings:
            nodes = None if reading.nodes is None else tuple(reading.nodes)
            groups.setdefault((reading.quantity, nodes, drifts[b]), []).append((b, i))
        elif i == 0 or seen.place[b, i - 1] != place:
            scanned.setdefault((b, mixings[place].modes.tobytes()), []).append((b, i))
    for (b, modes), members in scanned.items():
        hours = tuple(seen.reading(b, i).time_h for _, i in members)
        groups.setdefault(("scan", modes, hours, drifts[b]), []).extend(members)
    return groups


def _follow(
    physics: Physics,
    seen: Scores,
    facts: Mapping[str, Facts],
    effect: Moving,
    blades: Sequence[int],
    hours: Array,
    modes: Array | None,
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
    what = _rule(physics, base, reading, modes)
    if what is None or not isinstance(base, Surrogate):
        flat = _at_once(physics, base, x, effect, hours, reading, modes)
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
        ((mean, _, _),) = follow(base, edges, pieces, marks, last, [what], doubt=False, late=True)
        return mean

    key = (tuple(blades), hours.tobytes(), None if modes is None else modes.tobytes())
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
    physics: Physics, base: Answers, reading: Inspection | None, modes: Array | None
) -> Followed | None:
    """How rows are followed in time; None where they do not grow from 0 with creep."""
    if not isinstance(base, Surrogate) or MEAN_CEEQ not in base.parts:
        return None
    if modes is not None:
        creeps = base.parts[DEFORMATION].form == "per ceeq"
        return Followed.mixed(base, modes) if creeps else None
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
    modes: Array | None,
) -> Array:
    """The same for what has no memory: constant effects only, as the others mean nothing."""
    j = [i.name for i in base.inputs].index(effect.input)
    changed = x.copy()
    s = np.ones(len(x)) if float(effect.course.at(0.0)) == 1.0 else np.zeros(len(x))
    changed[:, j] = effect.moved(x[:, j], s)
    if isinstance(base, Surrogate):
        low, high = np.array([(i.low, i.high) for i in base.inputs]).T
        changed = np.clip(changed, low, high)
    if modes is not None:
        every = [base.mode_response(float(hour), modes) for hour in hours]
        return np.stack([one.evaluate(changed)[0] - one.evaluate(x)[0] for one in every], axis=1)
    quantity, nodes = physics.asked(_given(reading))
    after, _ = base.predict(changed, quantity, hours, nodes)
    before, _ = base.predict(x, quantity, hours, nodes)
    return np.asarray((after - before).reshape(len(x), len(hours), -1))
