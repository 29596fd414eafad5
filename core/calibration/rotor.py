"""The rotor weighs what its blades say.

    log p(s, D) = log p(s) + Σ_b log m_b(s)

The shared nodes are placed in two steps. A descent on rough messages finds where the posterior is
(`core.smc.placement`). What the rough messages miss is smooth: a quadratic through the difference
at a few places mends them, and a second descent ends where the exact messages at the nodes give
even weights. Where that fails (few readings of each blade, small noise: there rough messages are
worst, and no quadratic mends them), a descent looks at the exact messages alone, and at last the
nodes start again where the first descent ended. Everything is a function of the set of readings;
the columns are kept, so that a new reading costs one blade's columns as long as the nodes stay.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import BladeMessage, columns
from core.calibration.target import SharedSpace
from core.errors import CalibrationError
from core.response import monomials
from core.smc.particles import ess, normalised, tempering_exponent
from core.smc.placement import Proposal, descend, improved, sobol

Array = NDArray[np.float64]


@dataclass
class Columns:
    """Messages already computed, by what they rest on. Bounded, oldest out."""

    kept: dict[tuple[str, str, int, bytes], Array] = field(default_factory=dict)
    limit: int = 20_000
    computed: int = 0

    def of(self, message: BladeMessage, key: bytes, unit: Array, how: str) -> Array:
        return self.all({"": message}, key, unit, how)[""]

    def all(
        self, messages: Mapping[str, BladeMessage], key: bytes, unit: Array, how: str
    ) -> dict[str, Array]:
        """The column of each blade; those that are missing are computed side by side."""
        # a proposal's scouts are fewer than its nodes: their number is part of the name
        places = {b: (m.name, how, len(unit), key) for b, m in messages.items()}
        missing = {b: messages[b] for b, place in places.items() if place not in self.kept}
        if len(self.kept) + len(missing) > self.limit:
            for old in list(self.kept)[: self.limit // 2]:
                if old not in places.values():
                    del self.kept[old]
        found = columns(list(missing.values()), unit, rough=how == "rough")
        for (blade, message), column in zip(missing.items(), found, strict=True):
            self.computed += 1
            if np.isnan(column).any():
                raise CalibrationError(
                    f"a blade's message is not a number at {int(np.isnan(column).sum())} of "
                    f"{len(column)} nodes; its readings: {message.rows.y.tolist()[:12]}"
                )
            self.kept[places[blade]] = column
        return {b: self.kept[place] for b, place in places.items()}


@dataclass(frozen=True, slots=True)
class Weighed:
    """Shared nodes on the unit box with their weights.

    unit (K, d), log_q (K,), columns {blade: (K,)}, log_prior (K,).
    """

    unit: Array
    log_q: Array
    log_prior: Array
    columns: Mapping[str, Array]
    proposal: Proposal

    @property
    def key(self) -> bytes:
        return self.proposal.key

    @property
    def log_p(self) -> Array:
        total = self.log_prior.copy()
        for blade in sorted(self.columns):
            total = total + self.columns[blade]
        return total

    @property
    def log_w(self) -> Array:
        return self.log_p - self.log_q

    @property
    def ess_ratio(self) -> float:
        return ess(self.log_w) / len(self.log_w)


MISLED = 1.0  # nat that the quadratic which mends rough messages may leave


def node_count(dim: int) -> int:
    """Shared nodes for `dim` shared parameters."""
    return 64 if dim <= 4 else 128


def start_of(space: SharedSpace, messages: Mapping[str, BladeMessage]) -> Proposal:
    """Where the descent begins: the whole box, but a scan's remainder names noise and offset."""
    mean, spread = np.full(space.dim, 0.5), np.full(space.dim, 1.0)
    scans = [d for b in sorted(messages) for d in messages[b].rows.dense if d.dof > 50]
    for j, name in enumerate(space.names):
        low, high = space.priors[j].box
        if dense := [d for d in scans if d.sigma == name]:
            dof = sum(d.dof for d in dense)
            guess = 0.5 * np.log(max(sum(d.rss for d in dense), 1e-300) / dof)
            sd = 1.0 / np.sqrt(2 * dof)
        elif dense := [d for d in scans if name in d.offset]:
            # c ~ N(c_0, noise² A^-1) by the remainders alone
            noise2 = sum(d.rss for d in dense) / sum(d.dof for d in dense)
            bend, k = sum(d.bend for d in dense), dense[0].offset.index(name)
            centres = np.sum([d.bend @ d.centre for d in dense], axis=0)
            guess = np.linalg.lstsq(bend, centres, rcond=1e-9)[0][k]
            sd = np.sqrt(noise2 * np.linalg.pinv(bend)[k, k])
        else:
            continue
        mean[j] = np.clip((guess - low) / (high - low), 0.0, 1.0)
        spread[j] = min(1.0, 6.0 * sd / (high - low))
    return Proposal(mean, np.diag(spread))


