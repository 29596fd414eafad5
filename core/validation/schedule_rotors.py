"""Rotors of the schedule study: simulated ones, with or without a discrepancy, and the shipped one.

Drawn from the priors (`core.validation.simulate`), or read from the shipped inspection plan. A
discrepancy of the elongation has its theta drawn from their priors, too, and is added to readings
that were made without one: the same rotor and noise with and without it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from core.builtin import inspection_plan
from core.builtin.inspection_plan import Plan
from core.calibration.responses import DEGREE
from core.calibration.space import locals_of
from core.discrepancy import parameters
from core.model import Model
from core.network import Discrepancy
from core.observation import Inspection
from core.rng import stream
from core.validation.simulate import Held, Simulated, simulate, wrong
from core.validation.variants import Variant, hours, model_of

Kind = Literal["none", "constant", "paper"]
READ = "elongation"
DISCREPANCIES: Mapping[Kind, Discrepancy] = {
    "none": Discrepancy(),
    "constant": Discrepancy("constant", sd=0.05),
    "paper": Discrepancy("paper", sd=0.05),
}


def model_with(kind: Kind) -> Model:
    """The built-in model with a discrepancy of the elongation."""
    return model_of(Variant(kind, wrong=((READ, DISCREPANCIES[kind]),)))


def drawn(model: Model, variant: Variant, rotor: int, seed: int) -> Simulated:
    """A simulated rotor whose readings name their outage, which a replaced blade's hours hide."""
    made = simulate(model, variant, rotor, seed)
    outage = {
        (blade, own): f"outage-{k + 1}"
        for k, rotor_h in enumerate(variant.outages_h)
        for blade, own in hours(variant, rotor_h).items()
    }
    named = [replace(r, campaign=outage[r.blade, r.time_h]) for r in made.readings]
    return replace(made, readings=tuple(named))


def with_delta(model: Model, made: Simulated, rotor: int, seed: int) -> Simulated:
    """The rotor with the model's discrepancy, theta drawn from their priors, in its elongations."""
    quantity = model.network.quantity(READ)
    rng = stream(seed, "schedule", quantity.discrepancy.kind, rotor)
    theta = {n: float(p.quantile(rng.random(1))[0]) for n, p in parameters(model, quantity).items()}
    shared = made.shared | theta

    def delta(blade: str, time_h: float) -> float:
        at = {**shared, **made.local[blade]}
        x = np.array([[at[name] for name in model.input_names]])
        row = model.part(READ).response(READ, np.array([time_h]), None, degree=DEGREE)
        gain, offset, _ = wrong(model, READ, time_h, shared, 0.0)
        return (gain - 1.0) * float(row.evaluate(x)[0][0, 0]) + offset

    return replace(
        made,
        shared=shared,
        readings=tuple(
            replace(r, values=r.values + delta(r.blade, r.time_h)) if r.quantity == READ else r
            for r in made.readings
        ),
        held=tuple(
            replace(h, reading=h.reading + delta(h.blade, h.time_h)) if h.quantity == READ else h
            for h in made.held
        ),
    )


def plan_readings(plan: Plan, blades: Iterable[str]) -> list[Inspection]:
    """The shipped plan's readings of these blades."""
    wanted = set(blades)
    return [
        Inspection(
            body["id"],
            body["blade"],
            body["quantity"],
            body["time_h"],
            np.array(body["values"] if "values" in body else [body["value"]]),
            np.array(body["nodes"]) if "nodes" in body else None,
            unit=body["unit"],
            campaign=body["campaign"],
        )
        for body in plan.inspections
        if body["blade"] in wanted
    ]


def shipped(model: Model) -> Simulated:
    """The shipped inspection plan as a rotor; its truth is finite elements."""
    found, names = inspection_plan.load(), inspection_plan.blades()
    shared = {"t1t_rate": inspection_plan.T1T_RATE}
    shared |= {f"sigma_obs.{q}": sd for q, sd in inspection_plan.NOISE.items()}
    local = {
        b: {p.name: float(x[model.input_names.index(p.name)]) for p in locals_of(model)}
        for b, x in zip(names, found.inputs, strict=True)
    }
    held = tuple(Held(b, READ, t, y, np.nan, np.nan) for b, (t, y) in found.held_out.items())
    return Simulated(shared, local, tuple(plan_readings(found, names)), held, 0)
