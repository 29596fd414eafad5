"""Before and after: both models, calibrated on the same readings, on readings held out of these.

Held out are all single values that were read at the latest third of a blade's hours, one at least,
of every second blade (in the order of names, of those read at two hours or more): later times, on
blades whose lots, instruments and campaigns the other blades still speak of. Neither calibration
used them; but which effect is in the second model was chosen by all readings, these among them, so
that they test its amplitude and the forecast, not the choice. Each model predicts the *reading*,
with the bias of whoever took it and the reading's own noise where it has one; the score is the log
density of a normal with the prediction's mean and sd [nat per reading].
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import Workspace, update
from core.calibration.state import RotorSpec, RotorState, blade_posterior
from core.diagnosis.expected import with_fewer
from core.model import Model
from core.observation import Inspection
from core.prediction import predict

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Scored:
    """How a model predicts readings that it did not use.

    bias, rmse, width [unit] (width: of the 95 % band, mean); log_score per reading; z and the
    predicted means [unit], (n,)
    """

    count: int
    rmse: float
    bias: float
    log_score: float
    within_68: float
    within_95: float
    width: float
    z: tuple[float, ...]
    means: tuple[float, ...] = ()

    @staticmethod
    def of(mean: Array, sd: Array, bands: Array, y: Array) -> Scored:
        """From predictions (n,), their bounds (4, n) at 2.5, 16, 84 and 97.5 %, and readings."""
        z = (y - mean) / sd
        low95, low68, high68, high95 = bands
        return Scored(
            len(y),
            float(np.sqrt(np.mean((y - mean) ** 2))),
            float(np.mean(mean - y)),
            float(np.mean(-0.5 * z**2 - np.log(sd * np.sqrt(2 * np.pi)))),
            float(np.mean((y >= low68) & (y <= high68))),
            float(np.mean((y >= low95) & (y <= high95))),
            float(np.mean(high95 - low95)),
            tuple(z.tolist()),
            tuple(mean.tolist()),
        )


@dataclass(frozen=True)
class BeforeAfter:
    """Both models on the readings `held`, and the fleet's mean forecast [unit].

    forecast  of each model: mean over blades at `horizon_h` and its sd
    """

    quantity: str
    held: tuple[str, ...]
    before: Scored
    after: Scored
    horizon_h: float
    forecast: tuple[tuple[float, float], tuple[float, float]]


def held_out(
    readings: Sequence[Inspection], quantity: str, concerned: Collection[str] = ()
) -> tuple[Inspection, ...]:
    """Single values of the latest third of its hours of every second blade with two or more.

    What a reading of several nodes says of each is not scored.

    concerned  blades of which both models say different things; where none of them is among the
               second, fourth … (lots that alternate over the slots), it is the first, third …
    """
    of = [r for r in readings if r.quantity == quantity and r.values.size == 1]
    at: dict[str, set[float]] = {}
    for r in of:
        at.setdefault(r.blade, set()).add(r.time_h)
    hours = {b: sorted(at[b]) for b in sorted(at) if len(at[b]) > 1}
    begin = 0 if concerned and not set(concerned) & {*list(hours)[1::2]} else 1
    first = {b: hours[b][-max(1, len(hours[b]) // 3)] for b in list(hours)[begin::2]}
    held = [r for r in of if r.blade in first and r.time_h >= first[r.blade]]
    return tuple(sorted(held, key=lambda r: (r.blade, r.time_h, r.id)))


def before_after(
    models: tuple[Model, Model],
    spec: RotorSpec,
    readings: Sequence[Inspection],
    horizon_h: float,
    quantity: str = "elongation",
    say: Callable[[str], None] = lambda what: None,
    workspace: Workspace | None = None,
    states: Sequence[RotorState] = (),
    blades: Sequence[str] = (),
) -> BeforeAfter:
    """Calibrate both models without the held-out readings (`parted`), and predict these.

    states  of both models with all readings: where to look first
    blades  whose forecast is told; none: all
    """
    held, kept = parted(readings, quantity, concerned(models, spec.blades))
    work = workspace or Workspace()
    found = []
    for i, (model, which) in enumerate(zip(models, ("before", "after"), strict=True)):
        say(f"{which}, without {len(held)} readings")
        start = with_fewer(model, states[i]) if states else None
        state = update(model, spec, kept, workspace=work, start=start)
        scored = score(model, state, held, spec.known)
        found.append((scored, fleet(model, state, spec, quantity, horizon_h, blades)))
    (before, then), (after, now) = found
    return BeforeAfter(quantity, tuple(r.id for r in held), before, after, horizon_h, (then, now))


def concerned(models: tuple[Model, Model], blades: Sequence[str]) -> set[str]:
    """Blades that the second model moves otherwise than the first."""
    own = [[m.network.for_blade(b) for b in blades] for m in models]
    pairs = zip(blades, *own, strict=True)
    return {b for b, p, q in pairs if (p.drifts, p.biases) != (q.drifts, q.biases)}


def parted(
    readings: Sequence[Inspection], quantity: str, concerned: Collection[str] = ()
) -> tuple[tuple[Inspection, ...], list[Inspection]]:
    """What is held out (`held_out`), and what a calibration without it may use.

    Of a blade whose readings are held out nothing of those hours is used, of no other quantity
    either: what comes after them is not known when they are foretold.
    """
    held = held_out(readings, quantity, concerned)
    first: dict[str, float] = {}  # hour of a blade's first reading that is held out
    for r in held:
        first[r.blade] = min(r.time_h, first.get(r.blade, r.time_h))
    return held, [r for r in readings if r.blade not in first or r.time_h < first[r.blade]]


def score(
    model: Model,
    state: RotorState,
    held: Sequence[Inspection],
    known: Mapping[str, Mapping[str, float]] | None = None,
    *,
    median: bool = False,
) -> Scored:
    """Readings that the state does not know, predicted; median: by their medians, not means."""
    mean, sd, bands = [], [], []
    for r in held:
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, r.blade)
        got = predict(
            model.for_blade(r.blade),
            posterior,
            r.quantity,
            [r.time_h],
            None if r.nodes is None else int(r.nodes[0]),
            known=(known or {}).get(r.blade),
            reader=(r.instrument, r.campaign),
            sigma=r.sigma,
        )
        mean.append(got.quantiles[0.5][0] if median else got.mean[0])
        sd.append(got.sd["total"][0])
        bands.append([got.quantiles[p][0] for p in (0.025, 0.16, 0.84, 0.975)])
    y = np.array([float(r.values[0]) for r in held])
    return Scored.of(np.array(mean), np.array(sd), np.array(bands).T, y)


def foreseen(
    model: Model,
    state: RotorState,
    spec: RotorSpec,
    quantity: str,
    hours: float,
    blades: Sequence[str],
) -> tuple[Array, Array]:
    """Mean and sd of each of the blades at an hour, without noise, (B,) each."""
    found = []
    for blade in blades:
        posterior = blade_posterior(state.meta, state.arrays.__getitem__, blade)
        known = (spec.known or {}).get(blade)
        got = predict(
            model.for_blade(blade), posterior, quantity, [hours], noise=False, known=known
        )
        found.append((got.mean[0], got.sd["total"][0]))
    mean, sd = np.array(found).T
    return mean, sd


def fleet(
    model: Model,
    state: RotorState,
    spec: RotorSpec,
    quantity: str,
    hours: float,
    blades: Sequence[str] = (),
) -> tuple[float, float]:
    """Mean over blades (none: all) at an hour, root mean square of their sds, without noise."""
    mean, sd = foreseen(model, state, spec, quantity, hours, blades or spec.blades)
    return float(np.mean(mean)), float(np.sqrt(np.mean(sd**2)))
