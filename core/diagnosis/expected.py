"""Where a posterior is expected that differs by an effect, or by readings, from a known one.

The scan tells, to second order, how large an effect would be, how the shared parameters would move
with it, and how much of the noise was the effect; a posterior with the effect is looked for there
first (`core.calibration.start`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from core.calibration.space import shared_prior
from core.calibration.start import Start
from core.calibration.state import RotorState
from core.diagnosis.adopt import amplitude, expected
from core.diagnosis.grammar import Cell
from core.diagnosis.scan import Scan
from core.diagnosis.scores import Scores
from core.diagnosis.signature import directed
from core.model import Model

Array = NDArray[np.float64]
QUIETER = (0.05, 1.0)  # bounds of a noise's variance with an effect over that without
FEWER = 3.0  # variances with a part of the readings, in those with all


def joined(
    model: Model,
    state: RotorState,
    scan: Scan,
    which: Sequence[int],
    before: Model,
    noise: Mapping[str, float],
) -> Start:
    """With cells `which` of a scan of this state as effects.

    before  the model without any effect; noise: by quantity, as `adopt.with_effects` has it
    """
    cells, columns = [scan.cells[i] for i in which], list(which)
    names, origins = zip(*(amplitude(c, before.network) for c in cells), strict=True)
    g, h = scan.g[:, :, columns], scan.h[:, :, columns]
    given = with_columns(
        model, state, scan.seen, g, h, names, np.array([_size(c, before, noise) for c in cells])
    )
    given.mean[-len(which) :] += origins  # those of an input that wakes
    awake = dict[str, float]()
    for cell, name, x in zip(cells, names, given.mean[-len(which) :], strict=True):
        if name == cell.family.of and (own := before.network.parameter(name).prior).log_scale:
            awake[name] = float(np.clip(x, own.low, own.high))
    return given.on_log(awake)


def with_columns(
    model: Model,
    state: RotorState,
    seen: Scores,
    g: Array,
    h: Array,
    names: Sequence[str],
    sizes: Array | None = None,
) -> Start:
    """With effects of signatures g and h (B, n, C) (`core.diagnosis.scores`), as parameters.

    sizes  (C,) of the parameters for one of a signature; none: one
    """
    start, one = Start.of(model, state), np.eye(len(names))
    size = np.ones(len(names)) if sizes is None else sizes
    information = seen.cross(g)
    u = np.einsum("bic,bi->c", g, seen.q) + h.sum(axis=(0, 1))
    alone, noise = np.asarray(np.linalg.solve(information + one, u), float), _noises(model, start)
    _, quiet = _quieter(seen, g, alone, noise)
    covariance = np.asarray(np.linalg.inv(information / quiet + one), float)
    mean = covariance @ u / quiet
    turn = np.zeros((len(start.names), len(names)))
    others = [j for j, n in enumerate(start.names) if not n.startswith("sigma_obs.")]
    by_log = np.array([shared_prior(model, start.names[j]).log_scale for j in others], bool)
    scale = np.where(by_log, np.exp(-np.where(by_log, start.mean[others], 0.0)), 1.0)
    turn[others] = scale[:, None] * seen.imitating(g) / size
    given = start.joined(names, turn, mean * size, covariance * np.outer(size, size))
    for name, ratio in _quieter(seen, g, mean, noise)[0].items():
        if name in start.names and shared_prior(model, name).log_scale:
            given.mean[start.names.index(name)] += 0.5 * np.log(ratio)
    return given


def _noises(model: Model, start: Start) -> dict[str, float]:
    """The noises [unit] that a start expects."""
    found = dict[str, float]()
    for name, mean in zip(start.names, start.mean.tolist(), strict=True):
        if name.startswith("sigma_obs."):
            found[name] = float(np.exp(mean)) if shared_prior(model, name).log_scale else mean
    return found


def _quieter(
    seen: Scores, g: Array, amplitude: Array, noise: Mapping[str, float]
) -> tuple[dict[str, float], float]:
    """Variance of each noise with effects of signatures g (B, n, C) over that without; and of the
    rows that tell the effects, on average.

    Residuals q become q − Q g⊥ a, and a noise is as large as its residuals. What a scan tells of
    its noise alone (`core.calibration.scans`), thousands of values, no effect changes; nor does it
    a noise that is known.
    """
    left, told = seen.including(g, amplitude).q, np.sum(g * (seen.information @ g), axis=2)
    squares = {name: np.zeros(2) for name in noise}
    for one in (d for rows in seen.rows for d in rows.dense if isinstance(d.sigma, str)):
        squares[str(one.sigma)] += one.rss / (noise[str(one.sigma)] ** 2 + one.extra) ** 2
    telling = dict.fromkeys(("", *noise), 0.0)
    for b, i in np.argwhere(seen.real):
        sigma = seen.rows[b].sigma[i]
        if isinstance(sigma, str):
            squares[sigma] += seen.q[b, i] ** 2, left[b, i] ** 2
        telling[sigma if isinstance(sigma, str) else ""] += told[b, i]
    ratios = {
        n: float(np.clip(after / before, *QUIETER)) if before > 0 else 1.0
        for n, (before, after) in squares.items()
    }
    whole = max(sum(telling.values()), 1e-300)
    return ratios, sum(ratios.get(n, 1.0) * share for n, share in telling.items()) / whole


def _size(cell: Cell, before: Model, noise: Mapping[str, float]) -> float:
    """What the amplitude's parameter is for one expected size, with its sign."""
    woken = amplitude(cell, before.network)[0] == cell.family.of
    return directed(cell) if woken else expected(cell, noise)


def without(model: Model, state: RotorState, cells: Sequence[Cell], before: Model) -> Start:
    """Without these of the effects that a model has."""
    at = dict[str, float]()
    for name, origin in (amplitude(c, before.network) for c in cells):
        own = shared_prior(model, name)
        at[name] = float(np.log(max(origin, own.low))) if own.log_scale else origin
    return Start.of(model, state).held(at)


def with_fewer(model: Model, state: RotorState) -> Start:
    """With a part of the readings left out."""
    return Start.of(model, state).wider(FEWER)
