"""Effects in words for an engineer: sentences, numbers with units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

Json = Mapping[str, Any]
LARGE = 1e7  # from which on a power of ten says more than digits
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


def p_of(found: Json) -> str:
    """The p-value of a model as it was; the least that so few dealt sets can tell is a bound.

    >>> p_of({"p": 1 / 401, "dealt": 400}), p_of({"p": 2 / 401, "dealt": 400})
    ('≤ 0.0025', '= 0.005')
    >>> p_of({"p": 1 / 401})  # of a release that did not tell how many there were
    '= 0.0025'
    """
    p, dealt = found["p"], found.get("dealt")
    least = dealt is not None and p * (dealt + 1) < 1.5
    return f"{'≤' if least else '='} {number(p, 2)}"


def with_sd(value: float | None, sd: float | None) -> str:
    """A value to the digits that its sd leaves, ± the sd with two of its own.

    >>> with_sd(0.0193412, 0.00372), with_sd(123.4, 20.0), with_sd(None, 1.0)
    ('0.0193 ± 0.0037', '123 ± 20', '–')
    >>> with_sd(-0.04, 1.1)  # no −0.0
    '0.0 ± 1.1'
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
    return f"{value:z,.{places}f} ± {sd:,.{places}f}".replace("-", "−")


def percent(share: float) -> str:
    """A chance, to whole percents in the middle and to tenths at both ends.

    >>> percent(0.0312), percent(0.634), percent(0.0042), percent(0.9958)
    ('3 %', '63 %', '0.4 %', '99.6 %')
    >>> percent(1e-9), percent(0.0), percent(1.0)
    ('< 0.1 %', '< 0.1 %', '> 99.9 %')
    """
    if not 0.001 <= share <= 0.999:
        return "< 0.1 %" if share < 0.5 else "> 99.9 %"
    return f"{100 * share:.{0 if 0.0095 <= share <= 0.9905 else 1}f} %"


def joined(names: Sequence[str], last: str = "and") -> str:
    """Names as a sentence has them.

    >>> joined(["a", "b", "c"], "or")
    'a, b or c'
    """
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def counted(count: int, what: str) -> str:
    """A number of things, of which one is said in the singular.

    >>> counted(1, "blade"), counted(1200, "reading")
    ('1 blade', '1,200 readings')
    """
    return f"{count:,} {what}{'s' * (count != 1)}"


def unit_of(effect: Json, unit: str | None, model: str) -> tuple[float, str]:
    """What an amplitude is multiplied by, and the unit that engineers use for it; "": none."""
    if effect["how"] == "times":
        return 100.0, "%"
    shown = "" if unit in (None, "1") else str(unit)
    if model.startswith("rotor-blade") and on_input(effect):
        return BLADE_INPUTS.get(effect["target"], ("", 1.0, shown))[1:]
    return 1.0, shown


def size(effect: Json, unit: str | None, model: str) -> tuple[float, float, str]:
    """An effect's amplitude and sd with its sign, in a unit that engineers use."""
    told = effect["amplitude"]
    sign = -1.0 if str(told.get("of", "")).startswith("lost ") else 1.0
    scale, shown = unit_of(effect, unit, model)
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
        there = effect["clock"] == "event" and effect["value"] is None
        then = ", in the blades that were there" if there else ""
        return f"from about {number(effect['step_h'])} h of the {clock} on{then}"
    if shape == "constant":
        return "always by the same" if effect["kind"] == "sensor" else "from the first hour on"
    pace = {"early": "faster at first", "linear": "evenly", "late": "faster towards the end"}
    by = number(effect.get("reference_h") or 50_000.0)  # as older ones have it
    return f"by {by} h of the {clock}, {pace.get(shape, shape)}"


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
    what = effect["target"].replace("_", " ")
    if effect["kind"] != "sensor" and effect["whom"] not in ("instrument", "campaign"):
        # the blade itself: what reads it is right
        more = "more" if value >= 0 else "less"
        return f"{what} {whom(effect)} is {how_much} {more} than the model had it, {when(effect)}"
    direction = "too much" if value >= 0 else "too little"
    return f"readings of {what} {whom(effect)} say {how_much} {direction}, {when(effect)}"


def capital(said: str) -> str:
    """With a capital letter; names inside stay as they are.

    >>> capital("readings of LE-2")
    'Readings of LE-2'
    """
    return said[:1].upper() + said[1:]
