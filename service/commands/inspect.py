"""``bladetwin inspect``: a rotor at a glance, in the terminal. It reads and changes nothing.

With a file of readings it tells what would become of them instead (`service.commands.check_file`).

Everything is of one version: the table, the parameters and the state that the header names. A
margin is what is left to the limit in standard deviations of the blade itself, without a reading's
noise, as on the rotor's page: (limit − mean) / sd.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from core.errors import InputError
from service.commands import Json
from service.commands.reach import reached

if TYPE_CHECKING:
    from core.network import Network
    from service.client import Client

Told = dict[str, Any]
FEW_SD = 2.0
REFUSED = 3  # exit status where a file could not be posted


def gathered(
    twin: Client, name: str, quantity: str | None, time_h: float | None, node: str | None
) -> Told:
    """What the summary tells, of the newest version.

    Raises ProblemError where the rotor is not there, or the question does not fit its model.
    """
    from core.network import Network

    rotor = twin.rotor(name)
    told: Told = {"rotor": rotor, "posterior": None, "blades": [], "units": {}, "question": None}
    if rotor["posterior"] is None:
        return told
    version = rotor["version"]
    asked: Told = {"quantity": quantity, "time_h": time_h, "node": node, "version": version}
    told["posterior"] = twin.posterior(name, version=version)
    shared = set(told["posterior"]["names"])
    model = twin.model(rotor["model"], rotor["model_version"])
    network = Network.from_json(model["network"])
    quantity = quantity or next(iter(model["outputs"]))
    told["question"] = {
        "quantity": quantity,
        "unit": model["outputs"][quantity]["unit"] if quantity in model["outputs"] else None,
        "time_h": model["horizon_h"] if time_h is None else time_h,
        "node": node,
    }
    for blade in twin.blades(name, **asked):
        own = twin.posterior(name, blade["id"], version=version)["parameters"]
        local = {k: {"mean": v["mean"], "sd": v["sd"]} for k, v in own.items() if k not in shared}
        told["blades"].append(blade | {"parameters": local})
    names = {name for blade in told["blades"] for name in blade["parameters"]} | shared
    told["units"] = {name: unit for name in sorted(names) if (unit := own_unit(network, name))}
    return told


def own_unit(network: Network, name: str) -> str | None:
    """The unit of a parameter that the model itself declares; None: the rotor has added it."""
    from service.export.units import unit_of

    unit = None if name.startswith("theta") else unit_of(network, name)
    return None if unit in ("", "1") else unit


def with_margins(told: Told, limit: float) -> Told:
    """The same with `margin_sd` of each blade: sds left to the limit; of a vector: of its z."""
    for blade in told["blades"]:
        mean, sd = blade["prediction"]["mean"], blade["prediction"]["sd"]["blade"]
        mean, sd = (mean[-1], sd[-1]) if isinstance(mean, list) else (mean, sd)
        blade["margin_sd"] = (limit - mean) / sd if sd > 0 else None
    told["question"] = told["question"] and told["question"] | {"limit": limit}
    return told


def inspect(
    rotor: Annotated[str, typer.Argument(help="The rotor.")],
    quantity: Annotated[
        str | None, typer.Option(help="What is predicted; default: the model's first quantity.")
    ] = None,
    time_h: Annotated[
        float | None, typer.Option(help="At which hour; default: the model's last.")
    ] = None,
    node: Annotated[str | None, typer.Option(help="Of a field: at which node.")] = None,
    limit: Annotated[
        float | None, typer.Option(help="Of that quantity: tells each blade's margin to it.")
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option(
            help="Readings (CSV or JSON): what would become of them, if they were posted."
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
    if file is not None:
        typer.echo(json.dumps(told) if as_json else "\n".join(lines))
        raise typer.Exit(REFUSED if told["faults"] else 0)
    if limit is not None:
        told = with_margins(told, limit)
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
    for effect in rotor["effects"]:
        yield f"  effect   {effect['name']}, adopted"
    for name, one in posterior["parameters"].items():
        unit = told["units"].get(name, "")
        yield f"  {name} = {one['mean']:.4g} ± {one['sd']:.2g} {unit}".rstrip()
    yield ""
    yield from blade_lines(told)


def blade_lines(told: Told) -> Iterator[str]:
    """The blades as a table; a column in which no blade has anything is left out."""
    asked, blades = told["question"], told["blades"]
    local = list(blades[0]["parameters"]) if blades else []
    margin = "limit" in asked
    what = f"{asked['quantity']} [{asked['unit']}] at {asked['time_h']:g} h"
    head = ["blade", "slot", "lot", "readings", "last [h]", what]
    units = told["units"]
    named = [f"{name} [{units[name]}]" if name in units else name for name in local]
    rows = [[*head, *(["margin [sd]"] if margin else []), *named, ""]]
    for blade in blades:
        readings, last = blade["readings"], blade["readings"]["last"]
        row = [blade["id"], blade["slot"] or "", blade["lot"] or "", str(readings["counting"])]
        row += ["" if last is None else f"{last['time_h']:g}", predicted(blade["prediction"])]
        left = blade.get("margin_sd")
        row += ["" if left is None else f"{left:.1f}"] if margin else []
        row += [f"{one['mean']:.4g} ± {one['sd']:.2g}" for one in blade["parameters"].values()]
        rows.append([*row, noted(blade, left)])
    used = [any(column) for column in zip(*rows[1:], strict=True)]
    yield from aligned([[*compress(row, used)] for row in rows])


def predicted(told: Told) -> str:
    """Mean ± sd of the blade itself; of a vector in its three directions.

    >>> predicted({"mean": 0.5, "sd": {"blade": 0.0123}})
    '0.5 ± 0.012'
    >>> predicted({"mean": [0.0, 1.0], "sd": {"blade": [0.0, 0.1]}})
    '0 ± 0, 1 ± 0.1'
    """
    mean, sd = told["mean"], told["sd"]["blade"]
    if not isinstance(mean, list):
        mean, sd = [mean], [sd]
    return ", ".join(f"{m:.4g} ± {s:.2g}" for m, s in zip(mean, sd, strict=True))


def noted(blade: Told, margin: float | None) -> str:
    """What to look at."""
    notes = ["retired"] if blade["retired"] else []
    if margin is not None and margin < FEW_SD:
        notes.append("beyond the limit" if margin < 0 else f"limit within {FEW_SD:g} sd")
    if not blade["readings"]["counting"]:
        notes.append("no reading")
    return ", ".join(notes)


def aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows with columns under each other.

    >>> [*aligned([["a", "bcd"], ["ef", "g"]])]
    ['a   bcd', 'ef  g']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        yield "  ".join(cells).rstrip()
