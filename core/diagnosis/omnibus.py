"""Is anything missing? Tests of prequential residuals, before anybody asks what it could be.

Readings are grouped (all, by blade, campaign, instrument, lot, coating lot, hour, quantity) and of
each group three things are asked. With the z of a visit and their covariance C (`residuals`),

    mean             T = Σ_visits gᵀ C⁻¹ z        score of an offset in the group, g its indicator
    variance         T = Σ_visits Σ_i∈g e_i²,      e = C^−½ z     the innovations
    autocorrelation  T = Σ_visits Σ_b e_b e_b'     e_b' the blade's innovation at its visit before

C takes away what a visit's readings miss together by the shared parameters, which is no structure.

The null is the predictive itself. Given what was known before, each visit is drawn anew from it
(one shared node, each blade's particles, noise), visit by visit with the past as it was: the
prequential null of Seillier-Moiseiwitsch & Dawid (1993), under which the terms of a sum are
martingale differences whatever the model. Heavy tails of the readings widen it:
the noise is drawn from Student's t with `MOST_FREEDOM` degrees of freedom, as normal noise is a
hope, and with fewer, `LEAST_FREEDOM` at least, where the innovations' kurtosis is a standard error
above a normal's. A process that wanders within each blade is structure, and is found as such by
the autocorrelation.

Each T becomes a score by its null's mean and sd (of the cube root, for a variance), and every p is
two-sided. The family-wise p is the share of draws in which *any* test scores as high (Westfall &
Young's single step), so that correlated tests cost no more than they should; `FAMILY` is the chance
of one alarm or more where nothing is missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.diagnosis.grammar import Facts
from core.diagnosis.visits import Residual, Visit
from core.rng import stream

Array = NDArray[np.float64]
FAMILY = 0.05
LEAST_FREEDOM, MOST_FREEDOM = 5.0, 6.0
FEW = 8  # innovations whose kurtosis says nothing
SURE = 1.0  # standard errors of the kurtosis
BY_PAIRS = ("all", "lot", "coating_lot", "quantity")  # groupings whose autocorrelation is tested


@dataclass(frozen=True, slots=True)
class Test:
    """One question: p by itself and among all (`p_family`); score in sds of its null."""

    grouping: str
    value: str | None
    statistic: str
    count: int
    score: float
    p: float
    p_family: float

    @property
    def alarms(self) -> bool:
        return self.p_family <= FAMILY


@dataclass(frozen=True)
class Omnibus:
    """All tests, the most telling first; degrees of freedom of the noise's tails."""

    tests: tuple[Test, ...]
    freedom: float
    draws: int

    @property
    def alarms(self) -> tuple[Test, ...]:
        return tuple(t for t in self.tests if t.alarms)


def label(residual: Residual, grouping: str, facts: Mapping[str, Facts]) -> str | None:
    """Which group of a grouping a residual is of; None: of none."""
    reading = residual.reading
    own = facts.get(reading.blade, Facts())
    return {
        "all": "all",
        "blade": reading.blade,
        "campaign": reading.campaign,
        "instrument": reading.instrument,
        "lot": own.lot,
        "coating_lot": own.coating_lot,
        "hour": f"visit {residual.visit + 1}",
        "quantity": reading.quantity,
    }[grouping]


GROUPINGS = (*("all", "blade", "campaign", "instrument", "lot", "coating_lot", "hour", "quantity"),)


