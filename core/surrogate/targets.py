"""What the surrogate learns of each quantity.

A smooth, nearly linear function of the inputs is learnt from few runs; the raw results are not
(ten times worse, measured). Each quantity y is therefore written through a target g:

    ``log rate``   y = t exp(g)        grows from zero: CEEQ, damage
    ``log``        y = exp(g)          positive throughout
    ``raw``        y = g               anything else
    ``per ceeq``   y = E(t) g          permanent deformation and elongation

with E(t) the mean CEEQ over the nodes, itself a ``log rate`` curve. The displacement splits into
the field at 0+ (no time, ``raw``) and the permanent deformation u(t) - u(0+). Values below
1e-8 of the largest one count as that floor: colder parts of a blade do not creep, and the
logarithm of nothing would rule the basis.

Runs without a field ``ceeq`` are of no creeping body: their elongation is a quantity like any
other (as one is that is not 0 at first, with elastic stretch in it), and their deformation,
u(t) - u(0), ``raw``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from core.archive import Archive, Quantity
from core.errors import ModelError

Array = NDArray[np.float64]
Form = Literal["log rate", "log", "raw", "per ceeq"]
FLOOR = 1e-8
LEAST = 1e-6  # of the largest value: so much beside 0 is 0, as extrapolation to nodes leaves it
MEAN_CEEQ, ELASTIC, DEFORMATION = "mean_ceeq", "elastic", "deformation"


@dataclass(frozen=True, slots=True)
class Target:
    """g of one part: values (n, T', R) at `time_h` (T',), and the form that leads back to y."""

    name: str
    form: Form
    time_h: Array
    values: Array


def mean_ceeq(archive: Archive, indices: Sequence[int]) -> Array:
    """E(t) of each run, the mean CEEQ over the nodes, (n, T)."""
    rows = [np.asarray(archive.stack("ceeq", [k])[0], dtype=float).mean(axis=1) for k in indices]
    return np.array(rows)


def forms_of(values: Array, quantity: Quantity) -> tuple[Form, ...]:
    """The forms a quantity's values (n, T, R) allow, best guess first."""
    if quantity.kind == "vector field":
        return ("raw",)
    grows = from_nothing(values) and np.all(values >= -LEAST * np.abs(values).max())
    if grows and np.all(values[:, 1:].max(-1) > 0):
        return ("log rate",) if quantity.kind == "field" else ("log rate", "raw")
    if np.all(values > 0):
        return ("log", "raw")
    return ("raw",)


def targets_of(archive: Archive, indices: Sequence[int]) -> Iterator[tuple[Target, ...]]:
    """Targets of every part in turn; where a quantity allows several forms, all of them."""
    declared = archive.declaration
    time = np.array(declared.time_h)
    kinds = {quantity.name: quantity.kind for quantity in declared.quantities}
    creeps = kinds.get("ceeq") == "field" and bool(kinds.keys() & {"elongation", "displacement"})
    if creeps:
        ceeq = mean_ceeq(archive, indices)
        if np.any(ceeq[:, 1:] <= 0):
            run = int(np.argwhere(ceeq[:, 1:] <= 0)[0, 0])
            raise ModelError(f"run {indices[run]} does not creep: its mean CEEQ is not positive")
        yield (_target(MEAN_CEEQ, "log rate", time, ceeq[:, :, None]),)
    for quantity in declared.quantities:
        stacked = archive.stack(quantity.name, indices)
        values = np.asarray(stacked, dtype=float).reshape(len(indices), len(time), -1)
        del stacked
        if quantity.name == "displacement" and not creeps:
            yield (_target("displacement", "raw", time, values),)
            yield (_target(DEFORMATION, "raw", time, values - values[:, :1]),)
        elif quantity.name == "displacement":
            yield (Target(ELASTIC, "raw", time[:1], values[:, :1].copy()),)
            values -= values[:, :1]
            yield (_target(DEFORMATION, "per ceeq", time, values, ceeq),)
        elif quantity.name == "elongation" and creeps and from_nothing(values):
            yield (_target("elongation", "per ceeq", time, values, ceeq),)
        else:
            forms = forms_of(values, quantity)
            yield tuple(_target(quantity.name, form, time, values) for form in forms)


def from_nothing(values: Array) -> bool:
    """Whether values (n, T, R) are 0 at the first instant, so that they may go with creep."""
    return bool(np.abs(values[:, 0]).max() <= LEAST * np.abs(values).max())


def _target(name: str, form: Form, time: Array, values: Array, ceeq: Array | None = None) -> Target:
    if form == "raw":
        return Target(name, form, time, values)
    if form == "log":
        return Target(name, form, time, np.log(values))
    if form == "per ceeq":
        assert ceeq is not None
        return Target(name, form, time[1:], values[:, 1:] / ceeq[:, 1:, None])
    rate = values[:, 1:] / time[1:, None]
    floor = FLOOR * float(values.max()) / time[-1]
    return Target(name, form, time[1:], np.log(np.maximum(rate, floor)))


def invert(form: Form, g: Array, time_h: Array, ceeq: Array | None = None) -> Array:
    """y (n, T, R) of g (n, T, R); `ceeq` is E (n, T) where the form is ``per ceeq``.

    >>> g = np.log(np.full((1, 1, 1), 2e-6))
    >>> float(invert("log rate", g, np.array([500.0]))[0, 0, 0].round(12))
    0.001
    """
    if form == "raw":
        return g
    if form == "log":
        return np.exp(g)
    if form == "log rate":
        return np.asarray(np.exp(g) * time_h[:, None])
    assert ceeq is not None
    return g * ceeq[:, :, None]
