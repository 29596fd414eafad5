"""What a diagnosis says, and what may be done with it, in sentences for an engineer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from service.report.noticed import blind
from service.report.words import counted, joined, number, p_of, sentence

Json = Mapping[str, Any]
SEVERAL = 6  # names in a sentence
IDLE = 0.02  # nat: an inspection that tells less tells nothing


def verdict(found: Json, rotor: str, units: Mapping[str, str]) -> str:
    """The verdict in one or two sentences."""
    chance = "" if found["p"] is None else f" (p {p_of(found)})"
    if found["verdict"] == "adequate":
        return (
            f"The model explains the {counted(found['readings']['used'], 'reading')} of rotor "
            f"{rotor}: a misfit as large as the largest that was found comes by chance{chance}."
        )
    lacks = f"The model of rotor {rotor} lacks"
    if found["verdict"] == "effect":
        return f"{lacks} {joined(found['names'])}: {_effects(found, units)}"
    if found["verdict"] == "not separable":
        if beside := found.get("beside"):
            open_ = [name for name in found["names"] if name not in beside]
            if len(open_) == 1:
                return (
                    f"{lacks} {joined(beside)}, and something else{chance}: {open_[0]} comes "
                    "nearest to it, with too little of the evidence to be named."
                )
            others = joined(open_, "or")
            return (
                f"{lacks} {joined(beside)}, and something else{chance}, of which its readings "
                f"cannot tell whether it is {others}."
            )
        return (
            f"{lacks} something{chance}, and its readings cannot tell "
            f"which of these it is: {joined(found['names'], 'or')}."
        )
    if several := found.get("several"):
        shown = several if len(several) <= SEVERAL else [*several[:SEVERAL], "others"]
        return (
            f"{lacks} something{chance}, and {len(several)} effects share "
            f"the evidence, none with enough of it to be named: {joined(shown)}. No cause is named."
        )
    if found.get("separating"):  # of a release that did not tell which
        return (
            f"{lacks} something{chance}, and more effects would explain "
            "it than an answer can hold. No cause is named."
        )
    return (
        f"{lacks} something{chance}, and no effect that was tried explains it. No cause is named."
    )


def _effects(found: Json, units: Mapping[str, str]) -> str:
    """What is claimed with sizes, what is in the model beside it, and that nothing is left."""
    sure, open_ = claims(found)
    told = joined([sentence(e, units.get(e["name"]), found["rests_on"]["model"]) for e in sure])
    left = found["p_after"]
    rest = "" if left is None else f" (p of what is left: {number(left, 2)})"
    beside, them = "", "it" if len(sure) == 1 else "them"
    if open_:
        names, are = joined([e["name"] for e in open_]), "is" if len(open_) == 1 else "are"
        beside, them = f" Beside it, {names} {are} in the model, not claimed.", "all of it"
    return (
        f"{told}.{beside} With {them} in the model nothing is left that chance would not "
        f"explain{rest}."
    )


def claims(found: Json) -> tuple[list[Json], list[Json]]:
    """The effects that are claimed, by their name or their cause, and those that are not.

    >>> wear = {"name": "wear", "cause": "loss"}
    >>> [len(part) for part in claims({"names": ["loss"], "effects": [wear, {"name": "rub"}]})]
    [1, 1]
    """
    sure = [e for e in found["effects"] if {e["name"], e.get("cause")} & {*found["names"]}]
    if not sure:  # of a release that did not tell causes
        return list(found["effects"]), []
    return sure, [e for e in found["effects"] if e not in sure]


def do_next(found: Json) -> str:
    """What an engineer may do with the verdict."""
    return {
        "adequate": _enough(found),
        "effect": f"Check the cause on the machine or the instrument. {_better(found)}",
        "not separable": f"Do not act on one of the names alone.{_apart(found)}",
        "unattributed": "Look at the residuals below: they show where the misfit is. Bands of the "
        "model are too narrow there, and forecasts may be biased." + _many(found) + _wider(found),
    }[found["verdict"]]


def _enough(found: Json) -> str:
    """What an absence is worth."""
    if blind(found):
        return (
            "Do not rest anything on this: readings as few as these could not have contradicted "
            "the model. Read more of the blades, or read them again, then ask anew."
        )
    return "Nothing has to be done: forecasts and bands of the model can be used."


def _better(found: Json) -> str:
    """Which forecasts to use, as far as readings that neither model used tell."""
    compared = found["before_after"]
    if compared is None:
        return "Forecasts of the model as it was are without it."
    gains = [
        sign * (compared["after"][score] - compared["before"][score]) > 0
        for score, sign in (("rmse", -1), ("log_score", 1))
        if None not in (compared["before"][score], compared["after"][score])
    ]
    if gains and not any(gains):
        return (
            "On the readings below, which neither model used, the model with the effect is not the "
            "better one: look at them before you use its forecasts."
        )
    if not all(gains):
        nearer, other = ("RMSE", "log score") if gains[0] else ("log score", "RMSE")
        return (
            "On the readings below, which neither model used, the model with the effect is better "
            f"by its {nearer} and not by its {other}: look at them before you use its forecasts."
        )
    return (
        "Forecasts of the model as it was have the errors shown below; those with the effect in it "
        "are the better ones."
    )


def _apart(found: Json) -> str:
    """That inspections would tell rivals apart, where one of them or a campaign does."""
    told = found.get("separating") or {}
    ways = [*told.get("single", ())[:1], *told.get("campaigns", ())[:1]]
    if not any(one["gain_nat"] >= IDLE for one in ways):
        return ""
    return " The inspections below would tell them apart."


def _many(found: Json) -> str:
    """Where no cause of several can be named, and what would tell them apart is known."""
    if not found.get("separating"):
        return ""
    apart = _apart(found).removesuffix(".").replace(" The", "; the")
    return f" Several causes would explain it{apart}."


def _wider(found: Json) -> str:
    """Where a discrepancy without a name widens the bands."""
    wide = found.get("widened")
    if not wide or not wide["borne_out"]:
        return ""
    before, after = (number(wide["sd"][w], 3) for w in ("before", "after"))
    told = (found.get("pictures") or {}).get("courses") or {}
    unit = f" {told['unit']}" if told.get("quantity") == wide["quantity"] else ""
    return (
        f" With a discrepancy of {wide['quantity']} that names no cause the sd of a forecast at "
        f"{number(wide['time_h'])} h is {after}{unit} instead of {before}{unit}; it can be adopted."
    )
