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

from core.answers import Stacked
from core.calibration.message import POOL
from core.diagnosis.following import Held, change
from core.diagnosis.grammar import Cell, Facts
from core.diagnosis.masks import masks
from core.diagnosis.moving import Moving, Physics
from core.diagnosis.scores import Scores
from core.errors import InputError
from core.model import Model

Array = NDArray[np.float64]
Order = NDArray[np.intp]
Change = Callable[[Order], tuple[Array, Array]]
NOISES = 3.0  # size of an offset, in noises
BINS = 6  # of hours, for what has no name
PROPORTION = 0.1  # its size, of the answer


def directed(cell: Cell) -> float:
    """The expected size with its sign (0 counts as up)."""
    return (cell.family.size or 1.0) * (cell.family.sign or 1)


@dataclass(frozen=True, slots=True)
class Signatures:
    """Mean changes g and covariances h with the residual (`scores`), (B, n, C) each."""

    g: Array
    h: Array

    @staticmethod
    def of(parts: Sequence[tuple[Array, Array]], mask: NDArray[np.generic]) -> Signatures:
        """From g and h (B, n) of each column; mask (B, n, C), of none where all are taken."""
        g, h = np.zeros(mask.shape), np.zeros(mask.shape)
        for c, (one, other) in enumerate(parts):
            np.multiply(one, mask[:, :, c], out=g[:, :, c])
            np.multiply(other, mask[:, :, c], out=h[:, :, c])
        return Signatures(g, h)


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
    physics = physics or Physics.of(model.network, model.surrogate, {})
    held: Held = {}

    def changed(key: Moving) -> tuple[Array, Array]:
        return seen.over(change(physics, seen, facts, key, held))

    keys = [_course(cell) for cell in cells]
    every = [key for key in dict.fromkeys(keys) if key is not None]
    found = {key: changed(key) for key in every[:1]}  # computes what is without, for all
    found |= zip(every[1:], POOL.map(changed, every[1:]), strict=True)
    parts = [
        _reading(cell, seen, _fault(cell, seen, facts, noise)) if key is None else found[key]
        for cell, key in zip(cells, keys, strict=True)
    ]
    return Signatures.of(parts, masks(cells, seen, facts))


def exchanged(
    seen: Scores,
    cell: Cell,
    facts: Mapping[str, Facts],
    noise: Mapping[str, float],
    physics: Physics,
) -> Change:
    """g and h (B, n) of a cell, were all blades and readings concerned, as a function of which of a
    blade's rows each row is taken for, (B, n).

    A sensor's fault is that of the other row; physics changes a row by what it changes the other.
    """
    if (key := _course(cell)) is None:
        share = _fault(cell, seen, facts, noise)
        return lambda order: _reading(cell, seen, np.take_along_axis(share, order, axis=1))
    values = change(physics, seen, facts, key, {})
    return lambda order: seen.over(np.take_along_axis(values, order[:, None, :], axis=2))


def _course(cell: Cell) -> Moving | None:
    """How a cell moves an input; None of a sensor's."""
    family = cell.family
    if family.target == "reading":
        return None
    return Moving(family.of, family.how, directed(cell), cell.course, family.clock != "blade")


def _fault(
    cell: Cell, seen: Scores, facts: Mapping[str, Facts], noise: Mapping[str, float]
) -> Array:
    """Size of a sensor's cell at each row, (B, n)."""
    size = cell.family.size if cell.family.size is not None else NOISES * noise[cell.family.of]
    size *= cell.family.sign or 1
    hours = seen.hours
    if cell.family.clock != "blade":
        hours = hours + np.array([[facts[b].offset_h] for b in seen.blades])
    return np.asarray(size * np.where(seen.real, cell.course.at(hours), 0.0))


def _reading(cell: Cell, seen: Scores, fault: Array) -> tuple[Array, Array]:
    """g and h (B, n) of a sensor's cell that is so large at each row."""
    return seen.in_proportion(fault) if cell.family.how == "times" else (fault, 0.0 * fault)


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