def omnibus(visits: Sequence[Visit], facts: Mapping[str, Facts], seed: int) -> Omnibus:
    """The tests of these visits; a function of them and the seed."""
    roots = [_root(v.covariance) for v in visits]
    observed = [v.z @ root for v, root in zip(visits, roots, strict=True)]
    share = float(np.mean(np.concatenate([(v.noise**2).mean(axis=0) for v in visits])))
    freedom = tails(np.concatenate(observed), share)
    rng = stream(seed, "omnibus")
    every = [v.signal + v.noise * _noise(rng, v.noise.shape, freedom) for v in visits]
    stacked = [np.vstack([v.z, drawn]) for v, drawn in zip(visits, every, strict=True)]
    e = [z @ root for z, root in zip(stacked, roots, strict=True)]  # (1 + S, n): observed first
    q = [own @ root for own, root in zip(e, roots, strict=True)]
    names: list[tuple[str, str, str, int]] = []
    values: list[Array] = []
    done, paired = set[frozenset[tuple[int, int]]](), set[frozenset[tuple[int, int]]]()
    for grouping in GROUPINGS:
        members: dict[str, list[tuple[int, int]]] = {}
        for k, visit in enumerate(visits):
            for i, residual in enumerate(visit.residuals):
                own = label(residual, grouping, facts)
                if own is not None:
                    members.setdefault(own, []).append((k, i))
        for value, rows in sorted(members.items()):
            told, same = (grouping, value), frozenset(rows)
            if same not in done:  # one lot, one instrument: asked before
                names.append((*told, "mean", len(rows)))
                values.append(sum((q[k][:, i] for k, i in rows), np.zeros(len(e[0]))))
                names.append((*told, "variance", len(rows)))
                square = sum((e[k][:, i] ** 2 for k, i in rows), np.zeros(len(e[0])))
                values.append(np.cbrt(square / len(rows)))
            done.add(same)
            pairs = _pairs(visits, rows) if grouping in BY_PAIRS and same not in paired else []
            paired |= {same} if pairs else set()
            if pairs:
                names.append((*told, "autocorrelation", len(pairs)))
                terms = (e[k][:, i] * e[k0][0, i0] for (k, i), (k0, i0) in pairs)
                values.append(sum(terms, np.zeros(len(e[0]))))
    signed = _scores(np.array(values))
    score = np.abs(signed)
    highest = score[:, 1:].max(axis=0)
    draws = score.shape[1] - 1
    tests = []
    for (grouping, value, statistic, count), own, s in zip(names, score, signed[:, 0], strict=True):
        p = (1 + np.sum(own[1:] >= own[0])) / (1 + draws)
        among = (1 + np.sum(highest >= own[0])) / (1 + draws)
        which = None if grouping == "all" else value
        tests.append(Test(grouping, which, statistic, count, float(s), float(p), float(among)))
    tests.sort(key=lambda t: (t.p_family, -abs(t.score), t.grouping, str(t.value), t.statistic))
    return Omnibus(tuple(tests), freedom, draws)


def tails(e: Array, share: float) -> float:
    """Degrees of freedom of the noise, which has this share of the innovations' variance.

    Student's t with n of them has an excess kurtosis of 6 / (n − 4).

    >>> tails(np.linspace(-2, 2, 100), 0.5)
    6.0
    """
    n, centred = len(e), e - e.mean()
    if n < FEW:
        return MOST_FREEDOM
    excess = float(np.mean(centred**4) / np.mean(centred**2) ** 2 - 3.0)
    if excess <= SURE * np.sqrt(24.0 / n):
        return MOST_FREEDOM
    return max(LEAST_FREEDOM, min(MOST_FREEDOM, 4.0 + 6.0 * min(share, 1.0) ** 2 / excess))


def _noise(rng: np.random.Generator, shape: tuple[int, ...], freedom: float) -> Array:
    """Of unit variance."""
    return np.asarray(rng.standard_t(freedom, shape) * np.sqrt((freedom - 2.0) / freedom))


def _root(covariance: Array) -> Array:
    """C^−½, symmetric: each innovation stays that of its own reading."""
    value, vector = np.linalg.eigh(covariance)
    return np.asarray((vector / np.sqrt(np.maximum(value, 1e-8))) @ vector.T)


def _scores(values: Array) -> Array:
    """In sds of each test's null; the first column is what was seen."""
    null = values[:, 1:]
    size = null.std(axis=1, keepdims=True)
    centred = values - null.mean(axis=1, keepdims=True)
    return np.asarray(centred / np.where(size > 0, size, np.inf))


def _pairs(
    visits: Sequence[Visit], rows: Sequence[tuple[int, int]]
) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Rows, each with that of the same blade, quantity, place, instrument and part at its visit
    before."""
    last: dict[tuple[Any, ...], tuple[int, int]] = {}
    found = []
    for k, i in sorted(rows):
        one = visits[k].residuals[i]
        own = one.reading
        nodes = None if own.nodes is None else tuple(own.nodes.tolist())
        key = (own.blade, own.quantity, nodes, own.instrument, one.part)
        if key in last and last[key][0] < k:
            found.append(((k, i), last[key]))
        if key not in last or last[key][0] < k:
            last[key] = (k, i)
    return found
