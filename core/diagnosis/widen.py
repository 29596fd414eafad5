"""A lack without a name: how much wider it makes the bands.

Something is missing, and no cell of the grammar explains it. What the model then still owes is a
band that is wide enough. The quantity gets a Gaussian process over operating hours that all blades
have in common (`core.discrepancy`),

    y = (1 + f(t)) Y_m + epsilon,     f ~ GP(0, sd² exp(−(t − t')² / 2 length²))

The scores tell, to second order, which sd and length the readings would have; the rotor is
calibrated once with these, and the particle filter's evidence says whether they are borne out. Its
share is of the variance of what is predicted, so it is known how much of a band is ignorance. It
names no cause and is no attribution: a misfit of single blades or readings, which blades have not
in common, gains nothing here, and stands in the noise that is calibrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import Workspace, begun
from core.calibration.state import RotorState, blade_posterior
from core.diagnosis.case import Case
from core.diagnosis.expected import with_columns
from core.diagnosis.scores import Scores
from core.discrepancy import affine
from core.errors import InputError
from core.model import Model
from core.prediction import predict
from core.quantity import Discrepancy

Array = NDArray[np.float64]
SDS = (0.01, 0.02, 0.04, 0.08, 0.16)
LENGTHS = (1.0, 0.6, 0.35)  # of the hours that the model covers
EARNED = 2.0  # nat, from which on the readings bear it out


@dataclass(frozen=True)
class Widened:
    """A model with a discrepancy of one quantity, calibrated.

    gained    log evidence against the model as it was [nat]
    hour_h    at which share and sds are told: of the fleet's predictions, without noise
    share     of the discrepancy in their variance, 0 … 1; sds (before, after), root mean squares
    """

    quantity: str
    discrepancy: Discrepancy
    model: Model
    state: RotorState
    gained: float
    hour_h: float
    share: float
    sds: tuple[float, float]

    @property
    def borne_out(self) -> bool:
        """Whether the readings have it, and the state can be trusted."""
        return self.settled and self.gained >= EARNED

    @property
    def settled(self) -> bool:
        """Whether enough nodes carry its posterior."""
        return bool(self.state.meta["health"]["met_floor"])


def widen(
    model: Model,
    state: RotorState,
    case: Case,
    quantity: str,
    hour_h: float,
    workspace: Workspace | None = None,
) -> Widened | None:
    """The rotor with a discrepancy of a quantity; None where it declares one, or has no room.

    model, state   without any effect
    """
    if model.network.quantity(quantity).discrepancy.kind != "none":
        return None
    seen = case.seen(model, state)
    tried = [
        (gain, declared, bigger, g, h)
        for declared in _candidates(model)
        if (bigger := _with(model, quantity, declared)) is not None
        for g, h in [_columns(bigger, seen, quantity)]
        for gain in [_gain(seen, g, h)]
    ]
    if not tried:
        return None
    _, declared, bigger, g, h = max(tried, key=lambda one: one[0])
    names = [f"theta.{quantity}.{k + 1}" for k in range(g.shape[2])]
    start = replace(with_columns(model, state, seen, g, h, names), served=True)
    step = begun(bigger, case.spec, case.readings, workspace=workspace, start=start)
    made = step.sealed()
    if not made.meta["health"]["met_floor"]:  # it may be served: it is looked for everywhere
        step = begun(bigger, case.spec, case.readings, workspace=workspace)
        made = step.sealed()
    before, _ = _spread(model, state, case, quantity, hour_h)
    after, own = _spread(bigger, made, case, quantity, hour_h)
    return Widened(
        quantity,
        declared,
        bigger,
        made,
        step.log_evidence - state.meta["log_evidence"],
        hour_h,
        own / after if after > 0 else 0.0,
        (float(np.sqrt(before)), float(np.sqrt(after))),
    )


def _candidates(model: Model) -> list[Discrepancy]:
    horizon = model.surrogate.horizon_h
    return [
        Discrepancy("gp", sd=sd, length_h=round(share * horizon, 6))
        for share in LENGTHS
        for sd in SDS
    ]


def _with(model: Model, quantity: str, declared: Discrepancy) -> Model | None:
    """The model with it; None where its process has too many modes or lets the gain fall to 0."""
    network = model.network
    changed = tuple(
        replace(q, discrepancy=declared) if q.name == quantity else q for q in network.quantities
    )
    try:
        made = Model.of(replace(network, quantities=changed), model.surrogate)
        affine(made, made.network.quantity(quantity), 0.0)
    except InputError:
        return None
    return made


def _columns(bigger: Model, seen: Scores, quantity: str) -> tuple[Array, Array]:
    """Signatures of the process' modes, of an amplitude of one, and their h, (B, n, k) each."""
    own, known = bigger.network.quantity(quantity), dict[float, Array]()
    shares: Array | None = None
    for b, i in np.argwhere(seen.real):
        reading = seen.reading(b, i)
        if reading.quantity != quantity:
            continue
        if reading.time_h not in known:
            terms = affine(bigger, own, reading.time_h).gain
            known[reading.time_h] = np.array([c for c, n in terms if n[0].startswith("theta.")])
        if shares is None:
            shares = np.zeros((*seen.place.shape, len(known[reading.time_h])))
        shares[b, i] = known[reading.time_h]
    assert shares is not None
    g, h = zip(*(seen.in_proportion(shares[:, :, k]) for k in range(shares.shape[2])), strict=True)
    return np.stack(g, axis=2), np.stack(h, axis=2)


def _gain(seen: Scores, g: Array, h: Array) -> float:
    """log BF of all modes together, with standard-normal amplitudes, to second order."""
    u = np.einsum("bic,bi->c", g, seen.q) + h.sum(axis=(0, 1))
    a = seen.cross(g) + np.eye(g.shape[2])
    return float(0.5 * u @ np.linalg.solve(a, u) - 0.5 * np.linalg.slogdet(a)[1])


def _spread(
    model: Model, state: RotorState, case: Case, quantity: str, hour_h: float
) -> tuple[float, float]:
    """Mean over the blades of a prediction's variance without noise, and the discrepancy's part."""
    found: list[Sequence[float]] = []
    for blade in case.present:
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        known = (case.spec.known or {}).get(blade)
        own = model.for_blade(blade)
        sd = predict(own, posterior, quantity, [hour_h], noise=False, known=known).sd
        found.append((float(sd["total"][0]) ** 2, float(sd["discrepancy"][0]) ** 2))
    total, part = np.mean(found, axis=0)
    return float(total), float(part)
