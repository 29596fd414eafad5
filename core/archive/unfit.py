"""Values that cannot be computed with: those that are no numbers, and those of no usable size.

Training and calibration square what they are given, and fields are kept in single precision, which
ends at 3e38 and 1e-38. Within 1e-30 … 1e30 nothing overflows, and no quantity in a unit of its own
size lies outside.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.archive.axis import Axis
from core.errors import InputError, RangeError

Array = NDArray[np.float64]
LEAST, LARGEST = 1e-30, 1e30
REMEDY = "give it in a unit of its own size"


def not_finite(what: str, raw: Array, bad: NDArray[np.intp], axis: Axis, k: int) -> InputError:
    """The first value that is no number: its hour, its node, and how many more there are."""
    first = [int(one) for one in bad[0]]
    hours = axis.time_h if axis.own is None else axis.own[k]
    place = f"at {hours[first[0]]:g} h"
    if len(first) > 1:
        nodes = sorted({int(one[1]) for one in bad})
        shown = ", ".join(map(str, nodes[:8])) + (" …" if len(nodes) > 8 else "")
        place += f", node {first[1]}"
        if len(nodes) > 1:
            place += f" (nodes {shown})"
    more = f"; {len(bad)} values of it are none" if len(bad) > 1 else ""
    value = float(raw[tuple(first)])
    remedy = "repeat the run, or leave it out (leave_out)"
    return InputError(what, value, f"is no number {place}{more}", remedy)


def too_large(what: str, values: Array, factor: float = 1.0) -> InputError | None:
    """The largest value, times a unit's factor, where it is beyond `LARGEST`; finite values alone.

    >>> print(too_large("run 3: drop", np.array([1.0, -1e200])))
    run 3: drop = -1e+200 is beyond 1e+30. To mend it: give it in a unit of its own size.
    """
    most = float(values.flat[np.argmax(np.abs(values))]) if values.size else 0.0
    if abs(most) <= LARGEST / abs(factor):
        return None
    return RangeError(what, most, f"is beyond {LARGEST:g}", REMEDY)


def too_small(what: str, size: float) -> InputError | None:
    """What is told of a size that is not 0 and below `LEAST`."""
    if not 0 < size < LEAST:
        return None
    return RangeError(what, size, f"is below {LEAST:g}", REMEDY)
