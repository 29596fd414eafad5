"""Whether an effect holds in another condition: all blades of one condition left out in turn.

Where blades differ in a known input (the stress of a creep specimen), what was learnt at some of
its values is asked for the others: both models are calibrated without any reading of the blades
that have one value of it, and predict these readings. An effect that fits well and forecasts badly
shows here, and nowhere else.

Errors are those of medians. Far from what was read a forecast has tails (accelerating creep is the
exponential of an uncertain rate), and its mean hangs on the few particles that creep most: of
readings of 0.1 to 8 % it was 0.5 % off by one set of draws and 690 % by another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from core.calibration.online import Workspace, update
from core.calibration.state import RotorSpec, RotorState
from core.diagnosis.expected import with_fewer
from core.diagnosis.report import Scored, score
from core.model import Model
from core.observation import Inspection

LEAST, MOST = 3, 8  # values of a known input, between which it is a condition
WORSE = 1.02  # of the error before, from which on an effect does not hold there
COVERED = 0.8  # of the readings inside 95 % bands, below which they are not to be trusted there


@dataclass(frozen=True, slots=True)
class Condition:
    """Blades with one value of a known input, and how both models predict their readings unseen."""

    input: str
    value: float
    blades: tuple[str, ...]
    before: Scored
    after: Scored

    @property
    def fault(self) -> str | None:
        """Why the effects do not hold there; None: they do.

        Their error is larger than without them; or their 95 % bands hold fewer readings than those
        without, and less than `COVERED`: a mean that came nearer under a band that shrank more.
        """
        before, after = self.before, self.after
        if after.rmse > WORSE * before.rmse:
            return f"an error of {before.rmse:.3g} becomes {after.rmse:.3g}"
        if after.within_95 < min(COVERED, before.within_95):
            held = f"{100 * before.within_95:.0f} % of the readings in 95 % bands become"
            return f"{held} {100 * after.within_95:.0f} %"
        return None

    @property
    def holds(self) -> bool:
        """Whether error and bands with the effects are no worse than without."""
        return self.fault is None

    def to_json(self) -> dict[str, Any]:
        """Plain JSON, without the single z."""
        told = {name: getattr(self, name) for name in ("input", "value", "holds", "fault")}
        return {**told, "blades": list(self.blades), **_both(self.before, self.after)}


def _both(before: Scored, after: Scored) -> dict[str, Any]:
    names = ("count", "rmse", "bias", "log_score", "within_68", "within_95", "width")
    return {
        which: {name: getattr(one, name) for name in names}
        for which, one in (("before", before), ("after", after))
    }


def conditions(
    known: Mapping[str, Mapping[str, float]] | None, blades: Sequence[str]
) -> list[tuple[str, float, tuple[str, ...]]]:
    """Known inputs of `LEAST` to `MOST` values, each value with the blades that have it.

    >>> known = {"a": {"stress": 1.0}, "b": {"stress": 2.0}, "c": {"stress": 4.0}}
    >>> conditions(known, ["a", "b", "c"])[-1]
    ('stress', 4.0, ('c',))
    >>> conditions(known, ["a", "b"])
    []
    """
    given = {b: dict((known or {}).get(b, {})) for b in sorted(blades)}
    found = []
    for name in sorted({n for own in given.values() for n in own}):
        values = sorted({own[name] for own in given.values() if name in own})
        if LEAST <= len(values) <= MOST:
            found += [
                (name, v, tuple(b for b, own in given.items() if own.get(name) == v))
                for v in values
            ]
    return found


def transferred(
    models: tuple[Model, Model],
    spec: RotorSpec,
    readings: Sequence[Inspection],
    quantity: str,
    say: Callable[[str], None] = lambda what: None,
    workspace: Workspace | None = None,
    states: Sequence[RotorState] = (),
) -> tuple[Condition, ...]:
    """Both models in every condition, calibrated on all others; empty where there are none.

    states  of both models with all readings: where to look first
    """
    work = workspace or Workspace()
    found = []
    for name, value, blades in conditions(spec.known, sorted({r.blade for r in readings})):
        of = [r for r in readings if r.quantity == quantity and r.values.size == 1]
        held = [r for r in of if r.blade in blades]
        kept = [r for r in readings if r.blade not in blades]
        if not held:
            continue
        scored = []
        for i, model in enumerate(models):
            say(f"without {name} = {value:g}")
            start = with_fewer(model, states[i]) if states else None
            state = update(model, spec, kept, workspace=work, start=start)
            scored.append(score(model, state, held, spec.known, median=True))
        found.append(Condition(name, value, blades, scored[0], scored[1]))
    return tuple(found)