def quadratic(unit: Array, values: Array, log_w: Array) -> tuple[Callable[[Array], Array], float]:
    """The quadratic through values at nodes (n, d) by least squares, and the rms it leaves.

    Nodes count by their weights `log_w`, tempered until half of them do.
    """
    known = np.isfinite(values) & np.isfinite(log_w)
    unit, values, log_w = unit[known], values[known], log_w[known]
    middle, spread = unit.mean(axis=0), unit.std(axis=0) + 1e-12

    def basis(at: Array) -> Array:
        return monomials((at - middle) / spread, 2)

    root = np.sqrt(normalised(tempering_exponent(log_w, 0.5 * len(unit)) * log_w))
    coefficients = np.linalg.lstsq(basis(unit) * root[:, None], values * root, rcond=1e-8)[0]
    left = (basis(unit) @ coefficients - values) * root
    return lambda at: basis(at) @ coefficients, float(np.sqrt(np.sum(left**2)))


def weigh(
    space: SharedSpace,
    messages: Mapping[str, BladeMessage],
    known: Columns,
    seed: int,
    *,
    rounds: int = 12,
    enough: float = 0.5,
) -> Weighed:
    """Place and weight the shared nodes for these messages."""
    d = space.dim
    blades = sorted(messages)

    def total(unit: Array, key: bytes, how: str) -> Array:
        out = space.log_prior(unit)
        found = known.all(messages, key, unit, how)
        for blade in blades:
            out = out + found[blade]
        return out

    scouts = 32 if d <= 2 else 64
    proposal = descend(
        lambda unit, key: total(unit, key, "rough"), start_of(space, messages), scouts, seed
    )
    assert proposal.chol is not None
    rough_end = Proposal(proposal.mean, proposal.chol * 1.5)
    unit, log_q = rough_end.nodes(sobol(32, d, seed + 2))
    exact, rough = (total(unit, rough_end.key, how) for how in ("exact", "rough"))
    missing, left = quadratic(unit, exact - rough, exact - log_q)
    wide = descend(
        lambda unit, key: total(unit, key, "rough") + missing(unit), rough_end, scouts, seed
    )
    n = node_count(d) * space.tails
    base = sobol(n, d, seed + 1)

    def settled(start: Proposal, turns: int) -> tuple[float, Proposal]:
        """The best share of effective nodes on the way from `start`, and its proposal."""
        best = (-1.0, start)
        for _ in range(turns):
            unit, log_q = start.nodes(base)
            log_p = total(unit, start.key, "exact")
            best = max(best, (ess(log_p - log_q) / n, start), key=lambda found: found[0])
            if best[0] >= enough:
                break
            start = improved(unit, log_p, log_q, 0.3)
        return best

    best = settled(wide, 3) if left < MISLED else (-1.0, wide)
    if best[0] < enough:  # the rough messages misled: look at nothing but the exact ones
        exactly = descend(
            lambda unit, key: total(unit, key, "exact"),
            start_of(space, messages),
            16 if d <= 2 else 32,
            seed,
        )
        best = max(best, settled(exactly, rounds), key=lambda found: found[0])
    if best[0] < enough:  # or start where the rough messages alone led
        best = max(best, settled(rough_end, rounds), key=lambda found: found[0])
    wide = best[1]
    unit, log_q = wide.nodes(base)
    return Weighed(
        unit,
        log_q,
        space.log_prior(unit),
        known.all({b: messages[b] for b in blades}, wide.key, unit, "exact"),
        wide,
    )
