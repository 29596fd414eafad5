"""What leads to a posterior: where a descent begins, which blades it looks at, what mends a look.

Used by `core.calibration.rotor`, whose search these serve.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from core.calibration.message import BladeMessage
from core.calibration.space import SharedSpace
from core.monomials import monomials
from core.rng import seed_of
from core.smc.particles import normalised, tempering_exponent
from core.smc.proposal import Proposal

Array = NDArray[np.float64]
PANEL = 12  # blades of a kind whose exact messages place the nodes


def start_of(space: SharedSpace, messages: Mapping[str, BladeMessage]) -> Proposal:
    """Where the descent begins: the whole box, but a scan's remainder names noise and offset."""
    mean, spread = np.full(space.dim, 0.5), np.full(space.dim, 1.0)
    scans = [d for b in sorted(messages) for d in messages[b].rows.dense if d.dof > 50]
    for j, name in enumerate(space.names):
        low, high = space.priors[j].box
        if dense := [d for d in scans if d.sigma == name]:
            dof = sum(d.dof for d in dense)
            noise = np.sqrt(max(sum(d.rss for d in dense), 1e-300) / dof)
            guess, logs = space.priors[j].to_u(noise), space.priors[j].log_scale
            sd = (1.0 if logs else noise) / np.sqrt(2 * dof)
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
    return Proposal(mean, np.diag(spread), space.heavy)


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


def panel(messages: Mapping[str, BladeMessage]) -> dict[str, float]:
    """Some blades of each kind, and how many blades each of them stands for.

    Of a kind are blades whose readings rest on the same noises, whatever known ones beside them;
    `PANEL` of each are taken, in an order that has nothing to do with the blades.
    """
    kinds: dict[tuple[str, ...], list[str]] = {}
    for blade, message in messages.items():
        noises = {s if isinstance(s, str) else "" for s in message.rows.sigma}
        kinds.setdefault(tuple(sorted(noises)), []).append(blade)
    found = dict[str, float]()
    for blades in kinds.values():
        taken = sorted(blades, key=lambda blade: seed_of(0, blade))[:PANEL]
        found |= dict.fromkeys(taken, len(blades) / len(taken))
    return {blade: found[blade] for blade in sorted(found)}
