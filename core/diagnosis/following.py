"""Rows of the readings with an effect of physics less those without, at the points of every blade.

An input that runs in time is followed through the creep's memory (`core.surrogate.history`), piece
by piece between the hours at which something changes for the blade, to the hours at which it was
read: each blade has its own of both (`core.surrogate.histories`). What blades were read of, lengths
and scans, is followed at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from core.answers import Answers
from core.diagnosis.grammar import Facts
from core.diagnosis.moving import Moving, Physics
from core.diagnosis.read_alike import Alike, Kind, read_alike
from core.diagnosis.scores import Scores
from core.errors import InputError
from core.surrogate import Surrogate
from core.surrogate.driven import Driven
from core.surrogate.followed import Followed
from core.surrogate.histories import follow_each
from core.surrogate.targets import DEFORMATION, MEAN_CEEQ

Array = NDArray[np.float64]
PARTS = 6  # of a ramp
Held = dict[tuple[object, ...], list[Array]]


def change(
    physics: Physics, seen: Scores, facts: Mapping[str, Facts], effect: Moving, held: Held
) -> Array:
    """(B, K, n): the rows with the effect less those without, at the points of every blade.

    held  what is without effects, for all of them; filled
    """
    out = np.zeros(seen.answers.shape)
    for alike in read_alike(physics, seen):
        moved = _follow(physics, seen, facts, effect, alike, held)
        for kind, rows, changed in zip(alike.kinds, alike.rows, moved, strict=True):
            for b, k, i in rows:
                blade = alike.blades[b]
                if kind.modes is None:
                    out[blade, :, i] = changed[b, :, k, 0]
                    continue
                turn = seen.rows[blade].mixings[int(seen.place[blade, i])].turn
                out[blade, :, i : i + len(turn)] = changed[b, :, k] @ turn.T
    return out


def _follow(
    physics: Physics,
    seen: Scores,
    facts: Mapping[str, Facts],
    effect: Moving,
    alike: Alike,
    known: Held,
) -> list[Array]:
    """Change of the rows of each kind, (b, K, T, R), at the points of these blades.

    What is without the effect is the same for all effects, and is computed once (`known`).
    """
    answers, shape = physics.answers, (len(alike.blades), seen.answers.shape[1])
    base = answers.base if isinstance(answers, Driven) else answers
    names = [i.name for i in base.inputs]
    x = _inputs(physics, seen, alike.blades, names)
    rules = [_rule(physics, base, kind) for kind in alike.kinds]
    what = [rule for rule in rules if rule is not None]
    followed = iter(list[Array]())
    if what:
        assert isinstance(base, Surrogate)
        clock = [facts[seen.blades[b]].offset_h if effect.rotor else 0.0 for b in alike.blades]
        given = (base, names, x.reshape(*shape, -1), alike, what)
        points = {d.name: [seen.points[b][d.name] for b in alike.blades] for d in alike.drifts}
        key = (alike.blades, tuple(kind.key for kind in alike.kinds))
        if key not in known:
            known[key] = _along(*given, points)
        moved = _along(*given, points, effect, np.array(clock))
        followed = iter([one - other for one, other in zip(moved, known[key], strict=True)])
    return [
        next(followed) if rule is not None else _at_once(physics, base, x, effect, alike, kind)
        for rule, kind in zip(rules, alike.kinds, strict=True)
    ]


def _along(
    base: Surrogate,
    names: Sequence[str],
    x: Array,
    alike: Alike,
    what: Sequence[Followed],
    points: Mapping[str, Sequence[Array]],
    effect: Moving | None = None,
    clock: Array | None = None,
) -> list[Array]:
    """Rows of each kind, (b, K, T, R), where the inputs x (b, K, d) run; 0 at hour 0.

    points  amplitudes (K,) of the drifts of each blade; clock: hour of the effect at which each
            blade's hours are zero, (b,)
    """
    marks = np.where(alike.hours > 0, alike.hours, np.nan)
    steps = {h for d in alike.drifts for h in d.shape.cuts(PARTS)}
    own = list[list[float]]()
    for n, until in enumerate(np.nanmax(alike.hours, axis=1)):
        cuts = set(steps)
        if effect is not None and clock is not None:
            cuts |= {h - float(clock[n]) for h in effect.course.cuts(PARTS)}
        own.append([0.0, *sorted(h for h in cuts if 0 < h < until)])
    edges = np.full((len(own), max(map(len, own)) + 1), np.nan)
    for row, one in zip(edges, own, strict=True):
        row[: len(one)] = one
    last = np.sum(edges[:, None, :] < marks[:, :, None], axis=2) - 1
    starts = np.take_along_axis(edges, np.maximum(last, 0), axis=1)
    middle = np.concatenate([0.5 * (edges[:, :-1] + edges[:, 1:]), 0.5 * (starts + marks)], axis=1)
    inputs = np.repeat(x[:, :, None], middle.shape[1], axis=2)
    for d in alike.drifts:
        j, a = names.index(d.input), np.stack(points[d.name])[:, :, None]
        inputs[..., j] = d.moved(inputs[..., j], a, d.shape.at(middle)[:, None])
    if effect is not None and clock is not None:
        j, s = names.index(effect.input), effect.course.at(middle + clock[:, None])
        inputs[..., j] = effect.moved(inputs[..., j], s[:, None])
    low, high = np.array([(i.low, i.high) for i in base.inputs]).T
    flat = np.clip(inputs, low, high).reshape(-1, *inputs.shape[2:])
    pieces, points_ = edges.shape[1] - 1, x.shape[1]
    found = follow_each(
        base,
        np.repeat(edges, points_, axis=0),
        flat[:, :pieces],
        np.repeat(marks, points_, axis=0),
        flat[:, pieces:],
        what,
        late=True,
    )
    nothing = np.isnan(marks)[:, None, :, None]
    return [np.where(nothing, 0.0, one.reshape(*x.shape[:2], *one.shape[1:])) for one in found]


def _inputs(physics: Physics, seen: Scores, blades: Iterable[int], names: Sequence[str]) -> Array:
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


def _rule(physics: Physics, base: Answers, kind: Kind) -> Followed | None:
    """How rows are followed in time; None where they do not grow from 0 with creep."""
    if not isinstance(base, Surrogate) or MEAN_CEEQ not in base.parts:
        return None
    if kind.modes is not None:
        creeps = base.parts[DEFORMATION].form == "per ceeq"
        return Followed.mixed(base, kind.modes) if creeps else None
    try:
        return Followed.of(base, *physics.asked(kind.reading))
    except InputError:
        return None


def _at_once(
    physics: Physics, base: Answers, x: Array, effect: Moving, alike: Alike, kind: Kind
) -> Array:
    """The same for what has no memory: constant effects only, as the others mean nothing."""
    j = [i.name for i in base.inputs].index(effect.input)
    changed = x.copy()
    s = np.ones(len(x)) if float(effect.course.at(0.0)) == 1.0 else np.zeros(len(x))
    changed[:, j] = effect.moved(x[:, j], s)
    if isinstance(base, Surrogate):
        low, high = np.array([(i.low, i.high) for i in base.inputs]).T
        changed = np.clip(changed, low, high)
    shape, out = (len(alike.blades), len(x) // len(alike.blades)), list[Array]()

    def answered(x: Array, hours: Array) -> Array:
        if kind.modes is not None:
            every = [base.mode_response(float(hour), kind.modes) for hour in hours]
            return np.stack([one.evaluate(x)[0] for one in every], axis=1)
        quantity, nodes = physics.asked(kind.reading)
        return base.predict(x, quantity, hours, nodes)[0].reshape(len(x), len(hours), -1)

    after, before = (one.reshape(*shape, -1) for one in (changed, x))
    for own, one, other in zip(alike.hours, after, before, strict=True):
        hours = own[~np.isnan(own)]
        moved = answered(one, hours) - answered(other, hours)
        out.append(np.pad(moved, ((0, 0), (0, len(own) - len(hours)), (0, 0))))
    return np.stack(out)
