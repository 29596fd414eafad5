"""What a diagnosis says, in words for an engineer: sentences, numbers with units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

Json = Mapping[str, Any]
LARGE = 1e7  # from which on a power of ten says more than digits
SEVERAL = 6  # names in a sentence
BLADE_INPUTS: dict[str, tuple[str, float, str]] = {
    "tbc_thickness": ("coating thickness over nominal", 1.0, ""),
    "t1t_rate": ("gas temperature", 600.0, "K"),
    "creep_transient": ("primary creep", 1.0, "sd of the material"),
    "creep_steady": ("secondary creep", 1.0, "sd of the material"),
    "cooling_flow": ("coolant flow over nominal", 1.0, ""),
    "tertiary": ("acceleration of creep with its damage", 1.0, ""),
    "gas_profile_peak": ("span fraction where the gas is hottest", 1.0, ""),
    "wall_loss": ("lost share of the wall", 1.0, ""),
}
"""Inputs of the built-in blade: words, and the size of one unit in a unit that engineers use."""


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many digits, a true minus, and no exponent where one can do without.

    >>> number(-0.01234), number(24000.0), number(None), number(1.2e-7)
    ('−0.0123', '24,000', '–', '1.2e−07')
    >>> number(0.25), number(0.005, 2), number(100.0)
    ('0.25', '0.005', '100')
    """
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < LARGE:
        return f"{value:.{digits}g}".replace("e+", "e").replace("-", "−")
    shown = round(value, digits - 1 - math.floor(math.log10(abs(value))))
    places = max(0, digits - 1 - math.floor(math.log10(abs(shown))))
    told = f"{shown:,.{places}f}"
    told = told.rstrip("0").rstrip(".") if "." in told else told
    return told.replace("-", "−")


def with_sd(value: float | None, sd: float | None) -> str:
    """A value to the digits that its sd leaves, ± the sd with two of its own.

    >>> with_sd(0.0193412, 0.00372), with_sd(123.4, 20.0), with_sd(None, 1.0)
    ('0.0193 ± 0.0037', '123 ± 20', '–')
    >>> with_sd(2.25e26, 6.2e25)
    '2.25e26 ± 6.2e25'
    """
    if value is None or sd is None:
        return "–"
    if not (math.isfinite(value) and math.isfinite(sd) and sd > 0):
        return number(value)
    if max(abs(value), sd) >= LARGE:
        return f"{number(value)} ± {number(sd, 2)}"
    places = max(0, 1 - math.floor(math.log10(sd)))
    return f"{value:,.{places}f} ± {sd:,.{places}f}".replace("-", "−")


def joined(names: Sequence[str], last: str = "and") -> str:
    """Names as a sentence has them.

    >>> joined(["a", "b", "c"], "or")
    'a, b or c'
    """
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def size(effect: Json, unit: str | None, model: str) -> tuple[float, float, str]:
    """An effect's amplitude and sd with its sign, in a unit that engineers use."""
    told = effect["amplitude"]
    sign = -1.0 if str(told.get("of", "")).startswith("lost ") else 1.0
    scale, shown = 1.0, "" if unit in (None, "1") else str(unit)
    if effect["how"] == "times":
        scale, shown = 100.0, "%"
    elif model.startswith("rotor-blade") and on_input(effect):
        _, scale, shown = BLADE_INPUTS.get(effect["target"], ("", 1.0, shown))
    mean, sd = (math.nan if told[k] is None else scale * told[k] for k in ("mean", "sd"))
    return sign * mean, sd, shown


def on_input(effect: Json) -> bool:
    """Whether it moves an input of the model; else it moves readings."""
    return bool(effect.get("on", "input" if effect["kind"] != "sensor" else "reading") == "input")


def whom(effect: Json) -> str:
    """Whom an effect concerns."""
    value = effect["value"]
    if value is None:
        return "of all blades"
    return {
        "lot": f"of the blades of lot {value}",
        "coating_lot": f"of the blades of coating lot {value}",
        "blade": f"of blade {value}",
        "instrument": f"taken by instrument {value}",
        "campaign": f"taken in campaign {value}",
    }.get(effect["whom"], f"of {effect['whom']} {value}")


