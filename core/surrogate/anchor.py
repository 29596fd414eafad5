"""A coarse surrogate of wide runs, anchored at a fine one where nothing is out of the ordinary.

Runs that leave room for effects (coatings worn through, foul gas, inputs that sleep otherwise) fill
a box of many more dimensions, and where a sound blade lives there are few of them. Another
surrogate of the same physics may know just that place well. With D the wide one under the inputs
as they run, 0 the wide one under those of the start and with what sleeps asleep, and f the fine one
there, the answers are put together as

    E = E_D E_f / E_0,    A = A_D + A_f − A_0            y = E A (elongation, deformation)
    y = y_D y_f / y_0                                    CEEQ, damage

so that without an effect the answer is the fine one's, and an effect changes it as the wide one
says. What the wide one gets wrong cancels as far as its errors are the same at both places: with
the posterior covariance c of its Gaussian process between the mean inputs m of the history and
those of the start, its variance counts by

    (v(m) + v(0) − 2 c(m, 0)) / v(m)

beside the fine one's own: where the two have nothing to do with each other, by more than one. After
the fine one's horizon what it corrects is held. (Additive and multiplicative bridges between models
of two fidelities: Han, Görtz & Zimmermann, Aerospace Science and Technology 25, 2013.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from core.errors import InputError
from core.surrogate.followed import Followed
from core.surrogate.history import Answer, constant
from core.surrogate.model import Surrogate
from core.surrogate.targets import DEFORMATION

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Anchor:
    """The fine surrogate, and the values of the wide one's other inputs where it is at home.

    Raises InputError (from `fits`) where the two are no surrogates of the same mesh and inputs.
    """

    fine: Surrogate
    asleep: Mapping[str, float]
    _mixed: dict[str, Array] = field(default_factory=dict, repr=False, compare=False)

    @cached_property
    def digest(self) -> str:
        return f"{self.fine.digest} {sorted(self.asleep.items())}"

    def fits(self, wide: Surrogate, ranges: Mapping[str, tuple[float, float]]) -> None:
        """Refuse a wide surrogate of another mesh, or of inputs that begin outside the fine one."""
        if self.fine.points.shape != wide.points.shape or not np.allclose(
            self.fine.points, wide.points
        ):
            raise InputError(
                "anchor",
                (self.fine.node_count, wide.node_count),
                "is of another mesh",
                "train both surrogates on one mesh",
            )
        known, own = {i.name: i for i in self.fine.inputs}, {i.name for i in wide.inputs}
        if known.keys() | self.asleep.keys() != own or known.keys() & self.asleep.keys():
            raise InputError(
                "anchor",
                sorted(known.keys() | self.asleep.keys()),
                f"does not cover the inputs {sorted(own)}",
                "say for each input that the fine surrogate lacks where it sleeps",
            )
        for name, one in known.items():
            low, high = ranges.get(name, (one.low, one.high))
            slack = 1e-9 * (one.high - one.low)
            if low < one.low - slack or high > one.high + slack:
                raise InputError(
                    f"range of {name}",
                    (low, high),
                    f"leaves the fine surrogate's runs, {one.low:g} … {one.high:g}",
                    "narrow the prior, or use the wide surrogate without its anchor",
                )

    def mixed(self, wide: Surrogate, mixing: Array) -> Followed:
        """Of mixtures T (Q, B) of the wide one's modes: T M, its modes nearest to the fine one's.

        Phi_fine ~ Phi_wide M by least squares over all nodes.
        """
        if wide.digest not in self._mixed:
            modes, own = (
                one.parts[DEFORMATION].factors.space.astype(float) for one in (wide, self.fine)
            )
            self._mixed[wide.digest] = np.linalg.lstsq(modes, own, rcond=None)[0]
        return Followed.mixed(self.fine, mixing @ self._mixed[wide.digest])

    def corrected(
        self,
        wide: Surrogate,
        start: Array,
        middle: Array,
        times: Array,
        driven: Sequence[Answer],
        what: Sequence[tuple[Followed, Followed]],
        doubt: bool = True,
    ) -> list[Answer]:
        """Of each quantity mean and sd (n, T, R) and mean CEEQ (n, T), from those of the driven
        wide one.

        start   inputs of the wide one before anything runs, asleep what sleeps, (n, d)
        middle  their means from the start to each time, (n, T, d)
        what    the rows followed of each quantity: of the wide one, of the fine one
        doubt   False: the sd is not asked for, and is that of the driven one
        """
        held = np.minimum(times, self.fine.horizon_h)
        names = [i.name for i in wide.inputs]
        own = start[:, [names.index(i.name) for i in self.fine.inputs]]
        of_wide, of_fine = ([one[k] for one in what] for k in (0, 1))
        still = constant(wide, start, held, of_wide, doubt=False)
        fine = constant(self.fine, own, held, of_fine, doubt=doubt)
        share = self._share(wide, start, middle)[:, :, None] if doubt else np.ones((1, 1, 1))
        return [
            put_together(rows, moved, without, there, share)
            for rows, moved, without, there in zip(of_wide, driven, still, fine, strict=True)
        ]

    def _share(self, wide: Surrogate, start: Array, middle: Array) -> Array:
        """Root of the share of the wide one's variance that counts, (n, T)."""
        there = np.stack([wide.scaled(one) for one in np.moveaxis(middle, 1, 0)], axis=1)
        v0, v, c = wide.process.covariance(wide.scaled(start), there)
        return np.asarray(np.sqrt(np.maximum((v + v0[:, None] - 2.0 * c) / v, 0.0)))


def put_together(
    what: Followed, driven: Answer, still: Answer, fine: Answer, share: Array
) -> Answer:
    """y of one quantity by the module's equations: of the driven wide one, the wide one where
    nothing runs, the fine one there."""
    (y, sd, ceeq), (y0, _, e0), (yf, sdf, ef) = driven, still, fine
    if what.per_ceeq:
        grown = (ef / e0)[:, :, None]
        e, e0, ef = (one[:, :, None] for one in (ceeq, e0, ef))
        mean = e * grown * (y / e + yf / ef - y0 / e0)
        return mean, np.hypot(sd * grown * share, sdf * e * grown / ef), ceeq * grown[:, :, 0]
    grown = yf / y0
    mean = y * grown
    return mean, np.hypot(sd * grown * share, sdf * mean / yf), ceeq * ef / e0
