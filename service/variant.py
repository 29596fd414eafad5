"""A rotor's own network and its blades' known inputs, checked before they are stored.

A rotor may ask for a variant of its model's network, in the words of `core.network`::

    {"quantities": {"elongation": {"discrepancy": {"kind": "constant", "sd": 0.02},
                                   "by_instrument": true}},
     "parameters": {"tbc_thickness": {"population": {"mean": {…}, "sd": {…}}}},
     "forgetting_h": 20000,
     "effects": {"parameters": […], "drifts": […], "biases": […]}}

`effects` come from diagnoses that were adopted (`service.adopted`), as `core.network` writes them;
they go on top of everything else, in the order of their adoption. What is not asked for stays as
the model declares it. Beside the network's own checks, numbers that no reading or blade can have
are refused: a state would overflow on them, or not be trusted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

from core.errors import InputError, RangeError
from core.network import Discrepancy, Network, Parameter, Quantity
from core.prior import Population, Prior
from service.errors import FaultsError
from service.ports import BladeRecord, Json

HALVINGS = 100  # of a reading's weight over the model's hours, at most
EFFECTS = ("parameters", "drifts", "biases")
NARROWEST, WIDEST = 1e-4, 10.0  # population sd, in widths of the parameter's range


@contextmanager
def named(where: str) -> Iterator[None]:
    """Give a fault of what is built inside the name that the caller wrote.

    >>> try:
    ...     with named("network.quantities.elongation.discrepancy"):
    ...         raise InputError("discrepancy sd of elongation", 9.0, "is too large", "shrink it")
    ... except InputError as error:
    ...     print(error.what)
    network.quantities.elongation.discrepancy.sd
    """
    try:
        yield
    except InputError as error:
        if error.what.startswith("network."):
            raise
        inner = [word for word in error.what.split(" of ")[0].split()[1:] if word != "bounds"]
        field = ".".join([where, *inner])
        raise type(error)(field, error.value, error.problem, error.remedy) from None


def vary(network: Network, horizon_h: float, asked: Json) -> Network:
    """The network with what a rotor asks for in place; FaultsError lists every fault.

    horizon_h   hours that the model covers
    """
    quantities, parameters = asked.get("quantities", {}), asked.get("parameters", {})
    steps: list[Callable[[Network], Network]] = [
        *(partial(_with_quantity, name=name, told=told) for name, told in quantities.items()),
        *(partial(_with_population, name=name, told=told) for name, told in parameters.items()),
    ]
    if "forgetting_h" in asked:
        steps.append(partial(_forgetting, horizon_h=horizon_h, half_life_h=asked["forgetting_h"]))
    if "effects" in asked:
        steps.append(partial(_with_effects, told=asked["effects"]))
    faults: list[InputError] = []
    for step in steps:
        try:
            network = step(network)
        except InputError as error:
            faults.append(error)
    if faults:
        raise FaultsError(faults)
    return network


def _with_quantity(network: Network, name: str, told: Json) -> Network:
    where = f"network.quantities.{name}"
    with named(where):
        found = network.quantity(name)
    if "by_instrument" in told:
        found = replace(found, by_instrument=told["by_instrument"])
    if "discrepancy" in told:
        found = replace(found, discrepancy=_discrepancy(found, told["discrepancy"], where))
    changed = tuple(found if q.name == name else q for q in network.quantities)
    with named(f"{where}.discrepancy"):
        return replace(network, quantities=changed)


def _discrepancy(quantity: Quantity, told: Json, where: str) -> Discrepancy:
    """The discrepancy; an offset or an error larger than any reading is none."""
    where = f"{where}.discrepancy"
    with named(f"{where}.prior"):
        prior = Prior(**told["prior"]) if "prior" in told else None
    with named(where):
        found = Discrepancy(**{**told, "prior": prior})
        span = quantity.high - quantity.low
        theta = found.theta
        reach = max(-theta.low, theta.high) if found.kind == "constant" else 0.0
        for what, value, size in (
            ("prior" if prior else "sd", (theta.low, theta.high) if prior else found.sd, reach),
            ("sigma", found.sigma, found.sigma or 0.0),
        ):
            if size > span:
                raise RangeError(
                    f"discrepancy {what}",
                    value,
                    f"lets it be {size:g} {quantity.unit}, more than the {span:g} "
                    f"{quantity.unit} between plausible readings",
                    "give a smaller one",
                )
    return found


def _with_population(network: Network, name: str, told: Json) -> Network:
    where = f"network.parameters.{name}"
    with named(where):
        found = network.parameter(name)
    if "population" not in told:
        return network
    where = f"{where}.population"
    with named(f"{where}.mean"):
        mean = Prior(**told["population"]["mean"])
    with named(f"{where}.sd"):
        sd = Prior(**told["population"]["sd"])
        width = found.prior.high - found.prior.low
        low, high = NARROWEST * width, WIDEST * width
        if sd.low < low or sd.high > high:
            raise RangeError(
                "prior bounds",
                (sd.low, sd.high),
                f"leave {low:.3g} … {high:.3g}, {NARROWEST:g} … {WIDEST:g} widths of the range",
                "narrow them",
            )
    with named(where):
        changed = replace(found, population=Population(mean, sd))
    return replace(
        network, parameters=tuple(changed if p.name == name else p for p in network.parameters)
    )


def _forgetting(network: Network, horizon_h: float, half_life_h: float) -> Network:
    with named("network.forgetting_h"):
        network = replace(network, forgetting_h=half_life_h)
        if half_life_h < (least := horizon_h / HALVINGS):
            raise RangeError(
                "forgetting_h",
                half_life_h,
                f"is below {least:g} h: the first reading would count 2^-{HALVINGS} at the last",
                f"give {least:g} h or more",
            )
    return network


def _with_effects(network: Network, told: Json) -> Network:
    """Drifts and biases with their amplitudes; a parameter that was dormant is woken in place."""
    with named("network.effects"):
        body = network.to_json()
        asleep = {p.name for p in network.of_level("dormant")}
        given = told.get("parameters", [])
        woken = {p.get("name"): p for p in given if p.get("name") in asleep}
        more = {name: [*body.get(name, []), *told.get(name, [])] for name in EFFECTS}
        more["parameters"] = [
            *(woken.get(p["name"], p) for p in body["parameters"]),
            *(p for p in given if p.get("name") not in woken),
        ]
        return Network.from_json(body | more)


def effects_between(before: Network, after: Network) -> Json:
    """What a network has more than another one that it was made from, as `effects` tell it.

    Raises InputError where it is not the other one and effects on top.
    """
    told, more = before.to_json(), after.to_json()
    found = {
        name: [one for one in more.get(name, []) if one not in told.get(name, [])]
        for name in EFFECTS
    }
    if _with_effects(before, found) != after:
        what = "is not the other network with effects on top"
        raise InputError("network", after.name, what, "give the network that it was made from")
    return found


def with_more(asked: Json | None, adds: Json) -> Json:
    """What a rotor asks for, and on top what a diagnosis adds: effects, or a discrepancy.

    >>> with_more(None, {"biases": [1]})["effects"]["biases"]
    [1]
    >>> with_more({"effects": {"biases": [1]}}, {"biases": [2]})["effects"]["biases"]
    [1, 2]
    >>> told = {"quantities": {"y": {"discrepancy": {"kind": "gp"}}}}
    >>> with_more({"quantities": {"y": {"by_instrument": True}}}, told)["quantities"]["y"]
    {'by_instrument': True, 'discrepancy': {'kind': 'gp'}}
    """
    own: Json = asked or {}
    if more := adds.get("quantities"):
        quantities = own.get("quantities", {})
        changed = {name: {**quantities.get(name, {}), **told} for name, told in more.items()}
        return {**own, "quantities": {**quantities, **changed}}
    there = own.get("effects", {})
    return {**own, "effects": {n: [*there.get(n, []), *adds.get(n, [])] for n in EFFECTS}}


def check_known(network: Network, blades: Sequence[tuple[str, BladeRecord]]) -> None:
    """Refuse known inputs that the model does not have, and blades without those it needs.

    blades   each with the name of its place in the request, e.g. ``blades[3].``
    Raises FaultsError with every fault: every known input without a nominal value has to be given,
    within the range of the training runs, and no other input may be given.
    """
    declared = {p.name: p for p in network.of_level("known")}
    remedy = f"give {', '.join(declared)}" if declared else "leave it out: the model has none"
    faults: list[InputError] = []
    for where, blade in blades:
        given = blade.known or {}
        faults += [
            InputError(f"{where}known.{name}", v, "is no known input of the model", remedy)
            for name, v in given.items()
            if name not in declared
        ]
        found = [_known_fault(where, p, given) for p in declared.values()]
        faults += [fault for fault in found if fault is not None]
    if faults:
        raise FaultsError(faults)


def _known_fault(where: str, parameter: Parameter, given: Mapping[str, float]) -> InputError | None:
    name, prior = f"{where}known.{parameter.name}", parameter.prior
    if parameter.name not in given and parameter.nominal is None:
        return InputError(name, None, "is missing", f"give it, in {parameter.unit!r}")
    value = given.get(parameter.name, prior.low)
    if not prior.low <= value <= prior.high:
        problem = f"lies outside {prior.low:g} … {prior.high:g}, which the model covers"
        return RangeError(name, value, problem, "give a value inside")
    return None
