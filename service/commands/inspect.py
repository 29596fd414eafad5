"""``bladetwin inspect``: a rotor at a glance, in the terminal. It reads and changes nothing.

With a file of readings it tells what would become of them instead (`service.commands.check_file`).

Everything is of one version: the table, the parameters and the state that the header names. A
margin is what is left to the limit in standard deviations of the blade itself, without a reading's
noise, as on the rotor's page: (limit − mean) / sd. It misleads where a blade is hardly known, so
what is noted is the chance to have passed the limit (`GET …/life` of the rotor).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from core.errors import InputError
from service.adopt_command import by_whom, no_longer
from service.commands import Json
from service.commands.blade_table import around, blade_lines, columns
from service.commands.reach import reached
from service.report.words import percent

if TYPE_CHECKING:
    from core.network import Network
    from service.client import Client

Told = dict[str, Any]
USUAL_H = 50_000.0  # as the pages look ahead: a wide model's runs end far beyond any blade
REFUSED = 3  # exit status where a file could not be posted


def gathered(
    twin: Client, name: str, quantity: str | None, time_h: float | None, node: str | None
) -> Told:
    """What the summary tells, of the newest version.

    Raises ProblemError where the rotor is not there, or the question does not fit its model.
    """
    from core.network import Network
    from service.variant import vary

    rotor = twin.rotor(name)
    told: Told = {"rotor": rotor, "posterior": None, "blades": [], "units": {}, "question": None}
    told |= {"residuals": None, "life": None}
    if rotor["posterior"] is None:
        return told
    version = rotor["version"]
    told["posterior"] = twin.posterior(name, version=version)
    tested = twin.residuals(name, limit="1")
    if tested["as_of"] is not None:
        alarms = [one for one in tested["tests"] if one["alarm"]]
        told["residuals"] = {"version": tested["as_of"]["version"], "alarms": alarms}
    shared = set(told["posterior"]["names"])
    model = twin.model(rotor["model"], rotor["model_version"])
    network = Network.from_json(model["network"])
    if rotor["network"] is not None:
        network = vary(network, model["horizon_h"], rotor["network"])
    quantity = quantity or next(iter(model["outputs"]))
    time_h = min(USUAL_H, model["horizon_h"]) if time_h is None else time_h
    told["question"] = {
        "quantity": quantity,
        "unit": model["outputs"][quantity]["unit"] if quantity in model["outputs"] else None,
        "time_h": time_h,
        "node": node,
    }
    asked: Told = {"quantity": quantity, "time_h": time_h, "node": node, "version": version}
    for blade in twin.blades(name, **asked):
        own = twin.posterior(name, blade["id"], version=version)["parameters"]
        local = {k: {"mean": v["mean"], "sd": v["sd"]} for k, v in own.items() if k not in shared}
        told["blades"].append(blade | {"parameters": local})
    if told["blades"] and model["outputs"][quantity]["kind"] != "scalar":
        first = told["blades"][0]["id"]
        at = twin.prediction(name, first, quantity, times=[time_h], node=node, version=version)
        told["question"] |= {"node": at["node"], "place": place(model["nodes"], at["node"])}
    names = {name for blade in told["blades"] for name in blade["parameters"]} | shared
    told["units"] = {name: unit for name in sorted(names) if (unit := own_unit(network, name))}
    return told


def place(nodes: dict[str, int], node: int | None) -> str | None:
    """What the model calls a node; None: it has no name."""
    return next((name for name, each in nodes.items() if each == node), None)


def own_unit(network: Network, name: str) -> str | None:
    """The unit of a parameter of the rotor's network; None: it has none."""
    from service.export.units import unit_of

    unit = None if name.startswith("theta") else unit_of(network, name)
    return None if unit in ("", "1") else unit


def with_margins(twin: Client, told: Told, limit: float, ahead: float | None = None) -> Told:
    """The same with `margin_sd` of each blade: sds left to the limit; of a vector: of its z.

    With it `passed`, the chance that it has passed the limit by the hour (None: it has left), and
    the rotor's `life`: the number of blades that are expected to have, and the chance that any has.
    With hours `ahead` from now on these are by then, each blade has its age, and no margin, which
    would be of the table's hour.
    """
    asked = told["question"]
    if asked is None:
        return told
    of = {name: asked[name] for name in ("quantity", "node")}
    rests = told["posterior"]["rests_on"]
    by: Told = {"times": [asked["time_h"]]} if ahead is None else {"ahead": [ahead]}
    life = twin.rotor_life(told["rotor"]["id"], limit, version=rests["version"], **by, **of)
    passed = {one["id"]: one["passed"][0] for one in life["blades"]}
    ages = {one["id"]: {name: one[name] for name in ("age_h", "age_by")} for one in life["blades"]}
    told["life"] = {name: life[name][0] for name in ("time_h", "expected", "any")}
    told["life"]["ahead"] = life["ahead"]
    for blade in told["blades"]:
        blade["passed"] = passed.get(blade["id"])
        if ahead is not None:
            blade |= ages.get(blade["id"], {"age_h": None, "age_by": None})
            continue
        mean, sd = blade["prediction"]["mean"], blade["prediction"]["sd"]["blade"]
        mean, sd = (mean[-1], sd[-1]) if isinstance(mean, list) else (mean, sd)
        blade["margin_sd"] = (limit - mean) / sd if sd > 0 else None
    told["question"] = asked | {"limit": limit}
    return told


