"""The inspection that would tell rivals apart: expected information about which one is true.

Rivals k = 1 … K are models with their effects calibrated, p_k their shares of the evidence. Before
a set of readings y is taken, each expects them to be N(m_k, C_k) (`core.planning.ahead`). What
they are expected to tell is the mutual information of rival and readings,

    I(K; y) = Σ_k p_k ∫ N(y; m_k, C_k) log [ N(y; m_k, C_k) / Σ_j p_j N(y; m_j, C_j) ] dy    [nat]

between 0, where all rivals expect the same, and the entropy −Σ p_k log p_k, where the readings
will settle it (Lindley 1956; for rival models Box & Hill 1967). With p_k(y) ∝ p_k N(y; m_k, C_k)
the shares afterwards,

    share   Σ_k p_k E_k[p_k(y)]              expected share of the rival that is true
    settled Σ_k p_k P_k(max_j p_j(y) ≥ NAMED)   chance that one rival will have a name's evidence

One reading is integrated by the trapezoidal rule on each rival's density, which converges faster
than any power of the step; a set by 2,048 points of Sobol's sequence. A set grows by the reading
that adds most (greedy: as I is not always submodular for normals, a bound is not claimed).

That densities are normal, and shares change by them alone, is an approximation: a rival whose
parameters the reading moves is calibrated anew once the reading is there. Tests hold the shares
against evidence from calibrations with simulated readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from core.calibration.message import POOL
from core.calibration.state import RotorState
from core.diagnosis.verdict import NAMED
from core.errors import InputError
from core.model import Model
from core.planning.ahead import Expected, expected
from core.planning.campaigns import Campaign
from core.planning.candidates import Candidate

Array = NDArray[np.float64]
Json = dict[str, Any]
GRID = 321  # points across ± REACH sds of each rival's density
REACH = 8.0
POINTS = 11  # log2 of Sobol points for a set
BEST = 60  # candidates, by their information alone, from which a set is chosen
SET = 3  # readings of a set
NOTHING = 1e-3  # nat that a further reading has to add


@dataclass(frozen=True)
class Rival:
    """A calibrated hypothesis: its names, its model and state, its share of the evidence.

    called  the names as the verdict has them: causes, where how these run is open
    """

    names: tuple[str, ...]
    model: Model
    state: RotorState
    weight: float
    called: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Told:
    """What readings are expected to tell; see the module's text. gain [nat]."""

    gain: float
    share: float
    settled: float


@dataclass(frozen=True)
class Separation:
    """Candidates by what they would tell of the rivals.

    entropy   of the shares now [nat]: no reading tells more
    single    every candidate with what it alone tells, largest first
    mean, sd  what each rival expects of it, (K,), in the order of `single`
    grown     the set, reading by reading: what the first, the first two, … tell together
    """

    rivals: tuple[Rival, ...]
    entropy: float
    single: tuple[tuple[Candidate, Told], ...]
    mean: Array
    sd: Array
    grown: tuple[tuple[Candidate, Told], ...]
    campaigns: tuple[tuple[Campaign, Told], ...] = ()


def one_reading(p: Array, mean: Array, sd: Array) -> tuple[Array, Array, Array]:
    """gain, share and settled of C readings, each (C,); p (K,), mean and sd (K, C).

    >>> p, sd = np.array([0.5, 0.5]), np.ones((2, 1))
    >>> gain, share, _ = one_reading(p, np.array([[-1.0], [1.0]]), sd)
    >>> round(float(gain[0] / np.log(2)), 4)  # bits through a binary-input Gaussian channel, 0 dB
    0.4859
    """
    t = np.linspace(-REACH, REACH, GRID)
    weight = np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi) * (t[1] - t[0])
    out = np.zeros((3, mean.shape[1]))
    for k in range(len(p)):
        y = mean[k][:, None] + sd[k][:, None] * t  # (C, G)
        z = (y - mean[:, :, None]) / sd[:, :, None]
        after = afterwards(p, -0.5 * z**2 - np.log(sd[:, :, None]))
        out += p[k] * np.stack([values @ weight for values in scored(p, after, k)])
    return out[0], out[1], out[2]


def a_set(p: Array, mean: Array, covariance: Array) -> Told:
    """What n readings tell together; mean (K, n), covariance (K, n, n)."""
    n = mean.shape[1]
    t = ndtri(np.clip(qmc.Sobol(n, seed=0).random_base2(POINTS), 1e-12, 1 - 1e-12))
    roots = np.linalg.cholesky(covariance)
    log_det = np.log(np.einsum("kii->ki", roots)).sum(axis=1)
    out = np.zeros(3)
    for k in range(len(p)):
        off = (mean[k] + t @ roots[k].T)[None] - mean[:, None]  # (K, N, n)
        z = np.linalg.solve(roots, np.swapaxes(off, 1, 2))
        after = afterwards(p, -0.5 * np.sum(z**2, axis=1) - log_det[:, None])
        out += p[k] * np.array([np.mean(values) for values in scored(p, after, k)])
    return Told(float(out[0]), float(out[1]), float(out[2]))


