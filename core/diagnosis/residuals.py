"""Every reading predicted before it is used.

Readings are ordered by the rotor's hour at which they were taken (`core.ages`), not by
arrival. Those of one hour, or of hours closer than `SAME` of the longest history, are one *visit*
D_k; each is predicted from the visits before it alone,

    y_i ~ p(y_i | D_1 … D_k−1) = Σ_j w_j N(g_j f_j + o_j, v_j),      i in D_k,

(Dawid's prequential predictive), with the particles j of its blade in the sealed posterior of these
readings: f the surrogate, g and o discrepancies and biases of its reader, v surrogate and noise.
A parameter that nobody has read yet keeps its prior. Then

    z_i = (y_i − mean_i) / sd_i,      PIT_i = P(y < y_i | D_1 … D_k−1),

and PIT is uniform wherever the model holds, from the first visit, which is predicted from the
priors, to the last. As a sealed posterior is a function of readings, seed and algorithm, so is
every z: arrival order, corrections and retractions leave no trace (mark 7).

One calibration a visit is the price: three for three outages, `MOST` at most, as neighbouring
visits are joined beyond that (each reading is then predicted from farther back, honestly). The
cheap way, the final particles weighted by 1 / likelihood of what came later, was measured on 20
blades read at three visits (`core/decisions.md`): of the blade's 2,000 particles a handful counts.

Readings of one visit are not independent: they miss together where the shared parameters do. What
tests need of that is kept with the visit: the covariance C of its z,

    C = between blades: Cov over the shared nodes of E[z | node];   within a blade: over particles,

and `signal`, `noise`: z = signal + noise · e as the predictive draws it, one shared node for all
blades in each of `DRAWS` draws, e of unit variance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from core.calibration.online import Workspace, update
from core.calibration.state import RotorSpec, RotorState
from core.calibration.target import assemble
from core.diagnosis.foretold import DRAWS, Fresh, foretold
from core.diagnosis.grammar import Facts
from core.diagnosis.visits import Residual, Visit, hour_of, visits_of
from core.errors import InputError
from core.model import Model
from core.observation import Inspection
from core.rng import stream


def residuals(
    model: Model,
    spec: RotorSpec,
    readings: Sequence[Inspection],
    facts: Mapping[str, Facts],
    say: Callable[[str, int, int], None] = lambda what, done, total: None,
    workspace: Workspace | None = None,
) -> list[Visit]:
    """Every reading that counts, predicted from the visits before its own.

    say   called with (what, done, visits) before each calibration; what it raises ends the work

    Raises InputError where no reading counts.
    """
    if not readings:
        raise InputError("readings", 0, "count: there is nothing to predict", "post inspections")
    work = workspace or Workspace()
    visits, found = visits_of(readings, facts), list[Visit]()
    before: list[Inspection] = []
    for number, visit in enumerate(visits):
        say(f"visit {number + 1}", number, len(visits))
        state = update(model, spec, before, workspace=work)
        found.append(predicted(model, spec, state, visit, facts, number))
        before += visit
    return found


def predicted(
    model: Model,
    spec: RotorSpec,
    state: RotorState,
    visit: Sequence[Inspection],
    facts: Mapping[str, Facts],
    number: int,
) -> Visit:
    """A visit's readings under a state; prequential where the state rests on those before it."""
    by_blade: dict[str, list[Inspection]] = {}
    for reading in visit:
        by_blade.setdefault(reading.blade, []).append(reading)
    rng = stream(spec.seed, spec.id, "residuals", str(number))
    log_w = state.arrays["shared/log_w"]
    w = np.exp(log_w - log_w.max())
    node = rng.choice(len(w), DRAWS, p=w / w.sum())
    fresh = Fresh(model, spec.seed)
    parts = []
    for blade in sorted(by_blade):
        rows = assemble(model, by_blade[blade])
        assert rows is not None
        known = (spec.known or {}).get(blade)
        parts.append(foretold(model, state, blade, rows, known, node, fresh, rng))
    found = []
    for part in parts:
        seen: dict[int, int] = {}
        for i, place in enumerate(part.place):
            reading = part.rows.readings[place]
            seen[place] = seen.get(place, -1) + 1
            hour = hour_of(reading, facts)
            values = (float(v[i]) for v in (part.y, part.mean, part.sd, part.z, part.pit))
            found.append(Residual(reading, seen[place], number, hour, *values))
    means = np.concatenate([p.by_node for p in parts], axis=1)  # (K, n)
    weight = (w / w.sum())[:, None]
    off = means - np.sum(weight * means, axis=0)
    covariance = off.T @ (weight * off)
    at = 0
    for p in parts:
        end = at + len(p.z)
        covariance[at:end, at:end] = p.covariance
        at = end
    return Visit(
        tuple(found),
        covariance,
        np.concatenate([p.signal for p in parts], axis=1),
        np.concatenate([p.noise for p in parts], axis=1),
        dict(state.meta["health"]),
    )