def when(effect: Json) -> str:
    """How an effect runs in time."""
    clock = "blade" if effect["clock"] == "blade" else "rotor"
    shape = effect["shape"]
    if shape == "step":
        then = ", in the blades that were there" if effect["clock"] == "event" else ""
        return f"from about {number(effect['step_h'])} h of the {clock} on{then}"
    if shape == "constant":
        return "from the first hour on" if on_input(effect) else "always by the same"
    pace = {"early": "faster at first", "linear": "evenly", "late": "faster towards the end"}
    return f"by 50,000 h of the {clock}, {pace.get(shape, shape)}"


def sentence(effect: Json, unit: str | None, model: str) -> str:
    """What happens, by how much ± sd, to whom and when."""
    value, sd, shown = size(effect, unit, model)
    how_much = f"{with_sd(abs(value), sd)} {shown}".strip()
    if on_input(effect):
        name = effect["target"].replace("_", " ")
        if model.startswith("rotor-blade"):
            name = BLADE_INPUTS.get(effect["target"], (name, 1.0, ""))[0]
        direction = "higher" if value >= 0 else "lower"
        return f"{name} {whom(effect)} is {how_much} {direction}, {when(effect)}"
    direction = "too much" if value >= 0 else "too little"
    what = effect["target"].replace("_", " ")
    return f"readings of {what} {whom(effect)} say {how_much} {direction}, {when(effect)}"


def capital(said: str) -> str:
    """With a capital letter; names inside stay as they are.

    >>> capital("readings of LE-2")
    'Readings of LE-2'
    """
    return said[:1].upper() + said[1:]


def verdict(found: Json, rotor: str, units: Mapping[str, str]) -> str:
    """The verdict in one or two sentences."""
    count, p = found["readings"]["used"], found["p"]
    chance = "" if p is None else f" (p = {number(p, 2)})"
    if found["verdict"] == "adequate":
        return (
            f"The model explains the {count} readings of rotor {rotor}: a misfit as large as the "
            f"largest that was found comes by chance{chance}."
        )
    if found["verdict"] == "effect":
        model = found["rests_on"]["model"]
        told = joined([sentence(e, units.get(e["name"]), model) for e in found["effects"]])
        left = found["p_after"]
        rest = "" if left is None else f" (p of what is left: {number(left, 2)})"
        return (
            f"The model of rotor {rotor} lacks {joined(found['names'])}: {told}. With it in the "
            f"model nothing is left that chance would not explain{rest}."
        )
    if found["verdict"] == "not separable":
        return (
            f"The model of rotor {rotor} lacks something{chance}, and its readings cannot tell "
            f"which of these it is: {joined(found['names'], 'or')}."
        )
    if several := found.get("several"):
        shown = several if len(several) <= SEVERAL else [*several[:SEVERAL], "others"]
        return (
            f"The model of rotor {rotor} lacks something{chance}, and {len(several)} effects share "
            f"the evidence, none with enough of it to be named: {joined(shown)}. No cause is named."
        )
    if found.get("separating"):  # of a release that did not tell which
        return (
            f"The model of rotor {rotor} lacks something{chance}, and more effects would explain "
            "it than an answer can hold. No cause is named."
        )
    return (
        f"The model of rotor {rotor} lacks something{chance}, and no effect that was tried "
        f"explains it. No cause is named."
    )


def do_next(found: Json) -> str:
    """What an engineer may do with the verdict."""
    return {
        "adequate": "Nothing has to be done: forecasts and bands of the model can be used.",
        "effect": "Check the cause on the machine or the instrument. Forecasts of the model as it "
        "was have the errors shown below; those with the effect in it are the better ones.",
        "not separable": "Do not act on one of the names alone. The inspections below would tell "
        "them apart.",
        "unattributed": "Look at the residuals below: they show where the misfit is. Bands of the "
        "model are too narrow there, and forecasts may be biased." + _many(found) + _wider(found),
    }[found["verdict"]]


def _many(found: Json) -> str:
    """Where no cause of several can be named, and what would tell them apart is known."""
    if not found.get("separating"):
        return ""
    return " Several causes would explain it; the inspections below would tell them apart."


def _wider(found: Json) -> str:
    """Where a discrepancy without a name widens the bands."""
    wide = found.get("widened")
    if not wide or not wide["borne_out"]:
        return ""
    before, after = (number(wide["sd"][w], 3) for w in ("before", "after"))
    return (
        f" With a discrepancy of {wide['quantity']} that names no cause the sd of a forecast at "
        f"{number(wide['time_h'])} h is {after} instead of {before}; it can be adopted."
    )
