"""A network as a user writes it, in YAML or JSON, and every fault of it.

The keys are those of `core.network.Network.to_json`::

    name: heat-exchanger
    parameters:
      - {name: roughness, level: local, unit: um, prior: {kind: uniform, low: 1, high: 9}}
      - {name: flow, level: shared, unit: kg/s, prior: {kind: uniform, low: 2, high: 6}}
    quantities:
      - {name: drop, unit: kPa, kind: scalar, low: -5, high: 200,
         sigma_obs: {kind: log_uniform, low: 0.05, high: 2}}

How YAML is read: `service.plain_yaml`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from core.errors import FaultsError, InputError
from core.network import Network, Parameter
from service.names import ID_LENGTH, ID_PATTERN
from service.plain_yaml import UNREADABLE, PlainReader
from service.ports import Json

MOST_BYTES = 2**17  # pure Python reads some 25 kB of YAML a second on a slow processor
MOST_NAMED = 1000  # parameters, quantities, or keys of one mapping
PRIOR = {"kind": str, "low": float, "high": float, "mean": float, "sd": float}
PARAMETER = {
    "name": str, "level": str, "prior": dict, "unit": str, "symbol": str, "nominal": float,
    "population": dict,
}  # fmt: skip
QUANTITY = {
    "name": str, "unit": str, "kind": str, "sigma_obs": dict, "low": float, "high": float,
    "node": str, "numerical": float, "level": int, "discrepancy": dict, "by_instrument": bool,
}  # fmt: skip
NETWORK = {
    "schema": int, "name": str, "parameters": list, "quantities": list, "notes": dict,
    "forgetting_h": float, "drifts": list, "biases": list, "families": list,
}  # fmt: skip
NEEDED = {
    "network": ("name", "parameters", "quantities"),
    "parameter": ("name", "level", "prior"),
    "quantity": ("name", "unit", "kind", "sigma_obs", "low", "high"),
    "prior": ("kind", "low", "high"),
}
SAID = {str: "a text", float: "a finite number", int: "a whole number", bool: "true or false",
        dict: "a mapping", list: "a list"}  # fmt: skip
KINDS = ("scalar", "field", "vector")


def read_network(text: str | bytes, where: str = "network") -> Network:
    """The network that a text declares; FaultsError lists every fault under the names in it.

    >>> read_network("{name: n, parameters: [], quantities: []}")
    Traceback (most recent call last):
    core.errors.FaultsError: network.parameters = [] is empty. To mend it: declare at least one.; \