def inspect(
    rotor: Annotated[str, typer.Argument(help="The rotor.")],
    quantity: Annotated[
        str | None, typer.Option(help="What is predicted; default: the model's first quantity.")
    ] = None,
    time_h: Annotated[
        float | None,
        typer.Option(help="At which hour; default: 50,000, or the model's last if it is earlier."),
    ] = None,
    node: Annotated[str | None, typer.Option(help="Of a field: at which node.")] = None,
    limit: Annotated[
        float | None, typer.Option(help="Of that quantity: tells whether blades pass it.")
    ] = None,
    ahead: Annotated[
        float | None,
        typer.Option(help="With --limit: by that many hours from now on, of blades of any age."),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option(
            help="Readings (CSV, JSON, SensorThings): what would become of them, were they posted."
        ),
    ] = None,
    url: Annotated[str, typer.Option(help="The service.")] = "http://127.0.0.1:8000",
    key: Annotated[str | None, typer.Option(help="An API key with read.")] = None,
    as_json: Json = False,
) -> None:
    """A rotor at a glance, or a file of readings before it is posted. Changes nothing.

    State and health, shared parameters, every blade. With --file: exit status 0: it can be posted;
    3: it would be refused, and every fault.
    """
    if limit is not None and not math.isfinite(limit):
        raise InputError("--limit", limit, "is no number", "give it in the quantity's unit")
    if ahead is not None and limit is None:
        raise InputError("--ahead", ahead, "is given without --limit", "give the limit as well")
    other = {"--quantity": quantity, "--time-h": time_h, "--node": node, "--limit": limit}
    odd = [name for name, value in other.items() if value is not None]
    if file is not None and odd:
        value = other[odd[0]]
        raise InputError(odd[0], value, "is given beside a file", "leave one of the two out")
    with reached(url, key) as twin:
        if file is not None:
            from service.commands import check_file

            told = check_file.checked(twin, rotor, file, quiet=as_json)
            lines = check_file.lines_of(told)
        else:
            told = gathered(twin, rotor, quantity, time_h, node)
            told = told if limit is None else with_margins(twin, told, limit, ahead)
    if file is not None:
        typer.echo(json.dumps(told) if as_json else "\n".join(lines))
        raise typer.Exit(REFUSED if told["faults"] else 0)
    typer.echo(json.dumps(told) if as_json else "\n".join(lines_of(told)))


def lines_of(told: Told) -> Iterator[str]:
    """The summary for people."""
    rotor, posterior = told["rotor"], told["posterior"]
    model = f"{rotor['model']} {rotor['model_version']}"
    yield f"rotor {rotor['id']}: {len(rotor['blades'])} blades, model {model}"
    applied = f"{rotor['applied_seq']} of {rotor['head_seq']} entries applied"
    yield f"  status   {rotor['status']}, {applied}"
    if rotor["last_error"] is not None:
        error = rotor["last_error"]
        yield f"  error    {error['error']} (entry {error['event'] or 'not known'})"
    if posterior is None:
        yield "  no posterior yet: a worker has to compute the first one"
        return
    rests = posterior["rests_on"]
    kind = "sealed" if rests["sealed"] else "provisional"
    digest = rests["state_digest"][:16]
    yield f"  version  {rests['version']}, {kind}, through entry {rests['through_seq']}, {digest}…"
    health = posterior["health"]
    yield f"  health   {health['status']}" + ("" if health["trusted"] else ", not to be trusted")
    for reason in health["reasons"]:
        yield f"           {reason}"
    yield from _residuals(told["residuals"])
    for effect in rotor["effects"]:
        yield f"  effect   {effect['name']}, {by_whom(effect)}"
        if lost := no_longer(effect):
            yield f"           {lost}"
    for name, one in posterior["parameters"].items():
        unit = told["units"].get(name, "")
        yield f"  {name} = {around(one['mean'], one['sd'])} {unit}".rstrip()
    if told["life"] is not None:
        yield f"  limit    {_passing(told['question'], told['life'])}"
    yield ""
    yield from blade_lines(told, columns())


def _passing(asked: Told, life: Told) -> str:
    """How many blades pass the limit, and how surely any does.

    >>> life = {"time_h": 32000.0, "ahead": False, "expected": 1.28, "any": 0.634}
    >>> _passing({"limit": 0.4, "unit": "mm"}, life)
    '0.4 mm by 32,000 h of each blade: 1.3 expected past it, at least one with 63 %'
    >>> _passing({"limit": 0.4, "unit": "1"}, life | {"time_h": 8000.0, "ahead": True})
    '0.4 within 8,000 h from now on: 1.3 expected past it, at least one with 63 %'
    """
    unit = "" if asked["unit"] == "1" else f" {asked['unit']}"
    past = f"{life['expected']:.1f} expected past it, at least one with {percent(life['any'])}"
    hour = f"{life['time_h']:,.10g} h"
    when = f"within {hour} from now on" if life["ahead"] else f"by {hour} of each blade"
    return f"{asked['limit']:,.10g}{unit} {when}: {past}"


def _residuals(tested: Told | None) -> Iterator[str]:
    """What tests of the residuals say, where they were made: no blade's line does.

    >>> one = {"grouping": "campaign", "value": "c2", "statistic": "mean"}
    >>> [*_residuals({"version": 4, "alarms": [one, one | {"grouping": "all", "value": None}]})]
    ['  residuals alarm in version 4: campaign c2 (mean); all (mean)']
    """
    if tested is None:
        return
    alarms = [
        f"{' '.join(filter(None, (one['grouping'], one['value'])))} ({one['statistic']})"
        for one in tested["alarms"]
    ]
    said = f"alarm in version {tested['version']}: {'; '.join(alarms)}" if alarms else "no alarm"
    yield f"  residuals {said}"
