"""How a cell of the grammar would move the readings, if it were there.

An input that runs in time acts through the creep's memory (`core.surrogate.history`), so that
elongation, deformation and CEEQ move together as physics has it; a sensor moves its readings only.
A signature is the change that an effect of its expected size makes of each row, on average over a
blade's particles, and how that change goes with the residual over them (`core.diagnosis.scores`);
whom it concerns is a mask over blades or readings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import POOL
from core.course import Course
from core.diagnosis.grammar import Cell, Facts, there
from core.diagnosis.scores import Scores
from core.errors import InputError
from core.model import Answers, Model, Stacked
from core.observation import Inspection
from core.surrogate import Surrogate
from core.surrogate.driven import Driven
from core.surrogate.history import Followed, follow

Array = NDArray[np.float64]
PARTS = 6  # of a ramp
NOISES = 3.0  # size of an offset, in noises
BINS = 6  # of hours, for what has no name
PROPORTION = 0.1  # its size, of the answer
Held = dict[tuple[object, ...], Array]


@dataclass(frozen=True, slots=True)
class Physics:
    """What answers for effects: a surrogate, and values of the inputs that the network lacks."""

    answers: Answers
    rest: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class _Course:
    """What an input does, for all blades: `how`, size with its sign, shape, and its clock."""

    input: str
    how: str
    size: float
    course: Course
    rotor: bool

    def moved(self, x: Array, s: Array) -> Array:
        return x + self.size * s if self.how == "plus" else x * (1.0 + self.size * s)


def directed(cell: Cell) -> float:
    """The expected size with its sign (0 counts as up)."""
    return (cell.family.size or 1.0) * (cell.family.sign or 1)


WHOM = ("all", "lot", "coating_lot", "blade", "instrument", "campaign", "quantity")


def labelled(whom: str, blade: str, facts: Facts, reading: Inspection) -> str | None:
    """What a reading is called by in a way of grouping; an effect is on those of its own value."""
    match whom:
        case "lot" | "coating_lot":
            found: str | None = getattr(facts, whom)
        case "blade":
            found = blade
        case "instrument" | "campaign" | "quantity":
            found = getattr(reading, whom)
        case _:
            found = None
    return found


def masks(cells: Sequence[Cell], seen: Scores, facts: Mapping[str, Facts]) -> Array:
    """Which rows each cell concerns, (B, n, C), 0 or 1.

    Of a sensor's, those of its quantity; of an event's, those of blades that were there.
    """
    labels = {whom: np.full(seen.place.shape, None, object) for whom in WHOM}
    for b, i in np.argwhere(seen.real):
        blade, reading = seen.blades[b], seen.reading(b, i)
        for whom, own in labels.items():
            own[b, i] = labelled(whom, blade, facts[blade], reading)
    out = np.zeros((*seen.place.shape, len(cells)))
    for c, cell in enumerate(cells):
        concerned = seen.real & (labels[cell.whom] == cell.value)
        if cell.family.target == "reading":
            concerned &= labels["quantity"] == cell.family.of
        if cell.family.clock == "event":
            concerned &= np.array([[there(cell, facts[b])] for b in seen.blades])
        out[:, :, c] = concerned
    return out


@dataclass(frozen=True, slots=True)
class Signatures:
    """Mean changes g and covariances h with the residual (`scores`), (B, n, C) each."""

    g: Array
    h: Array

    @staticmethod
    def of(parts: Sequence[tuple[Array, Array]], mask: Array) -> Signatures:
        """From g and h (B, n) of each column; mask (B, n, C), of none where all are taken."""
        if not parts:
            return Signatures(mask, mask)
        g, h = (np.stack(both, axis=2) for both in zip(*parts, strict=True))
        return Signatures(g * mask, h * mask)


def signatures(
    model: Model,
    seen: Scores,
    cells: Sequence[Cell],
    facts: Mapping[str, Facts],
    noise: Mapping[str, float],
    physics: Physics | None = None,
) -> Signatures:
    """Change of each row [unit] by each cell at its expected size.

    noise    standard deviation of a reading, by quantity
    physics  a surrogate with more inputs than the model's own, for the change alone
    """
    if isinstance(model.surrogate, Stacked):
        raise InputError("model", model.network.name, "is stacked", "diagnose its parts")
    physics = physics or Physics(model.surrogate, {})
    held: Held = {}

    def course(cell: Cell) -> _Course | None:
        family = cell.family
        if family.target == "reading":
            return None
        return _Course(family.of, family.how, directed(cell), cell.course, family.clock != "blade")

    def changed(key: _Course) -> tuple[Array, Array]:
        return seen.over(_change(physics, seen, facts, key, held))

    keys = [course(cell) for cell in cells]
    every = [key for key in dict.fromkeys(keys) if key is not None]
    found = {key: changed(key) for key in every[:1]}  # computes what is without, for all
    found |= zip(every[1:], POOL.map(changed, every[1:]), strict=True)
    parts = [
        _reading(cell, seen, facts, noise) if key is None else found[key]
        for cell, key in zip(cells, keys, strict=True)
    ]
    return Signatures.of(parts, masks(cells, seen, facts))


def _reading(
    cell: Cell, seen: Scores, facts: Mapping[str, Facts], noise: Mapping[str, float]
) -> tuple[Array, Array]:
    """g and h (B, n) of a sensor's cell."""
    size = cell.family.size if cell.family.size is not None else NOISES * noise[cell.family.of]
    size *= cell.family.sign or 1
    hours = seen.hours
    if cell.family.clock != "blade":
        hours = hours + np.array([[facts[b].offset_h] for b in seen.blades])
    s = np.where(seen.real, cell.course.at(hours), 0.0)
    return seen.in_proportion(size * s) if cell.family.how == "times" else (size * s, 0.0 * s)