network.quantities = [] is empty. To mend it: declare at least one.
    """
    if len(text) > MOST_BYTES:
        remedy = f"write one of {MOST_BYTES} bytes at most"
        raise FaultsError([InputError(where, f"{len(text)} bytes", "is too long", remedy)])
    try:
        told = yaml.load(text, Loader=PlainReader)
    except UNREADABLE as error:
        said = " ".join(str(error).split())[:300]
        problem = f"is neither YAML nor JSON: {said}"
        raise FaultsError([InputError(where, "…", problem, "correct it there")]) from None
    return network_of(told, where)


def read_file(path: Path) -> Network:
    """The network of a file; FaultsError as of `read_network`."""
    try:
        return read_network(path.read_bytes(), path.name)
    except OSError as error:
        remedy = "give a file in YAML or JSON"
        raise InputError(
            "network", str(path), f"cannot be read: {error.strerror}", remedy
        ) from None


def network_of(told: object, where: str = "network") -> Network:
    """The network that plain data declare."""
    faults: list[InputError] = []
    if not isinstance(told, Mapping):
        problem = "is no mapping with name, parameters and quantities"
        remedy = "see `Your own runs` in core/README.md"
        raise FaultsError([InputError(where, _short(told), problem, remedy)])
    for name in ("parameters", "quantities"):
        if (count := len(_list(told, name))) > MOST_NAMED:
            remedy = f"declare {MOST_NAMED} at most"
            raise FaultsError([InputError(f"{where}.{name}", count, "are too many", remedy)])
    _keys(told, NETWORK, where, "network", faults)
    for name in ("notes", "drifts", "biases", "families"):
        _finite(told.get(name), f"{where}.{name}", faults)
    for i, one in enumerate(_list(told, "parameters")):
        at = f"{where}.parameters[{i}]"
        if _keys(one, PARAMETER, at, "parameter", faults):
            _name(one, at, faults)
            _prior(one, "prior", at, faults)
            _finite(one.get("population"), f"{at}.population", faults)
    for i, one in enumerate(_list(told, "quantities")):
        at = f"{where}.quantities[{i}]"
        if _keys(one, QUANTITY, at, "quantity", faults):
            _name(one, at, faults)
            _prior(one, "sigma_obs", at, faults)
            _finite(one.get("discrepancy"), f"{at}.discrepancy", faults)
            if isinstance(one.get("kind"), str) and one["kind"] not in KINDS:
                remedy = f"use one of {', '.join(KINDS)}"
                faults.append(InputError(f"{at}.kind", one["kind"], "is not known", remedy))
            low, high = one.get("low"), one.get("high")
            if _is(low, float) and _is(high, float) and not low < high:
                remedy = "give the range that a reading may have, low < high"
                problem = "is no range"
                faults.append(InputError(f"{at}.low, high", f"{low} … {high}", problem, remedy))
    for name in ("parameters", "quantities"):
        if told.get(name) == []:
            faults.append(InputError(f"{where}.{name}", [], "is empty", "declare at least one"))
    if faults:
        raise FaultsError(faults)
    try:
        network = Network.from_json(_floats(dict(told)))
    except InputError as error:
        named = type(error)(f"{where}: {error.what}", error.value, error.problem, error.remedy)
        raise FaultsError([named]) from None
    for i, p in enumerate(network.parameters):
        faults += _uncalibrated(p, f"{where}.parameters[{i}]")
    if faults:
        raise FaultsError(faults)
    return network


def _uncalibrated(p: Parameter, where: str) -> Iterator[InputError]:
    """What a model could be trained with, and no rotor calibrated."""
    low, high = p.prior.low, p.prior.high
    if p.level in ("local", "shared") and p.prior.log_scale:
        remedy = "give the runs its logarithm as the input and declare that, uniform"
        problem = "cannot be calibrated as an input"
        yield InputError(f"{where}.prior.kind", p.prior.kind, problem, remedy)
    still = p.level in ("known", "dormant") and p.nominal is not None
    if still and not low <= (p.nominal or 0.0) <= high:
        problem = f"lies outside {low:g} … {high:g}, which the runs cover"
        yield InputError(f"{where}.nominal", p.nominal, problem, "give a value inside")


def _list(told: Mapping[str, Any], name: str) -> list[Any]:
    found = told.get(name)
    return found if isinstance(found, list) else []


def _keys(
    told: object, known: Mapping[str, type], where: str, what: str, faults: list[InputError]
) -> bool:
    """Unknown, missing and ill-typed keys of a mapping; whether it is one."""
    if not isinstance(told, Mapping):
        faults.append(InputError(where, _short(told), "is no mapping", f"give {', '.join(known)}"))
        return False
    if len(told) > MOST_NAMED:
        remedy = f"use {', '.join(known)}"
        faults.append(InputError(where, f"{len(told)} keys", "are too many", remedy))
        return False
    for key in told:
        if key not in known:
            remedy = f"use {', '.join(known)}"
            faults.append(InputError(f"{where}.{key}", _short(told[key]), "is not known", remedy))
    for key, kind in known.items():
        value = told.get(key)
        if value is None:
            if key in NEEDED[what]:
                faults.append(InputError(f"{where}.{key}", None, "is missing", "give it"))
        elif not _is(value, kind):
            remedy = f"give {SAID[kind]}" + (", in quotes" if kind is str else "")
            problem = f"is not {SAID[kind]}"
            faults.append(InputError(f"{where}.{key}", _short(value), problem, remedy))
    return True


def _is(value: object, kind: type) -> bool:
    if kind is float:
        whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**63
        return whole or (isinstance(value, float) and math.isfinite(value))
    return isinstance(value, kind) and not (kind is int and isinstance(value, bool))


def _finite(value: object, where: str, faults: list[InputError]) -> None:
    """Numbers below a key whose own keys are checked elsewhere."""
    if isinstance(value, Mapping):
        for key, one in value.items():
            _finite(one, f"{where}.{key}", faults)
    elif isinstance(value, list):
        for i, one in enumerate(value):
            _finite(one, f"{where}[{i}]", faults)
    elif isinstance(value, float) and not math.isfinite(value) and len(faults) <= MOST_NAMED:
        remedy = "give a finite number, or leave it out"
        faults.append(InputError(where, value, "is not a finite number", remedy))


def _name(told: Mapping[str, Any], where: str, faults: list[InputError]) -> None:
    """Names that readings and addresses carry, so they are held against what these may."""
    name = told.get("name")
    if isinstance(name, str) and not (len(name) <= ID_LENGTH and re.fullmatch(ID_PATTERN, name)):
        remedy = f"use letters, digits and . _ : @ + -, no space, {ID_LENGTH} at most"
        faults.append(InputError(f"{where}.name", _short(name), "is no name", remedy))


def _prior(told: Mapping[str, Any], key: str, where: str, faults: list[InputError]) -> None:
    if key in told and isinstance(told[key], Mapping):
        _keys(told[key], PRIOR, f"{where}.{key}", "prior", faults)


def _floats(value: Any) -> Any:
    """Whole numbers where a network has numbers, so that equal texts have equal digests."""
    if isinstance(value, dict):
        return {k: v if k in ("schema", "level") else _floats(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_floats(one) for one in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _short(value: object) -> object:
    text = repr(value)
    return value if len(text) <= 80 else text[:80] + "…"


def as_json(network: Network) -> Json:
    """What `network_of` reads again."""
    return network.to_json()
