"""A blade's message with many local parameters: tempered particles in the quadrature's place.

    m_b(s) = ∫ p(l) L(l, s) dl = E_q [ L(l, s) / q(l | s) ],       l in the box, D parameters

Nested quadrature costs a factor of ten for each parameter. Here the parameters are split, blade by
blade: *thin* ones t, along which the readings fix the rest to a bell narrower than the box, and
*broad* ones f. Given f, the bell in t is found and drawn from at each node of the shared
parameters (`collapsed_kernels`), so that what is left, L / q(t), is a smooth function of f alone:
the readings' tubes and sheets are collapsed, however thin. The broad parameters come from a
proposal that tempered particles find for all nodes together (`core.smc.tempered`). Where it fits a
node badly, such nodes get a split and a proposal of their own.

A pilot sample tells which nodes a proposal carries, and how many points are wanted; the message is
then averaged over points of its own, so that its estimate is unbiased whatever the pilot led to.
Points are quasi-random and common to the nodes, so most of what error is left cancels between
them. They come in `REPLICATES` independently scrambled sets, whose scatter is the error that the
state reports (`collapsed_fit`). Everything is seeded by the blade's rows and the nodes. The broad
parameters may have several modes; the thin ones are assumed to have one at each f, a second narrow
one would be missed.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from functools import cached_property
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from core.calibration import collapsed_kernels as kernels
from core.calibration.at_nodes import AtNodes
from core.calibration.collapsed_fit import REPLICATES, Fit, Plan, average
from core.calibration.collapsed_split import Split, pivots, split_of
from core.calibration.layout import monomials_of
from core.calibration.message import PARTS, BladeMessage, natural, prior_draws
from core.calibration.space import locals_of
from core.errors import CalibrationError
from core.rng import seed_of
from core.smc.placement import sobol
from core.smc.tempered import Kernels, effective, tempered

Array = NDArray[np.float64]
Index = NDArray[np.int64]
PILOT = 512  # points of the pilot sample, which is all that a rough message takes
LEAST, MOST = 1024, 2048  # points of a message
WANTED = 0.01  # error of the differences between nodes [nat]
GAIN = 0.75  # the error falls at least as n^−GAIN
SCOUTS = 256  # points of each round of tempering
MEMBERS = 8  # nodes that the tempering looks at
OFF_BELL = 0.4  # nats by which its profile may miss a bell's at `REACH` standard deviations
REACH = 2.5
CARRIED = 0.05  # share of effective points below which a node gets a proposal of its own
TURNS, ROUGH_TURNS = 6, 2  # proposals at most
MOST_ERRORS = 20_000  # of columns, by message and nodes, that a process remembers
_ERRORS: OrderedDict[tuple[str, bytes], tuple[float, float]] = OrderedDict()


class CollapsedMessage(BladeMessage):
    """The message of one blade's readings where it has many local parameters."""

    smooth = False  # its points are common to the nodes of one call

    @cached_property
    def _fits(self) -> AtNodes[Fit]:
        return AtNodes()

    def column(self, unit: Array, rough: bool = False, parts: int = PARTS) -> Array:
        """log m_b at nodes `unit` (n, d) of the unit box, (n,); one thread does a blade."""
        return self.fit(unit, rough).column

    def error(self, unit: Array) -> tuple[float, float]:
        """Errors of the column at these nodes [nat], from its replicates; see `Fit.error`."""
        told = _ERRORS.get((self.name, _digest(unit)))
        return self.fit(unit).error if told is None else told

    def fit(self, unit: Array, rough: bool = False) -> Fit:
        """The column with its replicates and its plans."""
        return self._fits.of((_digest(unit), rough), lambda: self._fitted(unit, rough))

    def draws(
        self,
        unit: Array,
        per_node: int,
        rng: np.random.Generator,
        column: Array,
        parts: int = PARTS,
    ) -> tuple[Array, Array]:
        """Weighted local parameters at each node; see `BladeMessage.draws`."""
        p = self.packed
        out, log_w = np.empty((len(unit), per_node, p.dim)), np.empty((len(unit), per_node))
        base = sobol(2 ** math.ceil(math.log2(per_node)), p.dim, int(rng.integers(2**63)))
        shift = rng.random((len(unit), 1, p.dim))
        for plan in self.fit(unit).plans:
            own = np.clip((base[:per_node] + shift[plan.members]) % 1.0, 1e-9, 1 - 1e-9)
            broad = len(plan.split.broad)
            f, log_q = plan.proposal.points(own[:, :, :broad].reshape(len(own) * per_node, broad))
            f = f.reshape(len(plan.members), per_node, broad)
            u = np.ascontiguousarray(own[:, :, broad:])
            t, ratio = self._weighed(unit[plan.members], plan.split, f, u)
            both = np.concatenate([f, t], axis=2)
            out[plan.members] = both[:, :, np.argsort((*plan.split.broad, *plan.split.thin))]
            log_w[plan.members] = ratio - log_q.reshape(ratio.shape)
        log_w -= math.log(per_node) + column[:, None]
        if not np.all(log_w < np.inf):  # neither NaN nor an unbounded weight
            raise CalibrationError(
                f"{int(np.sum(~(log_w < np.inf)))} draws of a blade have no weight; its readings: "
                f"{self.rows.y.tolist()[:12]}"
            )
        touched = natural(self.model, p.local, out)
        if len(p.local) == len(locals_of(self.model)):
            return touched, log_w
        values, _ = prior_draws(self.model, self.space, unit, per_node, rng)
        values[:, :, p.local] = touched
        return values, log_w

    @property
    def _exponents(self) -> Index:
        p = self.packed
        return np.ascontiguousarray(p.exponents[:, p.exponents.shape[1] - p.dim :])

    def _weighed(self, unit: Array, split: Split, f: Array, u: Array) -> tuple[Array, Array]:
        """Thin parameters t (K, n, T) drawn at f (K, n, F), and log L p / q(t), (K, n)."""
        t, log_w = np.empty(u.shape), np.empty(u.shape[:2])
        given, rest = self._given(unit)
        kernels.weigh(*given, *split.options, f, u, t, log_w)
        return t, log_w + (rest + self._constant)[:, None]

    def _given(self, unit: Array) -> tuple[tuple[Array, ...], Array]:
        """What the compiled functions need of the nodes, and what no local parameter moves."""
        p, x = self.packed, self.space.to_x(unit)
        factors = monomials_of(self.model, self.rows, self.space, x, self.fixed)
        y, s2, rest = self.readings(unit)
        return (p.a, p.b, p.v, factors, y, s2, p.ka2, p.kb2), rest

    def _log_weights(self, unit: Array, split: Split, proposal: Kernels, base: Array) -> Array:
        """log of L p / q at every node for points of the unit cube (n, D), (K, n)."""
        broad, k = len(split.broad), len(unit)
        f, log_q = proposal.points(base[:, :broad])
        u = base[:, broad:]
        _, ratio = self._weighed(
            unit, split, np.repeat(f[None], k, axis=0), np.repeat(u[None], k, axis=0)
        )
        return ratio - log_q

    def _split(self, unit: Array) -> Split:
        """The split at the node nearest to the middle of these."""
        d = self.packed.dim
        middle = np.argmin(np.sum((unit - unit.mean(axis=0)) ** 2, axis=1))
        exponents = self._exponents
        every = split_of(exponents.tobytes(), d, tuple(range(d)))
        mode, curvature = np.zeros((1, d)), np.empty((1, d, d))
        given, _ = self._given(unit[middle : middle + 1])
        kernels.curvatures(*given, *every.options, mode, curvature)
        thin, sharp = pivots(curvature[0])
        steps = REACH / 2 * np.array([0.0, -1.0, -2.0, 1.0, 2.0])
        while len(thin) > 1:  # the widest is thin only if its profile is a bell
            split, at = split_of(exponents.tobytes(), d, tuple(thin[:-1])), thin[-1]
            f = np.repeat(mode[:, None, :], len(steps), axis=1)
            f[0, :, at] += steps / math.sqrt(sharp[-1])
            inside = np.abs(f[0, :, at]) <= 1.0
            f = np.ascontiguousarray(np.clip(f, -1.0, 1.0)[:, :, list(split.broad)])
            u = np.full((1, len(steps), len(split.thin)), 0.5)
            _, mass = self._weighed(unit[middle : middle + 1], split, f, u)
            drop = mass[0, 0] - mass[0]
            near, far = drop[[1, 3]], drop[[2, 4]]
            off = np.abs(far - 2 * near - REACH**2 / 4)  # a parabola, with a slope at a bound
            if np.all((off < OFF_BELL) | ~inside[[2, 4]] | (near > 8.0)):
                break
            thin, sharp = thin[:-1], sharp[:-1]
        return split_of(exponents.tobytes(), d, tuple(thin))

    def _planned(self, unit: Array, seed: int, turns: int) -> tuple[list[Plan], Array, Array]:
        """Plans for all nodes; the pilot's column (K,) and scatter (K, REPLICATES)."""
        d = self.packed.dim
        base = self._base(PILOT, seed + 100)
        column, scatter = np.empty(len(unit)), np.empty((len(unit), REPLICATES))
        todo, plans = np.arange(len(unit)), list[Plan]()
        for turn in range(turns):
            split = self._split(unit[todo])
            broad = len(split.broad)
            seen = unit[todo[:: -(-len(todo) // MEMBERS)]]

            def target(
                f: Array, seen: Array = seen, split: Split = split, turn: int = turn
            ) -> Array:
                u = sobol(len(f), d - len(split.broad), seed + 50 + turn)
                k = len(seen)
                return self._weighed(
                    seen, split, np.repeat(f[None], k, axis=0), np.repeat(u[None], k, axis=0)
                )[1]

            proposal = Kernels.uniform(broad)
            if broad:
                proposal, _ = tempered(target, broad, SCOUTS, seed + 10 * turn)
            log_w = self._log_weights(unit[todo], split, proposal, base)
            carried = effective(log_w) >= CARRIED * PILOT
            if turn == turns - 1:
                carried[:] = True
            done = todo[carried]
            if len(done):
                column[done], scatter[done] = average(log_w[carried])
                plans.append(Plan(done, split, proposal))
            todo = todo[~carried]
            if not len(todo):
                break
        return plans, column, scatter

    def _base(self, points: int, seed: int) -> Array:
        """Points of the unit cube in scrambled sets, one after the other, (points, D)."""
        n = points // REPLICATES
        sets = [sobol(n, self.packed.dim, seed + r) for r in range(REPLICATES)]
        return np.concatenate(sets)

    def _fitted(self, unit: Array, rough: bool) -> Fit:
        seed = seed_of(0, self.name, unit.tobytes().hex()) % 2**62
        plans, column, scatter = self._planned(unit, seed, ROUGH_TURNS if rough else TURNS)
        pilot = Fit(column, scatter, tuple(plans))
        if rough:
            return pilot
        times = (pilot.error[1] / WANTED) ** (1 / GAIN)
        points = min(max(PILOT * 2 ** math.ceil(math.log2(max(times, 1.0))), LEAST), MOST)
        base = self._base(points, seed + 200)
        column, scatter = np.empty(column.shape), np.empty(scatter.shape)
        for plan in plans:
            log_w = self._log_weights(unit[plan.members], plan.split, plan.proposal, base)
            column[plan.members], scatter[plan.members] = average(log_w)
        made = Fit(column, scatter, pilot.plans)
        _ERRORS[self.name, _digest(unit)] = made.error
        while len(_ERRORS) > MOST_ERRORS:
            _ERRORS.popitem(last=False)
        return made


def _digest(unit: Array) -> bytes:
    """What nodes are known by: sixteen bytes in place of some thousands."""
    return blake2b(np.ascontiguousarray(unit).tobytes(), digest_size=16).digest()
