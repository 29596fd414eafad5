"""One quantity at one node and instant as one polynomial, for very many inputs.

A quantity that is positive over the whole box has

    y(x) = exp( sum_m c_m z^{e_m} ),    z = 2 (x - low) / (high - low) - 1,

any other the sum itself, of total degree p, fitted as by `core.surrogate.compile`. The sum is a
tree: the children of the monomial z^e are z^e z_w for w from the last input in e on, so that each
of the M terms costs one multiplication with addition,

    v(e) = c_e + sum_w z_w v(e w).

It is written out as one expression for d inputs and degree p, over a block of points that stays in
the fastest cache, so that the compiler runs it on eight points at once without a branch. It is
compiled once per process, d and p (2 to 4 s for 210 terms); `core.response` needs no compiling and
has the standard deviation as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from core.errors import InputError
from core.monomials import multi_indices
from core.surrogate.compile import fitting
from core.surrogate.model import DEGREE, Surrogate

Array = NDArray[np.float64]
BLOCK, STRIDE = 64, 4096
MOST = 500
"""Terms at most: the compiler's time grows faster than they do."""


def expression(d: int, degree: int) -> str:
    """The tree as one expression of z0, z1, … and the coefficients c.

    >>> expression(2, 1)
    '((c[0] + z0 * c[2]) + z1 * c[1])'
    """
    place = {tuple(e): m for m, e in enumerate(multi_indices(d, degree).tolist())}

    def grown(e: tuple[int, ...], first: int) -> str:
        text = f"c[{place[e]}]"
        if sum(e) < degree:
            for w in range(first, d):
                child = (*e[:w], e[w] + 1, *e[w + 1 :])
                text = f"({text} + z{w} * {grown(child, w)})"
        return text

    return grown((0,) * d, 0)


@lru_cache(maxsize=8)
def kernel(d: int, degree: int) -> Any:
    """f(x, low, scale, c, out): the sum at x (n, d) into out (n,)."""
    if len(multi_indices(d, degree)) > MOST:
        raise InputError(
            "degree",
            degree,
            f"has {len(multi_indices(d, degree))} terms of {d} inputs, more than {MOST}",
            "take a lower one, or `Surrogate.response`",
        )
    scaled = [f"z[{j}, i] = (x[first + i, {j}] - low[{j}]) * scale[{j}] - 1.0" for j in range(d)]
    named = [f"z{j} = z[{j}, i]" for j in range(d)]
    lines = [
        "def kernel(x, low, scale, c, out):",
        f"    z, y = np.zeros(({d}, {BLOCK})), np.zeros({BLOCK})",
        f"    for first in range(0, len(x), {BLOCK}):",
        f"        width = min({BLOCK}, len(x) - first)",
        "        for i in range(width):",
        *(f"            {line}" for line in scaled),
        f"        for i in range({BLOCK}):",
        *(f"            {line}" for line in named),
        f"            y[i] = {expression(d, degree)}",
        "        for i in range(width):",
        "            out[first + i] = y[i]",
    ]
    room: dict[str, Any] = {"np": np}
    exec("\n".join(lines), room)
    fast = {"contract", "reassoc", "nsz", "arcp"}
    return njit(nogil=True, error_model="numpy", fastmath=fast)(room["kernel"])


@dataclass(frozen=True, slots=True)
class Row:
    """low, high: the box, (d,); c: coefficients (M,), of log y where `positive`."""

    low: Array
    high: Array
    degree: int
    c: Array
    positive: bool

    @classmethod
    def of(
        cls,
        model: Surrogate,
        quantity: str,
        time_h: float,
        node: int | None = None,
        degree: int = DEGREE,
    ) -> Row:
        """A scalar, or a field at a node, compiled."""
        kind = model.quantities[quantity].kind if quantity in model.quantities else None
        if kind == "vector field" or (kind == "field" and node is None):
            raise InputError(
                "quantity", quantity, f"is a {kind}", "ask for a scalar, or for a field at a node"
            )
        points, factor = fitting(len(model.inputs), degree)
        x = model.low + 0.5 * (points + 1.0) * (model.high - model.low)
        nodes = None if node is None else [node]
        y = model.predict(x, quantity, [time_h], nodes)[0].reshape(-1)
        positive = bool(np.all(y > 0))
        c = factor @ (np.log(y) if positive else y)
        return cls(model.low, model.high, degree, np.asarray(c), positive)

    def __call__(self, x: Array) -> Array:
        """Values (n,) at inputs x (n, d); x is not held against the box."""
        run, scale = kernel(x.shape[1], self.degree), 2.0 / (self.high - self.low)
        out = np.empty(len(x))
        for start in range(0, len(x), STRIDE):
            part = out[start : start + STRIDE]
            run(x[start : start + STRIDE], self.low, scale, self.c, part)
            if self.positive:
                np.exp(part, out=part)
        return out
