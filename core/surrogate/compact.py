"""Spatial modes in sixteen bits or fewer: an artefact of a fine mesh in less than half its size.

A mode phi_b is stored as integers times a step that is a power of two: products are exact in single
precision, and rounding again changes nothing. Where the field is Σ_b a_b(t) phi_b, with rms A_b of
a_b over training runs and instants, steps

    step_b = `SHARE` cut / (A_b sqrt(B / 12))

add an error of `SHARE` of the rms that the truncated bases leave anyway (``cut``), alike from all
modes: small ones need few bits. No step is finer than sixteen bits hold. The surrogate that is
measured and used is the rounded one. Small models keep their modes as they are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.surrogate.kernel import SharedGP
from core.surrogate.model import Surrogate
from core.surrogate.part import Part

Arrays = dict[str, NDArray[Any]]
LARGE = 8_000_000  # bytes of modes in single precision, from which they are rounded
SHARE = 0.05
MOST = 32767
SPACE, WHOLE, STEP = "/space", "/space16", "/step"


def compact(model: Surrogate) -> Surrogate:
    """With rounded modes, where they are large."""
    if sum(part.factors.space.nbytes for part in model.parts.values()) < LARGE:
        return model
    parts = {}
    for name, part in model.parts.items():
        space = part.factors.space
        step = np.maximum(_finest(space), _step(part, model.process))
        rounded = _expanded(np.rint(space / step).astype(np.int16), step)
        parts[name] = replace(part, factors=replace(part.factors, space=rounded))
    return replace(model, parts=parts)


def _step(part: Part, process: SharedGP) -> NDArray[np.float64]:
    """Steps (B,) of the module's text, rounded down to powers of two."""
    amplitude = _amplitude(part, process)
    cut = np.sqrt(np.mean(part.cut_time**2) * np.mean(part.cut_space.astype(float) ** 2))
    step = SHARE * cut / (np.maximum(amplitude, 1e-300) * np.sqrt(len(amplitude) / 12.0))
    return np.asarray(2.0 ** np.floor(np.log2(np.maximum(step, 1e-30))))


def _amplitude(part: Part, process: SharedGP) -> NDArray[np.float64]:
    """A_b (B,)."""
    (c,) = process.mean(process.z, [part.columns])
    forms = part.factors.modes(part.factors.time_h)
    along = forms[0] + np.tensordot(c, forms[1:], axes=1)
    return np.asarray(np.sqrt(np.mean(along**2, axis=(0, 1))))


def _finest(space: NDArray[np.float32]) -> NDArray[np.float64]:
    """The least powers of two (B,) of which sixteen bits hold every value's multiple."""
    largest = np.abs(space).max(axis=0).astype(float)
    return np.asarray(2.0 ** np.ceil(np.log2(np.where(largest > 0, largest, 1.0) / MOST)))


def packed(arrays: Arrays) -> Arrays:
    """Modes as integers and steps, where they are large and rounded; all else as it is."""
    if sum(array.nbytes for name, array in arrays.items() if name.endswith(SPACE)) < LARGE:
        return arrays
    out: Arrays = {}
    for name, array in arrays.items():
        if name.endswith(SPACE):
            step = _finest(array)
            whole = np.rint(array / step).astype(np.int16)
            if np.array_equal(_expanded(whole, step), array):
                shift = _zeros(whole)
                stem = name.removesuffix(SPACE)
                out[stem + WHOLE] = np.ascontiguousarray((whole >> shift).T)
                out[stem + STEP] = step * 2.0**shift
                continue
        out[name] = array
    return out


def unpacked(arrays: Arrays) -> Arrays:
    """The inverse of `packed`."""
    out = {n: a for n, a in arrays.items() if not n.endswith((WHOLE, STEP))}
    for name, whole in arrays.items():
        if name.endswith(WHOLE):
            stem = name.removesuffix(WHOLE)
            out[stem + SPACE] = _expanded(whole.T, arrays[stem + STEP])
    return out


def _zeros(whole: NDArray[np.int16]) -> NDArray[np.int16]:
    """Binary zeros at the end of every integer of a column, (B,).

    >>> _zeros(np.array([[8, 3, 0], [-12, 4, 0]], dtype=np.int16)).tolist()
    [2, 0, 0]
    """
    bits = np.bitwise_or.reduce(np.abs(whole.astype(np.int32)), axis=0)
    low = np.where(bits > 0, bits & -bits, 1)
    return np.asarray(np.log2(low), dtype=np.int16)


def _expanded(whole: NDArray[np.int16], step: NDArray[np.float64]) -> NDArray[np.float32]:
    """Exact: integers of sixteen bits times powers of two."""
    return np.ascontiguousarray((whole * step).astype(np.float32))