def _change(
    physics: Physics, seen: Scores, facts: Mapping[str, Facts], effect: _Course, held: Held
) -> Array:
    """(B, K, n): the rows with the effect less those without, at the points of every blade.

    held  rows without, by the group of readings; filled
    """
    out = np.zeros(seen.answers.shape)
    groups: dict[object, list[tuple[int, int]]] = {}
    for b, i in np.argwhere(seen.real):
        reading, rows = seen.reading(b, i), seen.rows[b]
        if seen.place[b, i] in rows.mixings:
            key: object = ("scan", int(b), int(seen.place[b, i]))
        else:
            key = (reading.quantity, None if reading.nodes is None else tuple(reading.nodes))
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
    effect: _Course,
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
    base, drifts = (answers.base, answers.drifts) if isinstance(answers, Driven) else (answers, ())
    names = [i.name for i in base.inputs]
    x = _inputs(physics, seen, blades, names)
    if not isinstance(base, Surrogate):
        flat = _at_once(base, x, names.index(effect.input), effect, hours, reading)
        return flat.reshape(len(blades), points, *flat.shape[1:])
    clock = [facts[seen.blades[b]].offset_h if effect.rotor else 0.0 for b in blades]
    offset = np.repeat(clock, points)
    steps = {h for d in drifts for h in d.shape.cuts(PARTS)}
    cuts = steps | {h - o for h in effect.course.cuts(PARTS) for o in set(clock)}
    marks = hours[hours > 0]
    low, high = np.array([(i.low, i.high) for i in base.inputs]).T
    what = (
        Followed.mixed(base, mixing)
        if mixing is not None
        else Followed.of(base, *_asked(base, reading))
    )

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
    asked = (*key, "" if reading is None else repr(_asked(base, reading)))
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


def _asked(base: Answers, reading: Inspection | None) -> tuple[str, list[int] | None]:
    assert reading is not None
    if reading.nodes is not None:
        return reading.quantity, [int(n) for n in reading.nodes]
    field = reading.quantity == "ceeq"
    return reading.quantity, [base.named["critical"]] if field else None


def _at_once(
    base: Answers, x: Array, j: int, effect: _Course, hours: Array, reading: Inspection | None
) -> Array:
    """The same for a model without a memory: constant effects only, as the others mean nothing."""
    assert reading is not None
    changed = x.copy()
    s = np.ones(len(x)) if float(effect.course.at(0.0)) == 1.0 else np.zeros(len(x))
    changed[:, j] = effect.moved(x[:, j], s)
    quantity, nodes = _asked(base, reading)
    after, _ = base.predict(changed, quantity, hours, nodes)
    before, _ = base.predict(x, quantity, hours, nodes)
    return np.asarray((after - before).reshape(len(x), len(hours), -1))


def unnamed(seen: Scores, facts: Mapping[str, Facts], bins: int = BINS) -> dict[str, Signatures]:
    """Sets of columns for what has no name: a misfit in proportion, of its own for each bin.

    Bins of the rotor's hours (what happened on a day) and of the blades' own (what comes with
    age), the same number of readings in each; (B, n, K) by name. Sets of one column are left out.
    """
    at = np.argwhere(seen.real)
    scalar = [(b, i) for b, i in at if seen.place[b, i] not in seen.rows[b].mixings]
    own = np.array([seen.reading(b, i).time_h for b, i in scalar])
    rotor = own + [facts[seen.blades[b]].offset_h for b, _ in scalar]
    found = {}
    for name, hours in (("by the rotor's hours", rotor), ("by age", own)):
        visits = np.unique(hours)
        edges = visits if len(visits) <= bins else np.quantile(hours, np.linspace(0, 1, bins + 1))
        place = np.clip(np.searchsorted(edges, hours, side="right") - 1, 0, bins - 1)
        columns = np.zeros((*seen.place.shape, int(place.max(initial=0)) + 1))
        for (b, i), k in zip(scalar, place, strict=True):
            columns[b, i, k] = 1.0
        if columns.shape[2] > 1:
            misfit = seen.in_proportion(PROPORTION * np.ones(seen.place.shape))
            found[name] = Signatures.of([misfit] * columns.shape[2], columns)
    return found