def afterwards(p: Array, log_density: Array) -> Array:
    """log of the shares once the reading is there, (K, …)."""
    joint = log_density + np.log(p).reshape(-1, *[1] * (log_density.ndim - 1))
    top = joint.max(axis=0)
    return np.asarray(joint - top - np.log(np.exp(joint - top).sum(axis=0)))


def scored(p: Array, after: Array, k: int) -> tuple[Array, Array, Array]:
    """log of how much rival k's share grows, its share, and whether any is settled."""
    settled = (after.max(axis=0) >= np.log(NAMED)).astype(float)
    return np.asarray(after[k] - np.log(p[k])), np.exp(after[k]), settled


def separate(
    rivals: Sequence[Rival],
    asked: Sequence[Candidate],
    known: Mapping[str, Mapping[str, float]] | None = None,
    count: int = SET,
) -> Separation:
    """Candidates ranked by what they would tell of the rivals, and the set of `count` readings.

    Raises InputError for fewer than two rivals.
    """
    if len(rivals) < 2:
        raise InputError("rivals", len(rivals), "leave nothing to tell apart", "give two or more")
    p = np.array([r.weight for r in rivals], float)
    p = np.maximum(p / p.sum(), 1e-12)
    p /= p.sum()
    told = list(POOL.map(lambda r: expected(r.model, r.state, asked, known), rivals))
    mean, sd = np.array([e.mean for e in told]), np.array([e.sd for e in told])
    gain, share, settled = one_reading(p, mean, sd)
    # Ties (blades that are alike) go by the order of the candidates, whatever the last digits are.
    order = sorted(range(len(asked)), key=lambda c: (-round(float(gain[c]), 9), c))
    single = tuple(
        (asked[c], Told(float(gain[c]), float(share[c]), float(settled[c]))) for c in order
    )
    grown = _grown(p, told, asked, order[:BEST], single[0][1], count)
    return Separation(
        tuple(rivals), float(-p @ np.log(p)), single, mean[:, order], sd[:, order], grown
    )


def _grown(
    p: Array,
    told: Sequence[Expected],
    asked: Sequence[Candidate],
    among: Sequence[int],
    first: Told,
    count: int,
) -> tuple[tuple[Candidate, Told], ...]:
    """Greedy: from the best single reading on, the one that adds most to those before."""
    taken, grown = [among[0]], [(asked[among[0]], first)]
    mean = np.array([e.mean for e in told])
    whole = np.array([e.covariance(among) for e in told])  # (K, B, B)
    while len(taken) < min(count, len(among)):
        best: tuple[float, int, Told] | None = None
        for c in among:
            if c in taken:
                continue
            which = [*taken, c]
            at = [among.index(i) for i in which]
            both = a_set(p, mean[:, which], whole[:, at][:, :, at])
            if best is None or both.gain > best[0] + 1e-9:
                best = (both.gain, c, both)
        if best is None or best[0] < grown[-1][1].gain + NOTHING:
            break
        taken.append(best[1])
        grown.append((asked[best[1]], best[2]))
    return tuple(grown)


def separation_json(found: Separation, shown: int = 12) -> Json:
    """The best blade for each quantity, instrument and hour; what rivals expect of it; the set;
    and campaigns of all blades.

    blades_alike  blades of which the same inspection tells nine tenths as much or more
    """
    network = found.rivals[0].model.network
    kinds: dict[object, list[int]] = {}
    for i, (one, _) in enumerate(found.single):
        kinds.setdefault((one.quantity, one.instrument, one.ahead_h), []).append(i)
    single = []
    for members in list(kinds.values())[:shown]:
        i = members[0]
        candidate, told = found.single[i]
        alike = {
            found.single[j][0].blade for j in members if found.single[j][1].gain >= 0.9 * told.gain
        }
        expect = [
            {"mean": float(m), "sd": float(s)}
            for m, s in zip(found.mean[:, i], found.sd[:, i], strict=True)
        ]
        unit = network.quantity(candidate.quantity).unit
        single.append(
            {
                **candidate.to_json(),
                "unit": unit,
                **_told(told),
                "blades_alike": len(alike),
                "expected": expect,
            }
        )
    return {
        "rivals": [
            {"names": list(r.names), "called": list(r.called or r.names), "weight": r.weight}
            for r in found.rivals
        ],
        "entropy_nat": found.entropy,
        "single": single,
        "set": [{**candidate.to_json(), **_told(told)} for candidate, told in found.grown],
        "campaigns": [{**one.to_json(), **_told(told)} for one, told in found.campaigns],
    }


def _told(told: Told) -> Json:
    return {"gain_nat": told.gain, "share": told.share, "settled": told.settled}
