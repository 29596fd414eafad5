"""What an effect in the model changes, on simulated rotors whose truth is known.

Both models are calibrated without a sixth of the readings and predict these, and the fleet at the
plan's horizon (`core.diagnosis.report`). What no model of effects could do better is the same rotor
without the effect, read with the same noise and predicted by the model as it was (``sound``): there
blades differ as they do, and nothing is missing. Where several rivals stand, their forecasts at the
horizon and that of all together are held against the truth, too (`core.diagnosis.alternatives`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.calibration.online import Workspace, update
from core.diagnosis.alternatives import Alternative, alternatives
from core.diagnosis.diagnose import Diagnosis
from core.diagnosis.expected import with_fewer
from core.diagnosis.report import Scored, before_after, fleet, parted, score
from core.validation.effect_sets import CONDITIONS, Set
from core.validation.records import Record

Array = NDArray[np.float64]
FORETOLD = ("before", "leading", "together")


def compared(told: Diagnosis, given: Set, horizon_h: float, work: Workspace) -> dict[str, Any]:
    """Both models on readings that they did not use: as they were read, and without noise; and the
    model as it was on the same rotor without what is planted."""
    models, states = (told.before[0], told.after[0]), (told.before[1], told.after[1])
    horizon = horizon_h or max(r.time_h for r in given.case.readings)
    both = before_after(
        models,
        given.case.spec,
        given.case.readings,
        horizon,
        workspace=work,
        states=states,
    )
    found: dict[str, Any] = {"held": len(both.held)}
    exact = np.concatenate([given.exact[name] for name in both.held])
    for when, scored, forecast in zip(
        ("before", "after"), (both.before, both.after), both.forecast, strict=True
    ):
        found[when] = _held_against(scored, forecast[0], exact, given.ahead)
    held, kept = parted(given.without, both.quantity)
    spec, start = given.case.spec, with_fewer(models[0], states[0])
    sound = update(models[0], spec, kept, workspace=work, start=start)
    mean = fleet(models[0], sound, spec, both.quantity, horizon)[0]
    exact = np.concatenate([given.sound[r.id] for r in held])
    scored = score(models[0], sound, held, spec.known)
    found["sound"] = _held_against(scored, mean, exact, given.sound_ahead)
    return found | foretold(told, given, horizon)


def _held_against(
    scored: Scored, mean: float, exact: Array, ahead: Mapping[str, float]
) -> dict[str, float]:
    """Predictions against readings and against what these are without noise (n,), and the fleet's
    forecast mean against the truth, where there is one."""
    off = np.array(scored.means) - exact
    found = {
        "rmse": round(scored.rmse, 5),
        "bias": round(scored.bias, 5),
        "exact_rmse": round(float(np.sqrt(np.mean(off**2))), 5),
        "exact_bias": round(float(np.mean(off)), 5),
        "log_score": round(scored.log_score, 4),
        "inside_95": round(scored.within_95, 4),
        "width_95": round(scored.width, 5),
    }
    if ahead:
        truth = float(np.mean([*ahead.values()]))
        found["forecast_error"] = round(mean / truth - 1.0, 5)
    return found


def foretold(told: Diagnosis, given: Set, horizon_h: float) -> dict[str, Any]:
    """Where several rivals stand: errors at the horizon of the blades that they differ in, by the
    model as it was, the leading rival's and all of them together, and how many sds of a single
    blade (rms) the last is off: a mean over blades is known better than that.

    Where nothing is claimed and what is planted is among the rivals, `chosen` is the error of the
    weightiest that has it, as somebody would choose who knows it, and `missed` the mean size of
    the errors of those that have it not.
    """
    others = alternatives(told.before, told.rivals, given.case, "elongation", horizon_h)
    if others is None or not given.ahead:
        return {}
    truth = float(np.mean([given.ahead[b] for b in others.blades]))
    own = frozenset(e.cell for e in told.effects)
    leading = next((one.mean for one in others.each if frozenset(one.effects) <= own), None)
    means = {"before": others.before[0], "leading": leading, "together": others.together[0]}
    errors = {k: None if m is None else round(m / truth - 1.0, 5) for k, m in means.items()}
    off = (others.together[0] - truth) / others.together[1]
    if told.verdict.word != "effect":
        true = [one.mean for one in others.each if _is_true(one, given)]
        rest = [abs(one.mean / truth - 1.0) for one in others.each if not _is_true(one, given)]
        errors["chosen"] = round(true[0] / truth - 1.0, 5) if true else None
        errors["missed"] = round(float(np.mean(rest)), 5) if rest else None
    return {"rivals": {"count": len(others.each), **errors, "z": round(off, 3)}}


def _is_true(one: Alternative, given: Set) -> bool:
    """Whether an alternative has all that is planted, by name or cause."""
    own = {called for cell in one.effects for called in (cell.name, cell.cause)}
    return bool(given.each) and all(names & own for names in given.each)


def _after(own: Sequence[Record], what: str, power: int = 1) -> Array:
    """Means over sets of a number's size, of its root mean square for 2: after over before, and
    where the sets have it without the effect over before."""
    whens = [when for when in ("before", "after", "sound") if all(when in r for r in own)]
    sizes = [[abs(r[when][what]) ** power for when in whens] for r in own]
    means = np.mean(sizes, axis=0) ** (1.0 / power)
    return np.asarray(means[1:] / means[0])


def _chosen(own: Sequence[Record]) -> dict[str, float]:
    """What it is worth to choose what is planted, and what to choose something else."""
    known = [r["rivals"] for r in own if r.get("rivals", {}).get("chosen") is not None]
    if not known:
        return {}
    before = float(np.mean([abs(r["before"]) for r in known]))
    chosen = float(np.mean([abs(r["chosen"]) for r in known]))
    found: dict[str, float] = {"known": len(known), "chosen": chosen / before}
    missed = [r for r in known if r["missed"] is not None]
    if missed:
        there = float(np.mean([abs(r["before"]) for r in missed]))
        found["missed"] = float(np.mean([r["missed"] for r in missed])) / there
    return found


def improvement(records: Sequence[Record]) -> dict[str, Mapping[str, float]]:
    """By condition, what an effect in the model changes on readings that neither model used.

    sets         with an effect in the model after, whether its name is settled or not
    rmse, bias   after over before, of predictions against readings without noise: rms over the
                 sets, and of the mean of the bias's sizes
    better       share of the sets whose log score is better after
    inside 95    share of the readings in their 95 % interval after
    forecast     error of the fleet's mean at the horizon after over before, means of its sizes,
                 where the plan has a horizon
    least …      rmse, bias and forecast of the same rotors without the effect, over before: what is
                 left there no effect can take away
    leading, together   where several rivals stand (`open` sets): the same of the blades that they
                 differ in, by the leading rival and by all of them
    chosen, missed   where nothing is claimed and what is planted is among the rivals (`known`
                 sets): the same by the one that has it, and by those that have it not
    """
    found: dict[str, Mapping[str, float]] = {}
    for condition in CONDITIONS:
        every = [r for r in records if r["condition"] == condition]
        if known := _chosen(every):
            found[condition] = known
        own = [r for r in every if "after" in r]
        if not own:
            continue
        sound = all("sound" in r for r in own)
        each = {"rmse": _after(own, "exact_rmse", 2), "bias": _after(own, "exact_bias")}
        if "forecast_error" in own[0]["after"]:
            each["forecast"] = _after(own, "forecast_error")
        held = sum(r["held"] for r in own)
        found[condition] = {
            "sets": len(own),
            **{what: float(ratio[0]) for what, ratio in each.items()},
            "better": sum(r["after"]["log_score"] > r["before"]["log_score"] for r in own)
            / len(own),
            "inside 95": sum(r["held"] * r["after"]["inside_95"] for r in own) / held,
            **({f"least {what}": float(ratio[1]) for what, ratio in each.items()} if sound else {}),
            **known,
        }
        several = [r["rivals"] for r in own if r.get("rivals", {}).get("leading") is not None]
        if several:
            sizes = {k: np.mean([abs(r[k]) for r in several]) for k in FORETOLD}
            ratios = {k: float(sizes[k] / sizes["before"]) for k in FORETOLD[1:]}
            found[condition] = {**found[condition], "open": len(several), **ratios}
    return found
