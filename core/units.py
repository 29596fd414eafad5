"""Units of quantities: whether a text is one, of what, and by which factor two of them differ.

A unit is a product of powers, in the spellings that engineers type::

    mm   MPa   1/h   W/(m2 K)   kg m^2 s^-2   m2*K/W   %   degC

Factors stand side by side or with ``*`` or ``·``; what follows ``/`` (one name, or a bracket) is
divided by; a power is ``^2``, ``**2``, ``²`` or the digit alone. Each becomes its seven exponents
and a factor, value[SI] = factor · value + offset; offsets have degC and degF, by themselves.
Angles, strains and shares have no dimension. Prefixes go with the units that take them, so that
``Pa`` is no peta-ampere and ``min`` no milli-inch. A year has 365.25 days, as in UCUM
(mm/yr); of instants it is refused (`hours`).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache

from core.errors import UnitError

BASE = ("m", "kg", "s", "K", "A", "mol", "cd")
PREFIXES = {
    "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "h": 1e2,
    "k": 1e3, "M": 1e6, "G": 1e9,
}  # fmt: skip
_M, _KG, _S, _K = (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)
_PA, _J, _W = (-1, 1, -2, 0), (2, 1, -2, 0), (2, 1, -3, 0)
YEARS = ("yr", "year", "years", "a")  # of 365.25 days, as in UCUM: 8,766 h
# name: (factor, exponents of m, kg, s, K), with prefixes
PREFIXED = {
    "m": (1.0, _M), "g": (1e-3, _KG), "s": (1.0, _S), "K": (1.0, _K), "Pa": (1.0, _PA),
    "N": (1.0, (1, 1, -2, 0)), "J": (1.0, _J), "W": (1.0, _W), "Hz": (1.0, (0, 0, -1, 0)),
    "bar": (1e5, _PA), "l": (1e-3, (3, 0, 0, 0)), "L": (1e-3, (3, 0, 0, 0)),
    "rad": (1.0, (0, 0, 0, 0)), "t": (1e3, _KG),
}  # fmt: skip
PLAIN = {
    "1": (1.0, (0, 0, 0, 0)), "%": (1e-2, (0, 0, 0, 0)), "ppm": (1e-6, (0, 0, 0, 0)),
    "deg": (math.pi / 180, (0, 0, 0, 0)), "°": (math.pi / 180, (0, 0, 0, 0)),
    **dict.fromkeys(("sec", "second", "seconds"), (1.0, _S)),
    **dict.fromkeys(("min", "minute", "minutes"), (60.0, _S)),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), (3600.0, _S)), "kh": (3.6e6, _S),
    **dict.fromkeys(("d", "day", "days"), (86_400.0, _S)),
    **dict.fromkeys(("wk", "week", "weeks"), (7 * 86_400.0, _S)),
    **dict.fromkeys(YEARS, (365.25 * 86_400.0, _S)),
    "in": (0.0254, _M), "ft": (0.3048, _M), "psi": (6894.757293168, _PA),
    "ksi": (6894757.293168, _PA), "atm": (101_325.0, _PA), "lb": (0.45359237, _KG),
    "rpm": (1.0 / 60.0, (0, 0, -1, 0)),
}  # fmt: skip
ELECTRIC = {"A": (4, 1.0), "mol": (5, 1.0), "cd": (6, 1.0)}
OFFSETS = {
    "degC": (1.0, 273.15), "°C": (1.0, 273.15), "degF": (5.0 / 9.0, 459.67 * 5.0 / 9.0),
}  # fmt: skip
_TOKEN = re.compile(r"\s*(?:(\*\*|\^)|([·*/()])|([+-]?\d+)|([^\s·*/()^0-9+\-²³⁻¹]+)|([²³⁻¹]+))")
_POWER = re.compile(r"\s*[+-]?\d")
_RAISED = str.maketrans("²³⁻¹", "23-1")
MOST = 200  # letters of a unit
REMEDY = "write it like mm, MPa, 1/h, W/(m2 K), kg m^2 s^-2, % or degC; 1 where there is none"


@dataclass(frozen=True, slots=True)
class Unit:
    """value[SI] = factor · value + offset; exponents of m, kg, s, K, A, mol, cd."""

    factor: float
    exponents: tuple[int, ...]
    offset: float = 0.0


@lru_cache(maxsize=512)
def unit(text: str) -> Unit:
    """A unit by its text; UnitError where it is none.

    >>> unit("W/(m2 K)") == unit("W m^-2 K^-1"), unit("%").factor, unit("kN").exponents[:3]
    (True, 0.01, (1, 1, -2))
    """
    if len(text) > MOST:
        raise _none(f"{text[:MOST]}…")
    if text.strip() in OFFSETS:
        factor, offset = OFFSETS[text.strip()]
        return Unit(factor, (0, 0, 0, 1, 0, 0, 0), offset)
    tokens = _tokens(text)
    found, left = _product(text, tokens, 0)
    if left != len(tokens):
        raise _none(text)
    return found


def ratio(given: str, wanted: str) -> tuple[float, float]:
    """(a, b) with value[wanted] = a · value[given] + b; UnitError where they measure other things.

    >>> ratio("m", "mm"), ratio("degC", "K"), ratio("1/h", "1/d")
    ((1000.0, 0.0), (1.0, 273.15), (24.0, 0.0))
    """
    one, other = unit(given), unit(wanted)
    if one.exponents != other.exponents:
        problem = f"is a unit of {_shown(one)}, not of {_shown(other)} as {wanted!r} is"
        raise UnitError("unit", given, problem, f"give the values in {wanted!r}")
    if (counts(given), counts(wanted)) in ((True, False), (False, True)):
        problem = f"counts turns where {wanted!r} counts angles, or the other way: 2 π apart"
        raise UnitError("unit", given, problem, f"give the values in {wanted!r}")
    a = one.factor / other.factor
    b = (one.offset - other.offset) / other.factor
    near = float(f"{a:.12g}")
    return near, float(f"{b:.12g}")


def counts(text: str) -> bool | None:
    """Whether a rate counts turns (rpm, Hz) or angles (rad/s); None: neither.

    >>> counts("rpm"), counts("kHz"), counts("rad/s"), counts("1/s")
    (True, True, False, None)
    """
    words = re.findall(r"[^\W\d_]+|°", text)
    if any(word == "rpm" or word.endswith("Hz") for word in words):
        return True
    return False if any(word.endswith("rad") or word in ("deg", "°") for word in words) else None


def hours(text: str) -> float:
    """How many hours a unit of time has, of instants; UnitError where it is none, or not told.

    A year of operation is what a plant makes it: instants in years are not taken for calendar ones.

    >>> hours("d"), hours("kh")
    (24.0, 1000.0)
    >>> try:
    ...     hours("yr")
    ... except UnitError as error:
    ...     print(error.problem)
    does not say how many hours: 8,760 or 8,766 of the calendar, fewer of a plant
    """
    factor = ratio(text, "h")[0]
    if any(word in YEARS for word in re.findall(r"[^\W\d_]+", text)):
        problem = "does not say how many hours: 8,760 or 8,766 of the calendar, fewer of a plant"
        raise UnitError("unit", text, problem, "give operating hours")
    return factor


def _shown(found: Unit) -> str:
    names = zip(BASE, found.exponents, strict=True)
    text = " ".join(n if p == 1 else f"{n}^{p}" for n, p in names if p)
    return text or "a number"


def _none(text: str) -> UnitError:
    return UnitError("unit", text, "is no unit that is known", REMEDY)


def _tokens(text: str) -> list[str]:
    tokens, at, text = [], 0, text.strip()
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise _none(text)
        power, sign, number, name, raised = match.groups()
        if raised:
            tokens.append(raised.translate(_RAISED))
        elif not power:
            tokens.append(sign or number or name)
        elif not tokens or _POWER.match(text, match.end()) is None:
            raise _none(text)
        at = match.end()
    if not tokens:
        raise _none(text)
    return tokens


def _is_number(token: str) -> bool:
    return token.lstrip("+-").isdigit()


def _product(text: str, tokens: list[str], at: int) -> tuple[Unit, int]:
    """Factors up to a closing bracket or the end."""
    whole, divided, first = Unit(1.0, (0,) * 7), False, True
    while at < len(tokens) and tokens[at] != ")":
        token = tokens[at]
        if token in "*·/":
            if first or divided:
                raise _none(text)
            divided, at = token == "/", at + 1
            if at == len(tokens):
                raise _none(text)
            continue
        if token == "(":
            one, at = _product(text, tokens, at + 1)
            if at == len(tokens):
                raise _none(text)
            at += 1
        else:
            one, at = _named(text, token), at + 1
        power = 1
        if at < len(tokens) and _is_number(tokens[at]):
            power, at = int(tokens[at]), at + 1
        power = -power if divided else power
        if abs(power) > 9:
            raise _none(text)
        exponents = tuple(
            p + power * q for p, q in zip(whole.exponents, one.exponents, strict=True)
        )
        whole = Unit(whole.factor * one.factor**power, exponents)
        divided = first = False
    if first or divided:
        raise _none(text)
    return whole, at


def _named(text: str, name: str) -> Unit:
    if name in PLAIN:
        factor, four = PLAIN[name]
        return Unit(factor, (*four, 0, 0, 0))
    if name in OFFSETS:  # a difference of temperatures, inside a product
        return Unit(OFFSETS[name][0], (0, 0, 0, 1, 0, 0, 0))
    for prefix, scale in (("", 1.0), *PREFIXES.items()):
        rest = name[len(prefix) :]
        if not name.startswith(prefix):
            continue
        if rest in PREFIXED:
            factor, four = PREFIXED[rest]
            return Unit(scale * factor, (*four, 0, 0, 0))
        if rest in ELECTRIC:
            place, factor = ELECTRIC[rest]
            return Unit(scale * factor, tuple(int(k == place) for k in range(7)))
    raise _none(text)
